"""A whole clip: video in, scene and frames on disk."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ._streamsplat import Engine, Error, Frames, SceneWriter


@dataclass(frozen=True)
class Reconstruction:
    """What `reconstruct` wrote."""

    path: Path
    frames: int
    key_frames: int
    work: dict[str, dict[str, Any]]


def reconstruct(
    input: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    gap: int = 1,
    fps: float | None = None,
    size: str | tuple[int, int] = "model",
    background: float | tuple[float, float, float] = 0.5,
    **settings: Any,
) -> Reconstruction:
    """Reconstructs a video into the folder `out`: `scene/` and `frames/000000.png` and so on.

    Every `gap`-th frame and the last one are key frames; the others are drawn from the scene at their own times. `settings` are the
    arguments of `Engine`. The files are those of `streamsplat run INPUT --gap GAP --out OUT`, byte for byte. `out` must not
    exist or be empty; it appears when it is whole.
    """
    if gap < 1:
        raise ValueError(f"gap: expected a whole number from 1, found {gap}")
    out = Path(out)
    if out.exists() and any(out.iterdir()):
        raise Error(f"{out}: expected a new or empty folder, found one with files")
    frames = Frames(input, fps=fps)
    engine = Engine(**settings)
    partial = out.with_name(f".{out.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    (partial / "frames").mkdir(parents=True)
    try:
        count, keys = _stream(frames, engine, partial, gap, size, background)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    if out.exists():
        out.rmdir()
    partial.rename(out)
    return Reconstruction(out, count, keys, engine.work)


def _stream(
    frames: Frames,
    engine: Engine,
    folder: Path,
    gap: int,
    size: str | tuple[int, int],
    background: float | tuple[float, float, float],
) -> tuple[int, int]:
    """Writes scene and images; gives the number of frames and of key frames."""
    count = keys = 0
    waiting: list[tuple[int, float, Any]] = []
    last = None
    with SceneWriter(folder / "scene", frames.fps) as scene:

        def key_frame(frame: Any, time: float) -> None:
            interval = engine.push(frame, time, between=[(seen, at) for _, at, seen in waiting[:-1]])
            scene.push(interval)
            for index, at, _ in waiting:
                interval.render(at, size=size, background=background).save(folder / "frames" / f"{index:06}.png")
            waiting.clear()

        for frame, time in frames:
            waiting.append((count, time, frame))
            if count % gap == 0:
                key_frame(frame, time)
                keys += 1
            last = (frame, time)
            count += 1
        if last is None:
            raise Error("the video has no frame")
        if waiting:
            key_frame(*last)
            keys += 1
    return count, keys
