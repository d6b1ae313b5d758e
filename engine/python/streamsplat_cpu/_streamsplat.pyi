"""Types of the extension module."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import TracebackType
from typing import Any, Literal, Protocol, final, overload

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

type _Camera = Mapping[str, Any] | str | os.PathLike[str] | None
type _Cameras = list[_Camera] | tuple[_Camera, ...]
type _Size = str | tuple[int, int]
type _Background = float | tuple[float, float, float]

class _Array(Protocol):
    """Objects that make a NumPy array of themselves, such as torch's tensors."""

    def __array__(self) -> NDArray[Any]: ...

class _ArrayInterface(Protocol):
    """Objects that show a NumPy array of themselves, such as PIL's images."""

    @property
    def __array_interface__(self) -> dict[str, Any]: ...

type _Frame = NDArray[np.uint8] | NDArray[np.float32] | _Array | _ArrayInterface

__all__ = ["Engine", "Error", "Frames", "Gaussians", "Image", "Interval", "Scene", "SceneWriter", "__version__", "main", "run"]

__version__: str

def main(arguments: Sequence[str]) -> int:
    """Runs the program with these arguments, the first of which is its name, and gives its exit code."""

def run(input: str, out: str, options: list[tuple[str, str]], progress: Callable[[int, int | None], object] | None) -> str:
    """Reconstructs `input` into `out` and returns the record in JSON; `options` are names and texts of the options of `streamsplat run`."""

class Error(Exception):
    """Something that the engine cannot do; the message says what was expected and what was found."""

@final
class Engine:
    """Turns key frames into a dynamic scene, one interval per key frame."""

    def __new__(
        cls,
        model: str | os.PathLike[str] | None = None,
        *,
        dinov2: str | os.PathLike[str] | None = None,
        fusion: Literal["persistent", "pairwise"] = "persistent",
        max_age: int | None = None,
        fit: Literal["letterbox", "stretch"] = "letterbox",
        depth_range: Literal["frame", "given"] = "frame",
        sampling: Literal["mean", "sample"] = "mean",
        seed: int = 0,
        reuse: str | None = None,
        precision: Literal["f32", "bf16", "int8"] | None = None,
        isa: Literal["auto", "scalar", "avx2", "avx512", "avx512vnni", "avx512bf16", "neon"] = "auto",
        threads: int = 0,
        resolution: str | None = None,
        motion: Literal["network", "frames", "between"] | None = None,
        refine: int | None = None,
        flow: Literal["fine", "coarse"] | None = None,
        fade: Literal["network", "fixed"] | None = None,
        refine_every: int | None = None,
        quality: Literal["realtime", "balanced", "best"] | None = None,
        find_depth: bool | None = None,
    ) -> Self: ...
    def push(
        self,
        frame: _Frame,
        time: float,
        depth: NDArray[np.float32] | None = None,
        *,
        between: Sequence[tuple[_Frame, float]] | None = None,
    ) -> Interval:
        """Takes the next key frame ([height, width, 3]) and gives the interval it ends; `between`: the frames since the one before, with their times."""
    @property
    def work(self) -> dict[str, dict[str, Any]]:
        """Work done and avoided per stage."""
    @property
    def isa(self) -> str: ...
    @property
    def threads(self) -> int: ...

@final
class Interval:
    """The scene from one key frame to the next."""

    @property
    def index(self) -> int: ...
    @property
    def start(self) -> float: ...
    @property
    def end(self) -> float: ...
    @property
    def dropped(self) -> int: ...
    @property
    def merges(self) -> list[tuple[int, int]]: ...
    @property
    def gaussians(self) -> Gaussians: ...
    def __len__(self) -> int: ...
    @overload
    def render(
        self,
        time: float,
        camera: _Camera = None,
        *,
        size: _Size | None = None,
        background: _Background | None = None,
        depth: bool = False,
        alpha: bool = False,
    ) -> Image:
        """The scene at `time` seconds; a list of images where `time` or `camera` is a list."""
    @overload
    def render(
        self,
        time: Sequence[float],
        camera: _Camera | _Cameras = None,
        *,
        size: _Size | None = None,
        background: _Background | None = None,
        depth: bool = False,
        alpha: bool = False,
    ) -> list[Image]: ...
    @overload
    def render(
        self,
        time: float,
        camera: _Cameras,
        *,
        size: _Size | None = None,
        background: _Background | None = None,
        depth: bool = False,
        alpha: bool = False,
    ) -> list[Image]: ...
    def save(self, path: str | os.PathLike[str], time: float | None = None) -> None:
        """Writes the Gaussians at `time`, the interval's end unless told, as a .ply, .compressed.ply, .spz, .sog, .glb or .splat file."""
    def pick(self, time: float, pixel: tuple[float, float]) -> tuple[int, int, float, list[float]] | None:
        """(identity, index, weight, world position) of what shows most at a pixel of the source's frame."""

@final
class Gaussians:
    """The Gaussians of an interval: read-only arrays that show its memory."""

    def __len__(self) -> int: ...
    @property
    def mean(self) -> NDArray[np.float32]: ...
    @property
    def velocity(self) -> NDArray[np.float32]: ...
    @property
    def gamma(self) -> NDArray[np.float32]: ...
    @property
    def opacity(self) -> NDArray[np.float32]: ...
    @property
    def scale(self) -> NDArray[np.float32]: ...
    @property
    def thickness(self) -> NDArray[np.float32]: ...
    @property
    def rgb(self) -> NDArray[np.float32]: ...
    @property
    def rgb_rate(self) -> NDArray[np.float32]: ...
    @property
    def identity(self) -> NDArray[np.uint64]: ...
    @property
    def birth(self) -> NDArray[np.uint64]: ...
    @property
    def frame(self) -> NDArray[np.uint64]: ...
    @property
    def offset(self) -> NDArray[np.float32]: ...
    @property
    def reference(self) -> NDArray[np.uint8]: ...
    @property
    def handover(self) -> NDArray[np.uint8]: ...

@final
class Image:
    """A drawn image: read-only arrays that show its memory."""

    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def dropped(self) -> int: ...
    @property
    def rgb(self) -> NDArray[np.float32]:
        """Display-space colour, [height, width, 3]: a read-only view; `.copy()` gives an array that can be written to."""
    @property
    def depth(self) -> NDArray[np.float32] | None: ...
    @property
    def alpha(self) -> NDArray[np.float32] | None: ...
    def png(self) -> bytes: ...
    def _repr_png_(self) -> bytes: ...
    def rgb8(self) -> NDArray[np.uint8]:
        """The samples of the PNG file, [height, width, 3]: a copy."""
    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """The image as `rgb8`, a copy; as float32 a read-only view of it, as `rgb`."""
    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a .png file, or by Pillow what else that writes."""

@final
class Frames:
    """The frames of a video: pairs (frame, time)."""

    def __new__(cls, input: str | os.PathLike[str], *, fps: float | None = None) -> Self: ...
    @property
    def fps(self) -> float: ...
    @property
    def count(self) -> int | None: ...
    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[tuple[NDArray[np.float32], float]]: ...
    def __next__(self) -> tuple[NDArray[np.float32], float]: ...

@final
class Scene:
    """A scene on disk; its intervals are read when they are asked for."""

    def __new__(cls, path: str | os.PathLike[str], *, isa: str = "auto", threads: int = 0) -> Self: ...
    @property
    def fps(self) -> float: ...
    @property
    def span(self) -> tuple[float, float]: ...
    @property
    def times(self) -> list[tuple[float, float]]: ...
    def __len__(self) -> int: ...
    def __getitem__(self, i: int, /) -> Interval: ...
    def at(self, time: float) -> Interval: ...
    @overload
    def render(
        self,
        time: float,
        camera: _Camera = None,
        *,
        size: _Size | None = None,
        background: _Background | None = None,
        depth: bool = False,
        alpha: bool = False,
    ) -> Image: ...
    @overload
    def render(
        self,
        time: Sequence[float],
        camera: _Camera | _Cameras = None,
        *,
        size: _Size | None = None,
        background: _Background | None = None,
        depth: bool = False,
        alpha: bool = False,
    ) -> list[Image]: ...
    @overload
    def render(
        self,
        time: float,
        camera: _Cameras,
        *,
        size: _Size | None = None,
        background: _Background | None = None,
        depth: bool = False,
        alpha: bool = False,
    ) -> list[Image]: ...

@final
class SceneWriter:
    """Writes a scene while it grows."""

    def __new__(cls, path: str | os.PathLike[str], fps: float) -> Self: ...
    def push(self, interval: Interval) -> None: ...
    def finish(self) -> None: ...
    def __enter__(self) -> Self: ...
    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> bool: ...
