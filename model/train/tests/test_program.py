"""The images training minimises are those the program draws: the rasteriser here beside `streamsplat splat`."""
import os
import pathlib
import subprocess

import pytest
import torch
from conftest import HERE
from safetensors.torch import load_file, save_file

from train.rasteriser import render

PROGRAM = pathlib.Path(os.environ.get('STREAMSPLAT', HERE.parents[3] / 'target/release/streamsplat'))


def drawn_by_the_program(folder, xyz, scale, opacity, rgb, background, H, W):
    """World-space Gaussians of one image in view space (right x, down -z, forward depth), through the program."""
    assert PROGRAM.exists(), f'{PROGRAM} is not built: cargo build --release, or name it in STREAMSPLAT'
    depth = 1 / (9.8 * xyz[:, 1] + 0.2 + 1e-6)
    n = len(xyz)
    save_file(dict(mean=torch.stack([xyz[:, 0], -xyz[:, 2], depth], -1), scale=torch.cat([scale, scale.mean(-1, keepdim=True)], -1),
                   quat=torch.tensor([1.0, 0, 0, 0]).repeat(n, 1), opacity=opacity, rgb=rgb, background=background,
                   focal=torch.tensor([W / 2, H / 2]), size=torch.tensor([H, W])), str(folder / 'scene.safetensors'))
    subprocess.run([PROGRAM, 'splat', '--quiet', folder / 'scene.safetensors', folder / 'image.safetensors'], check=True)
    return load_file(str(folder / 'image.safetensors'))


@pytest.mark.parametrize('ties', (False, True))
def test_images_are_those_of_the_program(ties, tmp_path):
    g = torch.Generator().manual_seed(7)
    r = lambda *n: torch.rand(*n, generator=g)
    n, H, W = 1500, 40, 72
    xyz = torch.stack([2.2 * r(n) - 1.1, 0.02 + 0.96 * r(n), 2.2 * r(n) - 1.1], -1)
    if ties:                                             # as trained: one depth, the order is that of storage
        xyz[:, 1] = 0.5
    scale, opacity, rgb, background = 0.004 + 0.05 * r(n, 2) ** 3, 0.05 + 0.95 * r(n), r(n, 3), r(3)
    want = drawn_by_the_program(tmp_path, xyz, scale, opacity, rgb, background, H, W)
    image, T = render(xyz[None], scale[None], opacity[None], rgb[None], H, W, background[None])
    assert float((image[0, :3] - want['rgb']).abs().max()) < 2e-4
    assert float((image[0, 3] - want['depth']).abs().max()) < 2e-4 * float(want['depth'].max())
    assert float((T[0] - want['final_T']).abs().max()) < 1e-4
