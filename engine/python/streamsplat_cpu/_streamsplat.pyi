"""Types of the extension module."""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from types import TracebackType
from typing import Any, Literal, Protocol, TypeVar, final, overload

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

type _OneCamera = Camera | Mapping[str, Any] | str | os.PathLike[str]
type _Camera = _OneCamera | None
# Any of these types: a list of one kind is a list of cameras, too.
_C = TypeVar("_C", bound=Camera | Mapping[str, Any] | str | os.PathLike[str] | None)
type _Size = str | tuple[int, int]
type _Background = float | tuple[float, float, float]

class _Array(Protocol):
    """Objects that convert to a NumPy array, for example torch's tensors."""

    def __array__(self) -> NDArray[Any]: ...

class _ArrayInterface(Protocol):
    """Objects with the interface of a NumPy array, for example PIL's images."""

    @property
    def __array_interface__(self) -> dict[str, Any]: ...

type _Frame = NDArray[np.uint8] | NDArray[np.floating[Any]] | _Array | _ArrayInterface
type _Numbers = NDArray[Any] | _Array | Sequence[Any]

__all__ = [
    "Camera",
    "Engine",
    "Error",
    "Frames",
    "Gaussians",
    "Image",
    "Interval",
    "Scene",
    "SceneWriter",
    "Splats",
    "Planes",
    "View",
    "Viewer",
    "__version__",
    "cameras",
    "harmonics",
    "harmonics_gradients",
    "main",
    "run",
]

__version__: str

def harmonics(
    coefficients: NDArray[np.float32], degree: int, means: NDArray[np.float32], eye: Sequence[float]
) -> NDArray[np.float32]:
    """Computes colours `[N, 3]` from harmonics `[N, K, 3]` up to `degree`, seen from `eye`."""

def harmonics_gradients(
    coefficients: NDArray[np.float32],
    degree: int,
    means: NDArray[np.float32],
    eye: Sequence[float],
    colors: NDArray[np.float32],
    of_colors: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.float32], list[float]]:
    """Computes gradients by coefficients, means and the eye from those by the colours of `harmonics`."""

@final
class Planes:
    """Splats in the planes of several images, as training draws them."""

    def __new__(
        cls, splats: NDArray[np.float32], keys: NDArray[np.float32], width: int, height: int, largest_alpha: float
    ) -> Self:
        """Builds the lists of `splats [M, N, 5]` (u, v, variances along x and y, opacity) in the order of `keys [M, N]`."""

    def draw(
        self, colors: NDArray[np.float32], backgrounds: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Draws images `[M, H, W, D]` and alphas `[M, H, W]` in `colors [M, N, D]` on `backgrounds [M, D]`."""

    def gradients(
        self,
        colors: NDArray[np.float32],
        backgrounds: NDArray[np.float32],
        images: NDArray[np.float32],
        alphas: NDArray[np.float32],
        of_images: NDArray[np.float32],
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Computes gradients by splats `[M, N, 5]` and colours `[M, N, D]` from the drawn images and the gradient by them."""

@final
class View:
    """Gaussians as seen by one camera."""

    def __new__(
        cls,
        means: NDArray[np.float32],
        quats: NDArray[np.float32],
        scales: NDArray[np.float32],
        opacities: NDArray[np.float32],
        viewmat: NDArray[np.float32],
        k: NDArray[np.float32],
        width: int,
        height: int,
        near_plane: float,
        far_plane: float,
        radius_clip: float,
        eps2d: float,
        antialiased: bool,
        orthographic: bool,
        largest_alpha: float = 0.999,
    ) -> Self: ...
    def projected(
        self,
    ) -> tuple[
        NDArray[np.float32],
        NDArray[np.float32],
        NDArray[np.float32],
        NDArray[np.float32],
        NDArray[np.int32],
        NDArray[np.float32],
    ]:
        """Returns centres `[N, 2]`, depths `[N]`, conics `[N, 3]`, opacities `[N]`, radii `[N, 2]`, and the eye's position `[3]`."""

    def draw(
        self, colors: NDArray[np.float32], background: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Draws image `[H, W, D]` and alpha `[H, W]` in colours `[N, D]`, on a background `[D]` (or an empty array)."""

    def draw_gradients(
        self,
        colors: NDArray[np.float32],
        background: NDArray[np.float32],
        image: NDArray[np.float32],
        alpha: NDArray[np.float32],
        of_image: NDArray[np.float32],
        of_alpha: NDArray[np.float32],
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """Computes gradients by footprints `[N, 6]`, colours `[N, D]` and background, from image, alpha and the gradients by them."""

    def gradients(
        self,
        means: NDArray[np.float32],
        quats: NDArray[np.float32],
        scales: NDArray[np.float32],
        opacities: NDArray[np.float32],
        footprints: NDArray[np.float32],
        of_depth: NDArray[np.float32],
        of_eye: Sequence[float],
    ) -> tuple[
        NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]
    ]:
        """Computes gradients by means, quaternions, scales, opacities and the view matrix, from those by footprints, depths and the eye."""

def main(arguments: Sequence[str]) -> int:
    """Runs the program with these arguments, the first of which is its name, and returns its exit code."""

def run(
    input: str | Iterable[_Frame] | Iterable[tuple[_Frame, float]],
    out: str,
    options: list[tuple[str, str]],
    progress: Callable[[int, int | None], object] | None,
) -> str:
    """Reconstructs `input`, a path or frames, into `out` and returns the record in JSON; `options` are names and texts of the options of `streamsplat run`."""

def cameras(path: str | os.PathLike[str], *, size: _Size | None = None) -> list[Camera]:
    """Returns the cameras of a file of this program, 3D Gaussian splatting, nerfstudio, instant-ngp, Blender, SuperSplat or COLMAP, in its order."""

class Error(Exception):
    """Failure of the engine; the message contains the expected and the found values."""

@final
class Camera:
    """A view of a scene: a pose, a lens, and the size of its image, if it has one."""

    def __new__(cls, viewmat: _Numbers, K: _Numbers, width: int, height: int, *, name: str = "") -> Self: ...
    @staticmethod
    def look_at(
        position: Sequence[float],
        target: Sequence[float],
        *,
        up: Sequence[float] = ...,
        fov_y: float = 45.0,
        width: int = 1280,
        height: int = 720,
    ) -> Camera:
        """Returns a pinhole at `position` that looks at `target`, with a vertical field of view of `fov_y` degrees."""
    def resized(self, width: int, height: int) -> Camera:
        """Returns the same view for an image of another size."""
    @property
    def viewmat(self) -> NDArray[np.float32]:
        """From the world to the camera, [4, 4]."""
    @property
    def K(self) -> NDArray[np.float32]:
        """Focal lengths and principal point in pixels, [3, 3]."""
    @property
    def position(self) -> tuple[float, float, float]: ...
    @property
    def size(self) -> tuple[int, int] | None: ...
    @property
    def name(self) -> str: ...
    @property
    def time(self) -> float | None: ...
    @property
    def kind(self) -> str: ...

@final
class Splats:
    """Gaussians in the world at one time: read-only arrays for gsplat, viser, Rerun and nerfstudio."""

    def __new__(
        cls,
        means: _Numbers,
        scales: _Numbers,
        opacities: _Numbers,
        *,
        quats: _Numbers | None = None,
        colors: _Numbers | None = None,
        sh: _Numbers | None = None,
    ) -> Self: ...
    @staticmethod
    def of_bytes(data: bytes, name: str = "") -> Splats:
        """Reads the still scene of a file in memory; `.splat` and `.ksplat` are recognised by the ending of `name`."""
    def __len__(self) -> int: ...
    @property
    def means(self) -> NDArray[np.float32]:
        """Centres, [N, 3], relative to `offset`."""
    @property
    def quats(self) -> NDArray[np.float32]:
        """Unit quaternions (w, x, y, z), [N, 4]."""
    @property
    def scales(self) -> NDArray[np.float32]:
        """Standard deviations, [N, 3]."""
    @property
    def covariances(self) -> NDArray[np.float32]:
        """Covariances, [N, 3, 3]: a copy."""
    @property
    def opacities(self) -> NDArray[np.float32]:
        """Opacities, [N]."""
    @property
    def colors(self) -> NDArray[np.float32]:
        """Display-space colours, [N, 3]: the mean over all directions."""
    @property
    def sh(self) -> NDArray[np.float32]:
        """Coefficients of the harmonics, [N, K, 3]."""
    @property
    def sh_degree(self) -> int: ...
    @property
    def identities(self) -> NDArray[np.uint64]:
        """Numbers of the Gaussians, [N]."""
    @property
    def drawable(self) -> NDArray[np.bool_]:
        """True for Gaussians that can be drawn, [N]."""
    @property
    def offset(self) -> tuple[float, float, float]: ...
    @property
    def antialiased(self) -> bool: ...
    @overload
    def render(
        self,
        camera: _Camera = None,
        *,
        size: _Size | None = None,
        background: _Background | None = None,
        depth: bool = False,
        alpha: bool = False,
        antialias: bool | None = None,
    ) -> Image:
        """Draws the scene from `camera`, by default its own view; a list of cameras returns a list of images."""
    @overload
    def render(
        self,
        camera: list[_C] | tuple[_C, ...],
        *,
        size: _Size | None = None,
        background: _Background | None = None,
        depth: bool = False,
        alpha: bool = False,
        antialias: bool | None = None,
    ) -> list[Image]: ...
    def camera(self, degrees: float = 0.0, *, size: _Size | None = None) -> Camera:
        """Returns the camera that sees most of the scene, `degrees` around it."""
    def orbit(self, count: int, *, size: _Size | None = None) -> list[Camera]:
        """Returns `count` cameras once around the scene."""
    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a .ply, .compressed.ply, .spz, .sog, .glb or .splat file."""
    def _repr_png_(self) -> bytes: ...

@final
class Viewer:
    """A page that is served on the loopback address until it is closed."""

    @property
    def url(self) -> str: ...
    def close(self) -> None: ...
    def __enter__(self) -> Self: ...
    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> bool: ...

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
        guess_depth: bool | None = None,
        refine_to: float | None = None,
        detail: int | None = None,
        still: str | None = None,
        behind: Literal["on", "off"] | None = None,
    ) -> Self: ...
    def push(
        self,
        frame: _Frame,
        time: float,
        depth: NDArray[np.float32] | None = None,
        *,
        between: Sequence[tuple[_Frame, float]] | None = None,
    ) -> Interval:
        """Processes the next key frame ([height, width, 3]) and returns the interval that it ends; `between`: the frames since the last one, with times."""
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
        antialias: bool = False,
    ) -> Image:
        """Draws the scene at `time` seconds; a list of images if `time` or `camera` is a list."""
    @overload
    def render(
        self,
        time: Sequence[float],
        camera: _Camera | list[_C] | tuple[_C, ...] = None,
        *,
        size: _Size | None = None,
        background: _Background | None = None,
        depth: bool = False,
        alpha: bool = False,
        antialias: bool = False,
    ) -> list[Image]: ...
    @overload
    def render(
        self,
        time: float,
        camera: list[_C] | tuple[_C, ...],
        *,
        size: _Size | None = None,
        background: _Background | None = None,
        depth: bool = False,
        alpha: bool = False,
        antialias: bool = False,
    ) -> list[Image]: ...
    def at(self, time: float | None = None) -> Splats:
        """Returns the Gaussians at `time`, by default the interval's end, in the world."""
    def _repr_png_(self) -> bytes: ...
    def save(self, path: str | os.PathLike[str], time: float | None = None) -> None:
        """Writes the Gaussians at `time`, by default the interval's end, as a .ply, .compressed.ply, .spz, .sog, .glb or .splat file."""
    def pick(self, time: float, pixel: tuple[float, float]) -> tuple[int, int, float, list[float]] | None:
        """Returns (identity, index, weight, world position) of the most visible Gaussian at a pixel of the source's frame."""

@final
class Gaussians:
    """The Gaussians of an interval: read-only arrays that share its memory."""

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
    """A drawn image: read-only arrays that share its memory."""

    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def dropped(self) -> int: ...
    @property
    def rgb(self) -> NDArray[np.float32]:
        """Display-space colour, [height, width, 3]: a read-only view; `.copy()` returns a writable array.

        From 0 to about 1: harmonics and rounding may exceed 1, and nothing is clamped before `rgb8`."""
    @property
    def depth(self) -> NDArray[np.float32] | None:
        """Σ z·α·T, [height, width]; divided by `alpha`, the mean depth. None unless `render(depth=True)`."""
    @property
    def alpha(self) -> NDArray[np.float32] | None:
        """Σ α·T, [height, width]. None unless `render(alpha=True)`."""
    def png(self) -> bytes: ...
    def _repr_png_(self) -> bytes: ...
    def rgb8(self) -> NDArray[np.uint8]:
        """Returns the samples of the PNG file, [height, width, 3]: a copy."""
    @property
    def __array_interface__(self) -> dict[str, Any]:
        """The samples of `rgb8`, for NumPy and Pillow."""
    def tobytes(self) -> bytes: ...
    def __len__(self) -> int:
        """Number of rows, as of its array."""
    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a .png, .webp or .exr file; other formats are written by Pillow."""

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
    """A scene on disk: a scene in time, whose intervals are read when needed, or a still scene, a splat file."""

    def __new__(cls, path: str | os.PathLike[str], *, isa: str = "auto", threads: int = 0) -> Self: ...
    @property
    def is_still(self) -> bool: ...
    @property
    def fps(self) -> float: ...
    @property
    def span(self) -> tuple[float, float]: ...
    @property
    def times(self) -> list[tuple[float, float]]: ...
    def __len__(self) -> int: ...
    def __bool__(self) -> bool: ...
    @overload
    def __getitem__(self, i: int, /) -> Interval: ...
    @overload
    def __getitem__(self, i: slice, /) -> list[Interval]: ...
    def interval(self, time: float) -> Interval:
        """Returns the interval that shows `time`."""
    def at(self, time: float | None = None) -> Splats:
        """Returns the Gaussians at `time` seconds, in the world; for a still scene, without a time."""
    def view(self, *, port: int = 0, open: bool = True) -> Viewer:
        """Opens the page of `streamsplat view` in the browser."""
    def _repr_png_(self) -> bytes: ...
    @overload
    def render(
        self,
        time: float | None = None,
        camera: _Camera = None,
        *,
        size: _Size | None = None,
        background: _Background | None = None,
        depth: bool = False,
        alpha: bool = False,
        antialias: bool | None = None,
    ) -> Image:
        """Draws the scene at `time` seconds, or a still scene from a camera; a list of images if `time` or `camera` is a list."""
    @overload
    def render(
        self,
        time: _OneCamera,
        camera: None = None,
        *,
        size: _Size | None = None,
        background: _Background | None = None,
        depth: bool = False,
        alpha: bool = False,
        antialias: bool | None = None,
    ) -> Image: ...
    @overload
    def render(
        self,
        time: list[_C] | tuple[_C, ...],
        camera: None = None,
        *,
        size: _Size | None = None,
        background: _Background | None = None,
        depth: bool = False,
        alpha: bool = False,
        antialias: bool | None = None,
    ) -> list[Image]: ...
    @overload
    def render(
        self,
        time: Sequence[float],
        camera: _Camera | list[_C] | tuple[_C, ...] = None,
        *,
        size: _Size | None = None,
        background: _Background | None = None,
        depth: bool = False,
        alpha: bool = False,
        antialias: bool | None = None,
    ) -> list[Image]: ...
    @overload
    def render(
        self,
        time: float | None,
        camera: list[_C] | tuple[_C, ...],
        *,
        size: _Size | None = None,
        background: _Background | None = None,
        depth: bool = False,
        alpha: bool = False,
        antialias: bool | None = None,
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
