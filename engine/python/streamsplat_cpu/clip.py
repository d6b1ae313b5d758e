"""Reconstruction of a whole clip: video in, scene and images on disk."""

from __future__ import annotations

import json
import os
import queue
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import _streamsplat

if TYPE_CHECKING:
    from ._streamsplat import _Frame


@dataclass(frozen=True)
class Reconstruction:
    """Results of `reconstruct`."""

    path: Path
    frames: int
    key_frames: int
    work: dict[str, dict[str, Any]]
    record: dict[str, Any]
    """The content of `run.json`."""


def _text(name: str, value: Any) -> str:
    """Returns the value of an option in the command line's form."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (tuple, list)):
        return ("x" if name == "size" else ",").join(str(part) for part in value)
    return os.fspath(value) if isinstance(value, os.PathLike) else str(value)


def _input(input: Any) -> Any:
    """Returns a path as text, anything else unchanged."""
    return os.fspath(input) if isinstance(input, os.PathLike) else input


def reconstruct(
    input: str | os.PathLike[str] | Iterable[_Frame] | Iterable[tuple[_Frame, float]],
    out: str | os.PathLike[str],
    *,
    progress: Callable[[int, int | None], object] | None = None,
    **options: Any,
) -> Reconstruction:
    """Reconstructs a video as `streamsplat run INPUT --out OUT` does, with the same bytes.

    `input` is a file, a folder of images, or an iterable of frames in memory: arrays [height, width, 3], or pairs of an array and its time in seconds.
    `fps` replaces their times; frames without times are 1/24 s apart.

    `options` are those of the command line: `gap="auto"`, `quality="realtime"`, `size=(640, 360)`, `emit="rgb,scene"`, `fps=12`,
    `refine_every=2`, `overwrite=True`, `resume=True`, … An `out` with the ending of a video (`.mp4`, `.webm`, `.gif`, …) becomes a video, any
    other a folder with `scene/`, `frames/` and `run.json`. `progress(done, total)` is called as frames are done; an exception in it, or Ctrl-C, ends the
    run after the current interval, and `resume=True` continues from there.
    """
    given = [(name, _text(name, value)) for name, value in options.items() if value is not None and value is not False]
    record = json.loads(_streamsplat.run(_input(input), os.fspath(out), given, progress))
    work = record["work"]
    return Reconstruction(Path(out), record["input"]["count"], record["key_frames"], work, record)


class Reconstructing:
    """A running reconstruction: iterates over finished frames, `(done, total)`, as for `tqdm(..., total=…)`. Then `result` is that of `reconstruct`."""

    def __init__(
        self,
        input: str | os.PathLike[str] | Iterable[_Frame] | Iterable[tuple[_Frame, float]],
        out: str | os.PathLike[str],
        **options: Any,
    ) -> None:
        self.result: Reconstruction | None = None
        self._steps: queue.Queue[tuple[int, int | None] | None] = queue.Queue()
        self._error: BaseException | None = None
        self._stop = False

        def step(done: int, total: int | None) -> None:
            self._steps.put((done, total))
            if self._stop:
                raise _streamsplat.Error("stopped")

        def work() -> None:
            try:
                self.result = reconstruct(input, out, progress=step, **options)
            except BaseException as error:
                self._error = error
            finally:
                self._steps.put(None)

        self._thread = threading.Thread(target=work, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Ends the run after the current interval."""
        self._stop = True

    def __iter__(self) -> Iterator[tuple[int, int | None]]:
        try:
            while (step := self._steps.get()) is not None:
                yield step
        finally:
            self.stop()
            self._thread.join()
        if self._error is not None:
            raise self._error
