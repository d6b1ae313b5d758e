"""The Python package against the command line."""

import json
import os
import subprocess
import sys
import threading
import time as clock
from pathlib import Path

import blake3
import numpy as np
import pytest
import streamsplat

ROOT = Path(os.environ["STREAMSPLAT_ROOT"])
PROGRAM = os.environ["STREAMSPLAT"]
CLIP = ROOT / "fixtures/clips/moving.y4m"


@pytest.fixture(scope="session")
def by_command_line(tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "out"
    subprocess.run([PROGRAM, "run", CLIP, "--gap", "4", "--out", out, "--quiet"], check=True)
    return out


@pytest.fixture(scope="session")
def intervals():
    engine = streamsplat.Engine(refine=0)
    return [engine.push(frame, time) for i, (frame, time) in enumerate(streamsplat.Frames(CLIP)) if i % 4 == 0]


def unaligned(shape):
    """Float zeros one byte off."""
    count = int(np.prod(shape))
    return np.zeros(4 * count + 1, np.uint8)[1:].view(np.float32).reshape(shape)


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_reconstruct_writes_the_command_lines_bytes_at_any_number_of_threads(by_command_line, tmp_path):
    digests = {name: output["blake3"] for name, output in json.loads((by_command_line / "run.json").read_text())["outputs"].items()}
    for threads in (1, 2):
        out = tmp_path / str(threads)
        streamsplat.reconstruct(CLIP, out, gap=4, threads=threads)
        written = files(out)
        assert {name: blake3.blake3(data).hexdigest() for name, data in written.items()} == digests


def test_the_example_draws_the_command_lines_frames(by_command_line, tmp_path):
    subprocess.run([sys.executable, ROOT / "examples/first_scene.py", CLIP, tmp_path], check=True)
    drawn = files(tmp_path / "frames")
    assert drawn, "the example drew nothing"
    expected = files(by_command_line / "frames")
    # The last frame is a key frame only for the command line; the example stops at the last whole gap.
    assert all(data == expected[name] for name, data in drawn.items())
    assert len(drawn) >= len(expected) - 3
    assert (tmp_path / "side.png").stat().st_size > 1000


def test_the_readmes_example_runs(tmp_path):
    text = (ROOT / "README.md").read_text()
    code = text.split("```python\n", 1)[1].split("```", 1)[0]
    (tmp_path / "clip.y4m").write_bytes(CLIP.read_bytes())
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path)


def test_arrays_show_the_engines_memory_and_cannot_be_written(intervals):
    interval = intervals[-1]
    gaussians = interval.gaussians
    assert len(gaussians) == len(interval) == len(gaussians.mean)
    shapes = {"mean": (3,), "velocity": (3,), "gamma": (2,), "opacity": (), "scale": (2,), "rgb": (3,), "rgb_rate": (3,),
              "identity": (), "birth": (), "frame": (), "offset": (3,)}
    for name, rest in shapes.items():
        array = getattr(gaussians, name)
        assert array.shape == (len(interval), *rest) and np.shares_memory(array, getattr(interval.gaussians, name)), name
        with pytest.raises(ValueError):
            array[0] = 0
        with pytest.raises(ValueError):
            array.setflags(write=True)
    assert not gaussians.rgb_rate.any(), "the network's own colours stay"
    image = interval.render(interval.end, depth=True)
    assert image.rgb.shape == (image.height, image.width, 3) and np.shares_memory(image.rgb, image.rgb)
    assert image.depth.shape == (image.height, image.width) and image.alpha is None
    # An array outlives what it came from.
    mean = streamsplat.Engine().push(np.zeros((36, 64, 3), np.uint8), 0.0).gaussians.mean
    assert np.isfinite(mean).all()


def test_frames_of_either_kind_and_any_strides_are_the_same_frame():
    rng = np.random.default_rng(5)
    pixels = rng.integers(0, 256, (36, 64, 3), dtype=np.uint8)
    planes = np.ascontiguousarray((pixels.astype(np.float32) / np.float32(255)).transpose(2, 0, 1))
    kinds = [pixels, np.asfortranarray(pixels), pixels[::-1][::-1], pixels.astype(np.float32) / np.float32(255), planes.transpose(1, 2, 0)]
    pictures = {streamsplat.Engine().push(kind, 0.0).render(0.0).png() for kind in kinds}
    assert len(pictures) == 1


def test_frames_in_between_move_colours_and_must_lie_there():
    frames = list(streamsplat.Frames(CLIP))[:5]
    (first, start), (last, end) = frames[0], frames[4]

    def interval(between, **settings):
        engine = streamsplat.Engine(threads=1, **settings)
        engine.push(first, start, between=between)
        return engine.push(last, end, between=between)

    seen, blind = interval(frames[1:4], refine=2), interval(None, refine=2)
    assert seen.gaussians.rgb_rate.any() and blind.gaussians.rgb_rate.any()
    assert (seen.gaussians.rgb_rate != blind.gaussians.rgb_rate).any()
    network = interval(frames[1:4], motion="network", refine=0)
    assert (network.gaussians.velocity == interval(None, motion="network", refine=0).gaussians.velocity).all()
    with pytest.raises(streamsplat.Error, match="ascending times"):
        interval(frames[3:0:-1])
    for wrong in ({"motion": "flow"}, {"resolution": "288"}):
        with pytest.raises(ValueError):
            streamsplat.Engine(**wrong)


def test_a_scene_comes_back_as_it_was_written(intervals, tmp_path):
    with streamsplat.SceneWriter(tmp_path / "scene", 24.0) as writer:
        for interval in intervals:
            writer.push(interval)
    scene = streamsplat.Scene(tmp_path / "scene")
    assert len(scene) == len(intervals) and scene.times == [(i.start, i.end) for i in intervals] and scene.fps == 24.0
    time = 0.5 * (intervals[2].start + intervals[2].end)
    assert scene.render(time, size="source").png() == intervals[2].render(time, size="source").png()
    assert np.array_equal(scene[-1].gaussians.mean, intervals[-1].gaussians.mean)
    with pytest.raises(IndexError):
        scene[len(scene)]


def test_a_pixel_is_picked_and_a_camera_turned(intervals):
    interval = intervals[-1]
    identity, index, weight, position = interval.pick(interval.end, (20, 20))
    assert interval.gaussians.identity[index] == identity and 0 < weight <= 1 and len(position) == 3
    turned = interval.render(interval.end, {"type": "orthographic", "position": [0.2, 0, 0]})
    assert turned.png() != interval.render(interval.end, {"type": "orthographic"}).png()
    numbers = {"type": "orthographic", "position": np.array([0.2, 0, 0])}
    assert turned.png() == interval.render(interval.end, numbers).png()


def test_errors_are_exceptions_that_say_what_was_expected(intervals, tmp_path):
    engine = streamsplat.Engine(threads=1)
    frame = np.zeros((36, 64, 3), np.uint8)
    engine.push(frame, 1.0)
    cases = [
        (ValueError, "fusion", lambda: streamsplat.Engine(fusion="both")),
        (ValueError, "isa", lambda: streamsplat.Engine(isa="mmx")),
        (streamsplat.Error, "no-model", lambda: streamsplat.Engine(tmp_path / "no-model.safetensors")),
        (ValueError, "frame: expected", lambda: engine.push(np.zeros((36, 64), np.uint8), 2.0)),
        (ValueError, "found \\[36, 64, 4\\]", lambda: engine.push(np.zeros((36, 64, 4), np.uint8), 2.0)),
        (ValueError, "float64", lambda: engine.push(frame.astype(np.float64), 2.0)),
        (ValueError, "depth: expected", lambda: engine.push(frame, 2.0, np.zeros((36, 63), np.float32))),
        (streamsplat.Error, "expected a time after", lambda: engine.push(frame, 1.0)),
        (streamsplat.Error, "expected finite pixels", lambda: engine.push(np.full((36, 64, 3), np.nan, np.float32), 2.0)),
        (streamsplat.Error, "expected 64×36 pixels", lambda: engine.push(np.zeros((64, 36, 3), np.uint8), 2.0)),
        (streamsplat.Error, "expected one between", lambda: intervals[-1].render(-1.0)),
        (ValueError, "size", lambda: intervals[-1].render(intervals[-1].end, size="big")),
        (ValueError, "expected a name ending in .png", lambda: intervals[-1].render(intervals[-1].end).save(tmp_path / "a.jpg")),
        (ValueError, "expected float32 in \\[0, 1\\] .* found 200", lambda: engine.push(np.full((36, 64, 3), 200, np.float32), 2.0)),
        (ValueError, "found 60000×60000", lambda: engine.push(np.broadcast_to(np.float32(0), (60000, 60000, 3)), 2.0)),
        (ValueError, "expected an aligned array", lambda: engine.push(unaligned((36, 64, 3)), 2.0)),
        (MemoryError, "no memory", lambda: intervals[-1].render(intervals[-1].end, size=(60000, 60000))),
        (ValueError, "background", lambda: intervals[-1].render(intervals[-1].end, background=2.0)),
        (ValueError, "camera", lambda: intervals[-1].render(intervals[-1].end, {"type": "fisheye"})),
        (OSError, "none.json", lambda: intervals[-1].render(intervals[-1].end, tmp_path / "none.json")),
        (OSError, "nowhere", lambda: intervals[-1].render(intervals[-1].end).save(tmp_path / "nowhere/a.png")),
        (streamsplat.Error, "missing.y4m", lambda: streamsplat.Frames(tmp_path / "missing.y4m")),
        (streamsplat.Error, "scene.json", lambda: streamsplat.Scene(tmp_path)),
    ]
    for kind, text, call in cases:
        with pytest.raises(kind, match=text):
            call()
    # None of them harmed the stream.
    assert engine.push(frame, 2.0).index == 1


def test_a_failed_reconstruction_leaves_nothing(tmp_path):
    broken = tmp_path / "broken.y4m"
    broken.write_bytes(CLIP.read_bytes()[:-100])
    with pytest.raises(streamsplat.Error, match="broken.y4m"):
        streamsplat.reconstruct(broken, tmp_path / "out", gap=4)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["broken.y4m"]


def test_other_threads_run_while_the_engine_works():
    engine = streamsplat.Engine(threads=1)
    frame = np.zeros((144, 256, 3), np.uint8)
    ticks, done = [], threading.Event()

    def tick():
        while not done.is_set():
            ticks.append(clock.perf_counter())
            clock.sleep(0.001)

    thread = threading.Thread(target=tick)
    thread.start()
    from_, frames = clock.perf_counter(), 4
    for i in range(frames):
        frame[:, :, 0] = i
        engine.push(frame, float(i))
    to = clock.perf_counter()
    done.set()
    thread.join()
    # With the lock held there would be a tick or two per frame.
    during = sum(from_ < t < to for t in ticks)
    assert during > 10 * frames, f"{during} ticks in {to - from_:.2f} s"
