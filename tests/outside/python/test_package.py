"""The Python package against the command line."""

import importlib.metadata
import json
import os
import pickle
import re
import subprocess
import sys
import threading
import time as clock
from pathlib import Path

import blake3
import numpy as np
import PIL.Image
import pytest
import streamsplat_cpu

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
    engine = streamsplat_cpu.Engine(refine=0, find_depth=False)
    return [engine.push(frame, time) for i, (frame, time) in enumerate(streamsplat_cpu.Frames(CLIP)) if i % 4 == 0]


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
        result = streamsplat_cpu.reconstruct(CLIP, out, gap=4, threads=threads)
        written = {name: data for name, data in files(out).items() if name in digests}
        assert {name: blake3.blake3(data).hexdigest() for name, data in written.items()} == digests
        assert (result.frames, result.key_frames, result.path) == (24, 7, out)
        assert result.record == json.loads((out / "run.json").read_text())


def test_the_readmes_lines_write_what_the_program_writes(tmp_path, monkeypatch):
    lines = (ROOT / "README.md").read_text().split("```python\n")[1].split("```")[0]
    assert len(lines.splitlines()) <= 6
    monkeypatch.chdir(tmp_path)
    (tmp_path / "clip.y4m").write_bytes(CLIP.read_bytes())
    subprocess.run([PROGRAM, "run", "clip.y4m", "--quiet"], check=True)
    exec(lines, {})
    written, expected = ({name: data for name, data in files(tmp_path / folder).items() if name not in ("run.json", "report.md")}
                         for folder in ("out", "clip-scene"))
    assert written == expected and len(expected) > 24


def test_a_video_comes_out_where_its_name_says_so_and_key_frames_are_chosen(tmp_path):
    seen = []
    result = streamsplat_cpu.reconstruct(CLIP, tmp_path / "out.y4m", gap="auto", size=(128, 72), progress=lambda *step: seen.append(step))
    assert (tmp_path / "out.y4m").read_bytes().startswith(b"YUV4MPEG2 W128 H72") and result.record["options"]["stream"]["gap"] == "auto:3-12:38"
    assert seen == [(i + 1, 24) for i in range(24)]


def test_options_with_values_of_their_own_reach_the_run(tmp_path):
    streamsplat_cpu.reconstruct(CLIP, tmp_path / "out", gap=4, refine=0, frames=9, sway="5:0.25", stereo=True, background="0.2,0.3,0.4", times=[0, 0.25])
    images = sorted((tmp_path / "out/frames").iterdir())
    assert len(images) == 2 and PIL.Image.open(images[0]).size[0] > 2 * PIL.Image.open(images[0]).size[1]
    subprocess.run([PROGRAM, "render", tmp_path / "out", "--out", tmp_path / "again", "--sway=5:0.25", "--stereo", "--background", "0.2,0.3,0.4", "--times", "0,0.25",
                    "--quiet"], check=True)
    assert files(tmp_path / "again/frames") == files(tmp_path / "out/frames")


def test_a_reconstruction_is_iterated_over_and_stopped(tmp_path):
    steps = streamsplat_cpu.Reconstructing(CLIP, tmp_path / "all", gap=4, refine=0)
    assert [done for done, _ in steps] == list(range(1, 25)) and steps.result.frames == 24
    part = streamsplat_cpu.Reconstructing(CLIP, tmp_path / "part", gap=4, refine=0)
    for done, _ in part:
        if done == 1:
            break
    assert part.result is None and json.loads((tmp_path / "part/run.json").read_text())["complete"] is False
    streamsplat_cpu.reconstruct(CLIP, tmp_path / "part", gap=4, refine=0, resume=True)
    assert files(tmp_path / "part/frames") == files(tmp_path / "all/frames")

    def fails(done, total):
        raise KeyError(done)

    with pytest.raises(KeyError):
        streamsplat_cpu.reconstruct(CLIP, tmp_path / "failed", gap=4, refine=0, progress=fails)


def test_the_wheel_holds_the_program(tmp_path):
    program = Path(sys.executable).with_name("streamsplat")
    by_module = subprocess.run([sys.executable, "-m", "streamsplat_cpu", "inspect", "--model", "none"], capture_output=True, text=True)
    assert by_module.returncode == 2 and by_module.stderr.startswith("streamsplat: ")
    assert subprocess.run([program, "--version"], capture_output=True, check=True).stdout.startswith(b"streamsplat ")
    out = tmp_path / "out.y4m"
    subprocess.run([program, "run", CLIP, "--frames", "5", "--gap", "4", "--out", out, "--quiet"], check=True)
    expected = tmp_path / "expected.y4m"
    subprocess.run([PROGRAM, "run", CLIP, "--frames", "5", "--gap", "4", "--out", expected, "--quiet"], check=True)
    assert out.read_bytes() == expected.read_bytes()


def test_the_authors_package_and_this_one_share_an_environment_and_no_file():
    import streamsplat

    theirs, ours = (importlib.metadata.distribution(name) for name in ("streamsplat", "streamsplat-cpu"))
    assert streamsplat.__version__ == theirs.version == "0.1.4" and streamsplat_cpu.__version__ == ours.version
    written, found = ({str(file) for file in package.files} for package in (theirs, ours))
    assert not written & found and "streamsplat/__init__.py" in written and "streamsplat_cpu/__init__.py" in found
    programs = importlib.metadata.entry_points(group="console_scripts", name="streamsplat")
    assert [program.dist.name for program in programs] == ["streamsplat-cpu"]


def test_images_and_intervals_are_pickled_shown_and_saved_by_ending(intervals, tmp_path):
    interval = intervals[-1]
    image = interval.render(interval.end, depth=True, alpha=True)
    again = pickle.loads(pickle.dumps(image))
    assert again.png() == image.png() == image._repr_png_() and (again.depth == image.depth).all() and (again.alpha == image.alpha).all()
    copy = pickle.loads(pickle.dumps(interval))
    assert copy.render(copy.end).png() == interval.render(interval.end).png() and copy.merges == interval.merges
    assert np.asarray(image).dtype == np.uint8 and np.array_equal(np.asarray(image), image.rgb8())
    # Like other images: 8-bit samples, also where floats are computed from them. They belong to the caller; `rgb` shows the image.
    assert np.array_equal(np.asarray(image, np.float32), image.rgb8().astype(np.float32))
    for array in (np.asarray(image), np.array(image, np.float32), image.rgb.copy(), np.asarray(image, np.float64)):
        array[0, 0] = 0
    with pytest.raises(ValueError):
        image.rgb[0, 0] = 0
    for picture in (PIL.Image.fromarray(image), PIL.Image.fromarray(np.asarray(image))):
        assert picture.mode == "RGB" and np.array_equal(np.asarray(picture), image.rgb8())
    image.save(tmp_path / "a.png")
    assert np.array_equal(np.asarray(PIL.Image.open(tmp_path / "a.png")), image.rgb8())
    for ending, kind in (("jpg", "JPEG"), ("webp", "WEBP")):
        image.save(tmp_path / f"a.{ending}")
        assert PIL.Image.open(tmp_path / f"a.{ending}").format == kind
    for ending, start in (("ply", b"ply\n"), ("spz", b"\x1f\x8b"), ("splat", b"")):
        interval.save(tmp_path / f"a.{ending}")
        assert (tmp_path / f"a.{ending}").read_bytes().startswith(start)
    assert (tmp_path / "a.splat").stat().st_size % 32 == 0
    with pytest.raises(ValueError, match="expected a name ending in .ply"):
        interval.save(tmp_path / "a.obj")


def test_times_and_cameras_come_in_lists_and_as_matrices(intervals, tmp_path):
    interval = intervals[-1]
    times = [interval.start, 0.5 * (interval.start + interval.end), interval.end]
    one_by_one = [interval.render(time).png() for time in times]
    assert [image.png() for image in interval.render(times)] == one_by_one
    with streamsplat_cpu.SceneWriter(tmp_path / "scene", 24.0) as writer:
        for one in intervals:
            writer.push(one)
    assert [image.png() for image in streamsplat_cpu.Scene(tmp_path / "scene").render(times)] == [
        streamsplat_cpu.Scene(tmp_path / "scene").render(time).png() for time in times
    ]
    moved = {"type": "orthographic", "position": [0.2, 0, 0]}
    matrix = np.eye(4)
    matrix[0, 3] = 0.2
    views = interval.render(interval.end, [moved, {"type": "orthographic", "camera_to_world": matrix}])
    assert views[0].png() == views[1].png() != interval.render(interval.end).png()
    with pytest.raises(ValueError, match="as many as times"):
        interval.render(times, [moved])
    # The alternative that the message names works.
    with pytest.raises(TypeError, match=r"found <class 'numpy.ndarray'>; .* it is Camera\(viewmat, K, width, height\)"):
        interval.render(interval.end, matrix)
    K = [[60, 0, 32], [0, 60, 18], [0, 0, 1]]
    assert interval.render(interval.end, streamsplat_cpu.Camera(matrix, K, 64, 36)).rgb.shape == (36, 64, 3)
    interval.render(interval.end, {"type": "pinhole", "camera_to_world": matrix, "fov_y_degrees": 45, "aspect": 16 / 9})


def test_pictures_and_tensors_go_in():
    pixels = np.random.default_rng(5).integers(0, 256, (36, 64, 3), dtype=np.uint8)

    class Tensor:
        """Like torch's: planes first."""

        def __array__(self, dtype=None, copy=None):
            return pixels.transpose(2, 0, 1)

    kinds = [pixels, PIL.Image.fromarray(pixels), Tensor()]
    assert len({streamsplat_cpu.Engine().push(kind, 0.0).render(0.0).png() for kind in kinds}) == 1
    frames = streamsplat_cpu.Frames(CLIP)
    assert len(frames) == frames.count == 24


def test_the_example_draws_the_command_lines_frames(by_command_line, tmp_path):
    # It finds its clip from any folder.
    subprocess.run([sys.executable, ROOT / "examples/first_scene.py"], check=True, cwd=tmp_path)
    tmp_path = tmp_path / "first-scene"
    drawn = files(tmp_path / "frames")
    assert drawn, "the example drew nothing"
    expected = files(by_command_line / "frames")
    # Only the command line makes the last frame a key frame; the example stops at the last whole gap.
    assert all(data == expected[name] for name, data in drawn.items())
    assert len(drawn) >= len(expected) - 3
    assert (tmp_path / "side.png").stat().st_size > 1000


def test_the_readmes_example_runs(tmp_path):
    text = (ROOT / "README.md").read_text()
    code = text.split("```python\n", 1)[1].split("```", 1)[0]
    (tmp_path / "clip.y4m").write_bytes(CLIP.read_bytes())
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path)


def test_depth_is_found_unless_it_is_not_wanted():
    keys = [pair for i, pair in enumerate(streamsplat_cpu.Frames(CLIP)) if i in (0, 4)]

    def thickness(**options):
        engine = streamsplat_cpu.Engine(refine=0, **options)
        return [engine.push(frame, time) for frame, time in keys][-1].gaussians.thickness

    assert (thickness() != 1).any() and (thickness(find_depth=True) != 1).any()
    for options in [{"find_depth": False}, {"quality": "realtime"}, {"motion": "network"}]:
        assert (thickness(**options) == 1).all(), options
    # A picture that does not change has a guessed depth alone, which needs a request.
    keys = [(keys[0][0], 0.0), (keys[0][0], 1.0)]
    assert (thickness() == 1).all() and (thickness(guess_depth=True) != 1).any()
    assert (thickness(guess_depth=True, quality="realtime") != 1).any()
    for options in [{"find_depth": False}, {"motion": "network"}]:
        with pytest.raises(ValueError, match="guess_depth: expected find_depth"):
            streamsplat_cpu.Engine(guess_depth=True, **options)
    keys = [pair for i, pair in enumerate(streamsplat_cpu.Frames(CLIP)) if i in (0, 4)]
    # Gaussians are added behind the foreground.
    assert len(thickness()) > len(thickness(behind="off"))


def test_arrays_show_the_engines_memory_and_cannot_be_written(intervals):
    interval = intervals[-1]
    gaussians = interval.gaussians
    assert len(gaussians) == len(interval) == len(gaussians.mean)
    names = {name for name in dir(gaussians) if not name.startswith("_")}
    assert names >= {"mean", "scale", "thickness", "opacity", "rgb_rate", "identity", "handover"}
    for name in names:
        array = getattr(gaussians, name)
        text = getattr(type(gaussians), name).__doc__
        kind, width, copy = re.search(r"(\w+) \[N(?:, (\d))?\](: a copy)?\.$", text).groups()
        assert array.dtype == kind and array.shape == (len(interval), *([int(width)] if width else [])), name
        if copy:
            continue
        assert np.shares_memory(array, getattr(interval.gaussians, name)), name
        with pytest.raises(ValueError):
            array[0] = 0
        with pytest.raises(ValueError):
            array.setflags(write=True)
    assert (gaussians.thickness == 1).all(), "no depth lifts them"
    assert not gaussians.rgb_rate.any(), "the network's own colours stay"
    image = interval.render(interval.end, depth=True)
    assert image.rgb.shape == (image.height, image.width, 3) and np.shares_memory(image.rgb, image.rgb)
    assert image.depth.shape == (image.height, image.width) and image.alpha is None
    # An array outlives its source.
    mean = streamsplat_cpu.Engine().push(np.zeros((36, 64, 3), np.uint8), 0.0).gaussians.mean
    assert np.isfinite(mean).all()


def test_frames_of_either_kind_and_any_strides_are_the_same_frame():
    rng = np.random.default_rng(5)
    pixels = rng.integers(0, 256, (36, 64, 3), dtype=np.uint8)
    planes = np.ascontiguousarray((pixels.astype(np.float32) / np.float32(255)).transpose(2, 0, 1))
    kinds = [pixels, np.asfortranarray(pixels), pixels[::-1][::-1], pixels.astype(np.float32) / np.float32(255), planes.transpose(1, 2, 0)]
    pictures = {streamsplat_cpu.Engine().push(kind, 0.0).render(0.0).png() for kind in kinds}
    assert len(pictures) == 1


def test_frames_in_between_move_colours_and_must_lie_there():
    frames = list(streamsplat_cpu.Frames(CLIP))[:5]
    (first, start), (last, end) = frames[0], frames[4]

    def interval(between, **settings):
        engine = streamsplat_cpu.Engine(threads=1, **settings)
        engine.push(first, start, between=between)
        return engine.push(last, end, between=between)

    seen, blind = interval(frames[1:4], refine=2), interval(None, refine=2)
    assert seen.gaussians.rgb_rate.any() and blind.gaussians.rgb_rate.any()
    assert (seen.gaussians.rgb_rate != blind.gaussians.rgb_rate).any()
    network = interval(frames[1:4], motion="network", refine=0)
    assert (network.gaussians.velocity == interval(None, motion="network", refine=0).gaussians.velocity).all()
    with pytest.raises(streamsplat_cpu.Error, match="ascending times"):
        interval(frames[3:0:-1])
    for wrong in ({"motion": "flow"}, {"resolution": "288"}, {"still": "all"}, {"behind": "no"}, {"refine_to": 19.0}, {"refine_to": float("nan")}, {"detail": 1001}):
        with pytest.raises(ValueError):
            streamsplat_cpu.Engine(**wrong)


def test_a_scene_comes_back_as_it_was_written(intervals, tmp_path):
    with streamsplat_cpu.SceneWriter(tmp_path / "scene", 24.0) as writer:
        for interval in intervals:
            writer.push(interval)
    scene = streamsplat_cpu.Scene(tmp_path / "scene")
    assert len(scene) == len(intervals) and scene.times == [(i.start, i.end) for i in intervals] and scene.fps == 24.0
    time = 0.5 * (intervals[2].start + intervals[2].end)
    assert scene.render(time, size="source").png() == intervals[2].render(time, size="source").png()
    assert np.array_equal(scene[-1].gaussians.mean, intervals[-1].gaussians.mean)
    assert scene.interval(time).index == intervals[2].index
    assert [interval.index for interval in scene[1:3]] == [1, 2] and [interval.index for interval in scene[::-2]] == [5, 3, 1]
    assert scene[len(scene):] == []
    with pytest.raises(IndexError):
        scene[len(scene)]
    with pytest.raises(TypeError, match="a number or a slice"):
        scene["first"]


def test_a_pixel_is_picked_and_a_camera_turned(intervals):
    interval = intervals[-1]
    identity, index, weight, position = interval.pick(interval.end, (20, 20))
    assert interval.gaussians.identity[index] == identity and 0 < weight <= 1 and len(position) == 3
    turned = interval.render(interval.end, {"type": "orthographic", "position": [0.2, 0, 0]})
    assert turned.png() != interval.render(interval.end, {"type": "orthographic"}).png()
    numbers = {"type": "orthographic", "position": np.array([0.2, 0, 0])}
    assert turned.png() == interval.render(interval.end, numbers).png()


def test_errors_are_exceptions_that_say_what_was_expected(intervals, tmp_path):
    engine = streamsplat_cpu.Engine(threads=1)
    frame = np.zeros((36, 64, 3), np.uint8)
    engine.push(frame, 1.0)
    cases = [
        (ValueError, "fusion", lambda: streamsplat_cpu.Engine(fusion="both")),
        (ValueError, "isa", lambda: streamsplat_cpu.Engine(isa="mmx")),
        (FileNotFoundError, "no-model", lambda: streamsplat_cpu.Engine(tmp_path / "no-model.safetensors")),
        (ValueError, "found \\[36, 64, 2\\]; .* frame\\[..., 0\\]", lambda: engine.push(np.zeros((36, 64, 2), np.uint8), 2.0)),
        (ValueError, "frame.transpose\\(1, 2, 0\\) is taken", lambda: engine.push(np.zeros((3, 36, 64), np.uint8), 2.0)),
        (ValueError, "frame\\[0\\]", lambda: engine.push(np.zeros((1, 36, 64, 3), np.uint8), 2.0)),
        (ValueError, "found 255; frame / 255 is taken", lambda: engine.push(np.full((36, 64, 3), 255.0), 2.0)),
        (TypeError, "uint16; \\(frame / 65535\\).astype\\('float32'\\) is taken", lambda: engine.push(frame.astype(np.uint16), 2.0)),
        (TypeError, "frame.astype\\('uint8'\\) is taken", lambda: engine.push(frame.astype(np.int64), 2.0)),
        (TypeError, "bool", lambda: engine.push(frame.astype(bool), 2.0)),
        (TypeError, "found <class 'list'>", lambda: engine.push([[0.0]], 2.0)),
        (TypeError, "depth: expected .* float64", lambda: engine.push(frame, 2.0, np.zeros((36, 64)))),
        (ValueError, "depth: expected", lambda: engine.push(frame, 2.0, np.zeros((36, 63), np.float32))),
        (streamsplat_cpu.Error, "expected a time after", lambda: engine.push(frame, 1.0)),
        (streamsplat_cpu.Error, "expected finite pixels", lambda: engine.push(np.full((36, 64, 3), np.nan, np.float32), 2.0)),
        (streamsplat_cpu.Error, "expected 64×36 pixels", lambda: engine.push(np.zeros((64, 36, 3), np.uint8), 2.0)),
        (streamsplat_cpu.Error, "expected one between", lambda: intervals[-1].render(-1.0)),
        (ValueError, "size", lambda: intervals[-1].render(intervals[-1].end, size="big")),
        (TypeError, "size", lambda: intervals[-1].render(intervals[-1].end, size=3.5)),
        (TypeError, "time: expected seconds", lambda: intervals[-1].render("now")),
        (TypeError, "background", lambda: intervals[-1].render(intervals[-1].end, background="red")),
        (ValueError, "expected a name ending in .png", lambda: intervals[-1].render(intervals[-1].end).save(tmp_path / "a.xyz")),
        (ValueError, "expected float32 in \\[0, 1\\] .* found 200", lambda: engine.push(np.full((36, 64, 3), 200, np.float32), 2.0)),
        (ValueError, "found 60000×60000", lambda: engine.push(np.broadcast_to(np.float32(0), (60000, 60000, 3)), 2.0)),
        (ValueError, "expected an aligned array", lambda: engine.push(unaligned((36, 64, 3)), 2.0)),
        (MemoryError, "no memory", lambda: intervals[-1].render(intervals[-1].end, size=(60000, 60000))),
        (ValueError, "background", lambda: intervals[-1].render(intervals[-1].end, background=2.0)),
        (ValueError, "camera", lambda: intervals[-1].render(intervals[-1].end, {"type": "fisheye"})),
        (FileNotFoundError, "none.json", lambda: intervals[-1].render(intervals[-1].end, tmp_path / "none.json")),
        (FileNotFoundError, "nowhere", lambda: intervals[-1].render(intervals[-1].end).save(tmp_path / "nowhere/a.png")),
        (FileNotFoundError, "missing.y4m", lambda: streamsplat_cpu.Frames(tmp_path / "missing.y4m")),
        (ValueError, "frames per second", lambda: streamsplat_cpu.Frames(CLIP, fps=-1)),
        (streamsplat_cpu.Error, "https://example.org/a.mp4", lambda: streamsplat_cpu.Frames("https://example.org/a.mp4")),
        (FileNotFoundError, "missing.y4m", lambda: streamsplat_cpu.reconstruct(tmp_path / "missing.y4m", tmp_path / "none")),
        (FileNotFoundError, "missing", lambda: streamsplat_cpu.Scene(tmp_path / "missing")),
        (FileNotFoundError, "missing", lambda: streamsplat_cpu.cameras(tmp_path / "missing")),
        (FileNotFoundError, "nowhere", lambda: intervals[-1].save(tmp_path / "nowhere/a.ply")),
        (streamsplat_cpu.Error, "expected a scene, found an empty folder", lambda: streamsplat_cpu.Scene(tmp_path)),
    ]
    for kind, text, call in cases:
        with pytest.raises(kind, match=text):
            call()
    # None of them changed the stream.
    assert engine.push(frame, 2.0).index == 1


def test_a_damaged_video_leaves_what_came_before_and_is_an_error(tmp_path):
    broken = tmp_path / "broken.y4m"
    broken.write_bytes(CLIP.read_bytes()[:-100])
    with pytest.raises(streamsplat_cpu.Error, match="broken.y4m"):
        streamsplat_cpu.reconstruct(broken, tmp_path / "out", gap=4)
    # The part before the damage is a complete result, as on the command line, and its record contains the damage.
    record = json.loads((tmp_path / "out" / "run.json").read_text())
    assert "ends early" in record["input"]["damage"] and record["input"]["count"] == 23


def test_other_threads_run_while_the_engine_works():
    engine = streamsplat_cpu.Engine(threads=1)
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
    # If the lock were held, there would be one or two ticks per frame.
    during = sum(from_ < t < to for t in ticks)
    assert during > 10 * frames, f"{during} ticks in {to - from_:.2f} s"
