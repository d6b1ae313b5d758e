"""One video with two cuts, over a cluster and in a plain loop."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import streamsplat_cpu

ROOT = Path(os.environ["STREAMSPLAT_ROOT"])
EXAMPLE = ROOT / "examples/ray_long.py"
PART = 9


@pytest.fixture(scope="module")
def video(procedural, tmp_path_factory):
    """Three parts of nine frames: the procedural clip, its negative, and the clip again."""
    header, frames = procedural
    frames, mark = frames[:PART], len(b"FRAME\n")
    negative = bytes(255 - byte for byte in range(256))
    path = tmp_path_factory.mktemp("video") / "long.y4m"
    parts = [*frames, *(frame[:mark] + frame[mark:].translate(negative) for frame in frames), *frames]
    path.write_bytes(header + b"".join(parts))
    return path


def long(video, out, *more):
    command = [sys.executable, EXAMPLE, video, out, "--least", "4", *more]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()


def test_parts_over_a_cluster_are_one_scene_with_the_bytes_of_a_loop(video, tmp_path):
    said = long(video, tmp_path / "plain.ssz", "--plain")
    ranges = [f"frames {PART * i} to {PART * (i + 1) - 1}" for i in range(3)]
    assert said[:3] == ranges and said[3].startswith(f"{tmp_path}/plain.ssz: 9 intervals"), said
    assert sorted(line for line in long(video, tmp_path / "ray.ssz") if line.startswith("frames")) == sorted(ranges)
    assert (tmp_path / "ray.ssz").read_bytes() == (tmp_path / "plain.ssz").read_bytes()
    # Existing parts are not computed again.
    subprocess.run(["rm", "-r", tmp_path / f"plain.parts/{PART:08}-{2 * PART:08}", tmp_path / "plain.ssz"], check=True)
    kept = (tmp_path / "plain.parts" / f"{0:08}-{PART:08}").stat().st_mtime_ns
    long(video, tmp_path / "plain.ssz", "--plain")
    assert (tmp_path / "plain.parts" / f"{0:08}-{PART:08}").stat().st_mtime_ns == kept
    assert (tmp_path / "ray.ssz").read_bytes() == (tmp_path / "plain.ssz").read_bytes()
    # Every frame of the video is in it, at its own time and close to the source: no part is exchanged.
    scene = streamsplat_cpu.Scene(tmp_path / "plain.ssz")
    frames = list(streamsplat_cpu.Frames(video))
    assert scene.span == (frames[0][1], frames[-1][1])
    for frame, time in frames[:: PART // 2]:
        difference = abs(scene.render(time).rgb - frame[: scene.render(time).rgb.shape[0], : scene.render(time).rgb.shape[1]])
        assert difference.mean() < 0.05, (time, difference.mean())


def test_a_scene_is_a_container(video, tmp_path):
    done = subprocess.run([sys.executable, EXAMPLE, video, tmp_path / "scene"], capture_output=True, text=True)
    assert done.returncode == 2 and "expected a name that ends in .ssz" in done.stderr
