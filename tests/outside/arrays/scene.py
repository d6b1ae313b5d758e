"""A scene of a video and a still one with harmonics, as arrays."""

from pathlib import Path

import numpy as np
import streamsplat_cpu


def scenes(out: Path):
    """Gaussians of a video's scene, and a cloud of 500 with harmonics of degree 3."""
    rng = np.random.default_rng(11)
    cloud = streamsplat_cpu.Splats(
        rng.uniform(-1, 1, (500, 3)), rng.uniform(0.01, 0.1, (500, 3)), rng.uniform(0.1, 0.9, 500), quats=rng.normal(size=(500, 4)),
        sh=rng.normal(0, 0.2, (500, 16, 3)))
    return {'video': streamsplat_cpu.Scene(out).at(0.1), 'cloud': cloud}
