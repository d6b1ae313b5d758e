"""Ordinary video in, a dynamic 3D Gaussian scene out, online, on CPUs, the same to the last bit everywhere.

    import streamsplat_cpu

    engine = streamsplat_cpu.Engine()
    for frame, time in streamsplat_cpu.Frames("clip.y4m"):
        interval = engine.push(frame, time)          # every frame a key frame
        interval.gaussians.mean                      # NumPy, no copies
        image = interval.render(time)                # image.rgb: [height, width, 3]

`reconstruct` does what the command line's `run` does. A wrong argument is a ValueError, a file that cannot be
written an OSError, and everything else that fails a streamsplat_cpu.Error.
"""

from ._streamsplat import Engine, Error, Frames, Gaussians, Image, Interval, Scene, SceneWriter, __version__
from .clip import Reconstructing, Reconstruction, reconstruct

__all__ = [
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
    "__version__",
    "reconstruct",
]
