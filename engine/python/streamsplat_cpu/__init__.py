"""3D Gaussians on CPUs: draws splat files and arrays from any camera, and turns ordinary video into scenes in time; the same bits everywhere.

    import streamsplat_cpu

    scene = streamsplat_cpu.Scene("garden.ply")      # or .spz, .sog, .splat, .glb, …
    scene.render(size="640x360").save("garden.png")
    splats = scene.at()                              # means, quats, scales, opacities, colors, sh: NumPy, no copies
    images = splats.render(splats.orbit(24))         # or cameras("transforms.json"), Camera(viewmat, K, width, height)

    engine = streamsplat_cpu.Engine()
    for frame, time in streamsplat_cpu.Frames("clip.y4m"):
        interval = engine.push(frame, time)          # every frame a key frame
        interval.at(time).means                      # the Gaussians in the world
        image = interval.render(time)                # image.rgb: [height, width, 3]

`rasterization` is gsplat's function, for NumPy arrays or for PyTorch's tensors, with gradients.

`reconstruct` is the command line's `run`, for files or for frames in memory. Arrays are read-only; `.copy()` returns a writable one, and
`torch.from_dlpack(array)` a tensor that shares its memory (it must not be written to).

An argument of a wrong type raises a TypeError, a wrong value a ValueError. A missing file raises a FileNotFoundError, a file that cannot be read
or written another OSError. All other failures raise a streamsplat_cpu.Error: a broken file, a frame that the engine cannot process, a time outside
the scene.
"""

from ._streamsplat import (
    Camera,
    Engine,
    Error,
    Frames,
    Gaussians,
    Image,
    Interval,
    Scene,
    SceneWriter,
    Splats,
    Viewer,
    __version__,
    cameras,
)
from .clip import Reconstructing, Reconstruction, reconstruct
from .raster import rasterization

__all__ = [
    "Camera",
    "Engine",
    "Error",
    "Frames",
    "Gaussians",
    "Image",
    "Interval",
    "Reconstructing",
    "Reconstruction",
    "Scene",
    "SceneWriter",
    "Splats",
    "Viewer",
    "__version__",
    "cameras",
    "rasterization",
    "reconstruct",
]
