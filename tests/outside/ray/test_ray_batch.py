"""Eight clips, two workers, one of them killed."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from ray.cluster_utils import Cluster

ROOT = Path(os.environ["STREAMSPLAT_ROOT"])
EXAMPLE = ROOT / "examples/ray_batch.py"
FRAMES = 9


@pytest.fixture(scope="module")
def clips(procedural, tmp_path_factory):
    """Eight clips of nine frames each, cut from the procedural one at different times."""
    header, frames = procedural
    folder = tmp_path_factory.mktemp("clips")
    for i in range(8):
        first = i * (len(frames) - FRAMES) // 7
        (folder / f"clip-{i}.y4m").write_bytes(header + b"".join(frames[first : first + FRAMES]))
    return folder


def tree(folder):
    """Every file with its bytes. Of the record only the digests, as it also contains times of stages, like the report."""
    found = {}
    for path in (p for p in sorted(folder.rglob("*")) if p.is_file() and p.name != "report.md"):
        content = path.read_bytes()
        found[str(path.relative_to(folder))] = json.loads(content)["outputs"] if path.name == "run.json" else content
    return found


def workers():
    """Processes that work on a clip."""
    found = []
    for process in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if process.read_bytes().startswith(b"ray::work_on"):
                found.append(int(process.parent.name))
        except OSError:
            continue
    return found


def lines(said):
    """The example's output, without Ray's."""
    return [line for line in said.splitlines() if line.startswith(("8 clips", "clip-"))]


def test_a_killed_worker_changes_no_byte(clips, tmp_path):
    subprocess.run([sys.executable, EXAMPLE, clips, tmp_path / "plain", "--plain"], check=True)
    expected = tree(tmp_path / "plain")
    assert len(expected) == 8 * (FRAMES + 5)

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    try:
        for _ in range(2):
            cluster.add_node(num_cpus=1)
        cluster.wait_for_nodes()
        command = [sys.executable, EXAMPLE, clips, tmp_path / "ray", "--address", cluster.address]
        run = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        killed = None
        while run.poll() is None and killed is None:
            done = sum(not p.name.startswith(".") for p in (tmp_path / "ray").glob("*"))
            at_work = workers()
            if done >= 2 and at_work and list((tmp_path / "ray").glob(".*.partial/scene/interval-*")):
                killed = at_work[0]
                os.kill(killed, signal.SIGKILL)
            time.sleep(0.02)
        assert killed is not None, "no worker was seen at work"
        said, _ = run.communicate(timeout=300)
        assert run.returncode == 0, said
        # Each is reported once; the killed worker's clip may have been finished just before.
        assert [line.split(":")[0] for line in sorted(lines(said))] == ["8 clips, 0 done before", *(f"clip-{i}.y4m" for i in range(8))], said
        assert sum(line.endswith("9 frames, 3 key frames") for line in lines(said)) >= 7, said
        assert "task will be retried" in said, said
        assert tree(tmp_path / "ray") == expected
        # A second run finds everything done; a removed clip is computed again, and only that.
        again = subprocess.run(command, check=True, capture_output=True, text=True)
        assert lines(again.stdout) == ["8 clips, 8 done before"]
        subprocess.run(["rm", "-r", tmp_path / "ray/clip-3"], check=True)
        again = subprocess.run(command, check=True, capture_output=True, text=True)
        assert lines(again.stdout) == ["8 clips, 7 done before", "clip-3.y4m: 9 frames, 3 key frames"]
        assert tree(tmp_path / "ray") == expected
    finally:
        cluster.shutdown()


def test_a_broken_clip_fails_alone(clips, tmp_path):
    folder = tmp_path / "clips"
    folder.mkdir()
    (folder / "good.y4m").write_bytes((clips / "clip-0.y4m").read_bytes())
    (folder / "broken.y4m").write_bytes((clips / "clip-1.y4m").read_bytes()[:-10])
    run = subprocess.run([sys.executable, EXAMPLE, folder, tmp_path / "out"], capture_output=True, text=True)
    assert run.returncode == 1 and "broken.y4m" in run.stderr, run.stderr
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["good"]
