"""Uses of the package, for type checkers: nothing is run.

A line that must be refused has a comment that suppresses its error; checkers report a comment that suppresses nothing.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import PIL.Image
from numpy.typing import NDArray
from typing_extensions import assert_type

import streamsplat_cpu


def stream(clip: Path) -> Iterator[streamsplat_cpu.Image]:
    engine = streamsplat_cpu.Engine(quality="realtime", threads=2)
    assert_type(engine.threads, int)
    frames = streamsplat_cpu.Frames(clip, fps=12)
    assert_type(frames.count, int | None)
    for frame, time in frames:
        assert_type(frame, NDArray[np.float32])
        assert_type(time, float)
        interval = engine.push(frame, time, between=[(frame, time)])
        assert_type(interval, streamsplat_cpu.Interval)
        yield interval.render(time)


def pictures_of_others(engine: streamsplat_cpu.Engine, picture: PIL.Image.Image, pixels: NDArray[np.uint8]) -> None:
    engine.push(picture, 0.0)
    engine.push(pixels, 1.0, np.zeros((3, 4), np.float32))


def arrays(interval: streamsplat_cpu.Interval) -> None:
    assert_type(interval.gaussians.mean, NDArray[np.float32])
    assert_type(interval.gaussians.identity, NDArray[np.uint64])
    image = interval.render(0.5, {"type": "orthographic", "position": [0.2, 0, 0]}, size=(64, 36), alpha=True)
    assert_type(image, streamsplat_cpu.Image)
    assert_type(image.rgb, NDArray[np.float32])
    assert_type(image.alpha, NDArray[np.float32] | None)
    assert_type(image.rgb8(), NDArray[np.uint8])
    assert_type(image._repr_png_(), bytes)
    assert_type(interval.render([0.0, 0.5]), list[streamsplat_cpu.Image])
    assert_type(interval.render(0.5, ["a.json", None]), list[streamsplat_cpu.Image])
    PIL.Image.fromarray(image).save("a.webp")
    PIL.Image.fromarray(np.asarray(image)).save("a.webp")
    image.save(Path("a.png"))


def scenes(path: Path, interval: streamsplat_cpu.Interval) -> None:
    with streamsplat_cpu.SceneWriter(path, 24.0) as writer:
        writer.push(interval)
    scene = streamsplat_cpu.Scene(path)
    assert_type(scene[-1], streamsplat_cpu.Interval)
    assert_type(scene.render(0.5, size="source"), streamsplat_cpu.Image)


def still_scenes(path: Path, pixels: NDArray[np.float32]) -> None:
    scene = streamsplat_cpu.Scene(path)
    splats = scene.at()
    assert_type(splats, streamsplat_cpu.Splats)
    assert_type(splats.means, NDArray[np.float32])
    assert_type(splats.identities, NDArray[np.uint64])
    cameras = streamsplat_cpu.cameras("transforms.json", size=(64, 36))
    assert_type(cameras, list[streamsplat_cpu.Camera])
    assert_type(scene.render(cameras), list[streamsplat_cpu.Image])
    assert_type(scene.render(cameras[0]), streamsplat_cpu.Image)
    assert_type(scene.render({"type": "orthographic"}, size="64x36"), streamsplat_cpu.Image)
    assert_type(scene.render(), streamsplat_cpu.Image)
    assert_type(splats.render(splats.orbit(8)), list[streamsplat_cpu.Image])
    assert_type(splats.render(splats.camera(90)), streamsplat_cpu.Image)
    again = streamsplat_cpu.Splats(splats.means, splats.scales, splats.opacities, quats=splats.quats, sh=splats.sh)
    again.save("a.spz")
    camera = streamsplat_cpu.Camera(np.eye(4), pixels, 64, 36, name="a")
    assert_type(camera.K, NDArray[np.float32])
    assert_type(camera.size, tuple[int, int] | None)
    assert_type(streamsplat_cpu.Camera.look_at((0, 0, -1), (0, 0, 0)), streamsplat_cpu.Camera)
    with scene.view(open=False) as viewer:
        assert_type(viewer.url, str)


def parts(scene: streamsplat_cpu.Scene, interval: streamsplat_cpu.Interval) -> None:
    assert_type(scene[1:3], list[streamsplat_cpu.Interval])
    assert_type(scene.interval(0.5), streamsplat_cpu.Interval)
    assert_type(scene.at(0.5), streamsplat_cpu.Splats)
    assert_type(interval.at(), streamsplat_cpu.Splats)
    assert_type(scene.render([0.0, 0.5]), list[streamsplat_cpu.Image])
    assert_type(scene.render(0.5, {"type": "orthographic"}), streamsplat_cpu.Image)


def frames_in_memory(pixels: NDArray[np.uint8], out: Path) -> None:
    streamsplat_cpu.reconstruct([pixels, pixels], out, fps=24)
    streamsplat_cpu.reconstruct(((pixels, float(i)) for i in range(2)), out)
    streamsplat_cpu.reconstruct(streamsplat_cpu.Frames("clip.mp4"), out)


def whole_clips(clip: Path, out: Path) -> None:
    def report(done: int, total: int | None) -> None:
        print(done, total)

    result = streamsplat_cpu.reconstruct(clip, out, gap="auto", sway=True, progress=report)
    assert_type(result, streamsplat_cpu.Reconstruction)
    assert_type(result.frames, int)
    steps = streamsplat_cpu.Reconstructing(clip, out, quality="best")
    for done, total in steps:
        assert_type(done, int)
        assert_type(total, int | None)
    assert_type(steps.result, streamsplat_cpu.Reconstruction | None)


def drawn_arrays(splats: streamsplat_cpu.Splats, camera: streamsplat_cpu.Camera) -> None:
    colors, alphas, meta = streamsplat_cpu.rasterization(
        splats.means, splats.quats, splats.scales, splats.opacities, splats.sh, camera.viewmat[None], camera.K[None], 64, 48, sh_degree=splats.sh_degree
    )
    print(np.asarray(colors), np.asarray(alphas), meta["radii"])

def refused(engine: streamsplat_cpu.Engine, interval: streamsplat_cpu.Interval) -> None:
    streamsplat_cpu.Engine(fusion="both")  # type: ignore[arg-type]
    engine.push([1, 2, 3], 0.0)  # type: ignore[arg-type]
    interval.render("now")  # type: ignore[arg-type]
    interval.start = 1.0  # type: ignore[misc]
    streamsplat_cpu.Splats(np.zeros((1, 3)), 3, [0.5])  # type: ignore[arg-type]
    streamsplat_cpu.reconstruct("clip.mp4", "out", progress=3)  # type: ignore[arg-type]
