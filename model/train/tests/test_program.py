"""Training minimises images like those of the program: this rasteriser against `splat` of the crate streamsplat-tests."""
import math
import os
import pathlib
import subprocess

import pytest
import torch
from conftest import HERE
from safetensors.torch import load_file, save_file

from train.rasteriser import render, render_turned

PROGRAM = pathlib.Path(os.environ.get('STREAMSPLAT_SPLAT', HERE.parents[3] / 'target/release/splat'))


def drawn_by_the_program(folder, xyz, scale, opacity, rgb, background, H, W, degrees=0.0, pivot=0.0):
    """World-space Gaussians of one image in view space (right x, down -z, forward depth), turned around the vertical at `pivot`, through the program."""
    assert PROGRAM.exists(), f'{PROGRAM} is not built: cargo build --release -p streamsplat-tests --bin splat, or name it in STREAMSPLAT_SPLAT'
    depth = 1 / (9.8 * xyz[:, 1] + 0.2 + 1e-6)
    n, c, s, half = len(xyz), math.cos(math.radians(degrees)), math.sin(math.radians(degrees)), math.radians(degrees) / 2
    mean = torch.stack([c * xyz[:, 0] - s * (depth - pivot), -xyz[:, 2], pivot + s * xyz[:, 0] + c * (depth - pivot)], -1)
    save_file(dict(mean=mean, scale=torch.cat([scale, scale.mean(-1, keepdim=True)], -1),
                   quat=torch.tensor([math.cos(half), 0, -math.sin(half), 0]).repeat(n, 1), opacity=opacity, rgb=rgb, background=background,
                   focal=torch.tensor([W / 2, H / 2]), size=torch.tensor([H, W])), str(folder / 'scene.safetensors'))
    subprocess.run([PROGRAM, folder / 'scene.safetensors', folder / 'image.safetensors'], check=True)
    return load_file(str(folder / 'image.safetensors'))


def gaussians(n):
    """xyz, scale, opacity, rgb of `n` Gaussians all over the image and around it, and a background."""
    g = torch.Generator().manual_seed(7)
    r = lambda *n: torch.rand(*n, generator=g)
    xyz = torch.stack([2.2 * r(n) - 1.1, 0.02 + 0.96 * r(n), 2.2 * r(n) - 1.1], -1)
    return xyz, 0.004 + 0.05 * r(n, 2) ** 3, 0.05 + 0.95 * r(n), r(n, 3), r(3)


@pytest.mark.parametrize('ties', (False, True))
def test_images_are_those_of_the_program(ties, tmp_path):
    H, W = 40, 72
    xyz, scale, opacity, rgb, background = gaussians(1500)
    if ties:                                             # as trained: one depth, the order is that of storage
        xyz[:, 1] = 0.5
    want = drawn_by_the_program(tmp_path, xyz, scale, opacity, rgb, background, H, W)
    image, T = render(xyz[None], scale[None], opacity[None], rgb[None], H, W, background[None])
    assert float((image[0, :3] - want['rgb']).abs().max()) < 2e-4
    assert float((image[0, 3] - want['depth']).abs().max()) < 2e-4 * float(want['depth'].max())
    assert float((T[0] - want['final_T']).abs().max()) < 1e-4


def test_views_from_the_side_are_those_of_the_program(tmp_path):
    H, W = 40, 72
    xyz, scale, opacity, rgb, background = gaussians(1500)
    xyz[:, 1] = 0.3 + 0.4 * xyz[:, 1]                    # all in front of the turned camera too
    want = drawn_by_the_program(tmp_path, xyz, scale, opacity, rgb, background, H, W, 10.0, 0.2)
    image, T = render_turned(xyz[None], scale[None], opacity[None], rgb[None], H, W, background[None], 10.0, torch.tensor([0.2]))
    assert float((image[0, :3] - want['rgb']).abs().max()) < 5e-4
    assert float((T[0] - want['final_T']).abs().max()) < 2e-4
