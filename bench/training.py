"""The rasteriser of `model/train` compared with the one before it: python3 bench/training.py [ROUNDS]

The previous one, rasteriser.cpp (only axis-aligned splats, compiled with -ffast-math), is in this repository's history, at commit COMMIT. Both draw the
same splats and differentiate the same loss, in turn; the medians of ROUNDS rounds (7 by default) and their ratio are printed. Images and gradients are
compared first. Needs PyTorch, streamsplat_cpu and g++.
"""
import importlib.util
import math
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

os.environ.setdefault('OMP_WAIT_POLICY', 'passive')

import torch

ROOT = pathlib.Path(__file__).resolve().parent.parent
COMMIT = '9fb3fd1^'
# Images, height, width, splats per image: a batch of the static stage, one of frames at half the size, pairs of the dynamic stage.
SCENES = [(24, 72, 128, 4608), (8, 144, 256, 18432), (4, 144, 256, 73728)]


def before(folder):
    """The module at COMMIT."""
    for name in ['rasteriser.py', 'rasteriser.cpp']:
        text = subprocess.check_output(['git', 'show', f'{COMMIT}:model/train/{name}'], cwd=ROOT)
        (folder / name).write_bytes(text)
    spec = importlib.util.spec_from_file_location('before', folder / 'rasteriser.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def scene(images, height, width, count, seed=0):
    """Splats like the network's: a grid of patches, footprints of about a pixel, opacities of all sizes."""
    random = torch.Generator().manual_seed(seed)
    uniform = lambda *shape: torch.rand(*shape, generator=random)
    pitch = math.sqrt(height * width / count)
    place = torch.stack([uniform(images, count) * width - 0.5, uniform(images, count) * height - 0.5], -1)
    sizes = (pitch * torch.exp(0.5 * torch.randn(images, count, 2, generator=random))) ** 2 + 0.3
    splats = torch.cat([place, sizes, uniform(images, count, 1)], -1)
    return splats, uniform(images, count, 4), uniform(images, count), uniform(images, 4), torch.randn(images, 4, height, width, generator=random)


def step(module, splats, values, key, background, weights):
    splats, values = splats.clone().requires_grad_(), values.clone().requires_grad_()
    began = time.perf_counter()
    image, _ = module.Splat.apply(splats, values, key, background, *weights.shape[-2:])
    (image * weights).sum().backward()
    return time.perf_counter() - began, image.detach(), splats.grad, values.grad


def apart(a, b):
    return float((a - b).norm() / b.norm())


def main():
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 7
    torch.set_num_threads(2)
    sys.path.insert(0, str(ROOT / 'model'))
    from train import rasteriser as now
    with tempfile.TemporaryDirectory() as folder:
        modules = [now, before(pathlib.Path(folder))]
        for kind in SCENES:
            what = scene(*kind)
            (_, *ours), (_, *theirs) = (step(module, *what) for module in modules)
            errors = [apart(a, b) for a, b in zip(ours, theirs)]
            if max(errors) > 2e-3:
                sys.exit(f'{kind}: expected images and gradients within 2e-3, found {errors}')
            times = [[step(module, *what)[0] for module in modules] for _ in range(rounds)]
            ours, theirs = (statistics.median(column) for column in zip(*times))
            ratios = sorted(b / a for a, b in times)
            print('{} images of {}x{}, {} splats: {:.1f} ms, {:.1f} before, {:.2f} times as fast ({:.2f} to {:.2f})'.format(
                kind[0], kind[1], kind[2], kind[3], 1e3 * ours, 1e3 * theirs, statistics.median(ratios), ratios[0], ratios[-1]))


if __name__ == '__main__':
    main()
