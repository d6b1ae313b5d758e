"""gsplat's PyTorch formulas on a CPU: `formulas(FOLDER)` is its module `gsplat.rendering`, unchanged, whose `_rasterization` then runs without CUDA.

This file replaces the part that it takes from CUDA: the Gaussians that a pixel's ray meets, as described for gsplat's `rasterize_to_indices_in_range` (an α
from 1/255, until T would be 10⁻⁴ or less). `nerfacc.py` next to this file has the two sums along rays that it takes from that package.
"""
import enum
import importlib
import sys
import types
from pathlib import Path

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).resolve().parent))
# Pairs of a Gaussian and a pixel that are processed together.
TOGETHER = 2_000_000
# The indices of the last call, where they are kept: with them a call costs only its formulas.
kept = {'wanted': False, 'found': None}


def isect_tiles(means2d, radii, depths, *_, **__):
    """The whole image as one tile: each image's Gaussians by depth."""
    count = means2d.shape[-2]
    order = torch.argsort(depths.detach().reshape(-1, count), dim=-1, stable=True)
    isect_tiles.last = order, radii.reshape(-1, count, 2)
    return None, torch.zeros(order.numel(), dtype=torch.int64), order.flatten()


def isect_offset_encode(isect_ids, images, width, height):
    return torch.zeros((images, height, width), dtype=torch.int64)


def _met(order, radii, means, conics, opacities, width, height):
    """Gaussians and pixels of one image, pixel by pixel, front to back."""
    left, done = np.ones(width * height), np.zeros(width * height, bool)
    shown = order[(radii[order] > 0).all(-1)]
    low, high = (np.clip(np.floor(means + sign * (radii + 1)), 0, [width, height]).astype(np.int64) for sign in (-1, 1))
    sides = np.maximum(high - low, 0)
    areas = sides.prod(-1)
    pixels, drawn, at = [], [], 0
    while at < len(shown) and not done.all():
        ends = np.cumsum(areas[shown[at:at + TOGETHER]])
        some = shown[at:at + max(1, int(np.searchsorted(ends, TOGETHER)))]
        at += len(some)
        owner = np.repeat(some, areas[some])
        place = np.arange(len(owner)) - np.repeat(np.cumsum(areas[some]) - areas[some], areas[some])
        x, y = low[owner, 0] + place % sides[owner, 0], low[owner, 1] + place // sides[owner, 0]
        pixel = y * width + x
        dx, dy = x + 0.5 - means[owner, 0], y + 0.5 - means[owner, 1]
        sigma = 0.5 * (conics[owner, 0] * dx * dx + conics[owner, 2] * dy * dy) + conics[owner, 1] * dx * dy
        alpha = np.minimum(0.999, opacities[owner] * np.exp(-sigma))
        met = np.flatnonzero((sigma >= 0) & (alpha >= 1 / 255) & ~done[pixel])
        met = met[np.argsort(pixel[met], kind='stable')]
        pixel, alpha, owner = pixel[met], alpha[met], owner[met]
        if not len(pixel):
            continue
        # T behind each Gaussian, from the pixel's T so far; nothing behind the first that lowers it to 10⁻⁴.
        starts = np.flatnonzero(np.diff(pixel, prepend=-1))
        total = np.cumsum(np.log1p(-alpha.astype(float)))
        before = np.concatenate([[0.0], total])[starts]
        runs = np.diff(np.append(starts, len(pixel)))
        behind = left[pixel] * np.exp(total - np.repeat(before, runs))
        ended = behind <= 1e-4
        done[pixel[ended]] = True
        keep = ~ended
        np.minimum.at(left, pixel[keep], behind[keep])
        pixels.append(pixel[keep])
        drawn.append(owner[keep])
    pixels, drawn = np.concatenate(pixels or [[]]).astype(np.int64), np.concatenate(drawn or [[]]).astype(np.int64)
    order = np.argsort(pixels, kind='stable')
    return drawn[order], pixels[order]


def rasterize_to_indices_in_range(start, end, transmittances, means2d, conics, opacities, width, height, tile_size, offsets, ids):
    none = torch.zeros(0, dtype=torch.int64)
    if start > 0:
        return none, none, none
    if kept['found'] is None:
        count = means2d.shape[-2]
        order, radii = (t.numpy() for t in isect_tiles.last)
        arrays = [t.detach().reshape(len(order), count, *rest).numpy() for t, rest in ((means2d, (2,)), (conics, (3,)), (opacities, ()))]
        found = [_met(order[i], radii[i], *(a[i] for a in arrays), width, height) for i in range(len(order))]
        images = np.concatenate([np.full(len(drawn), i) for i, (drawn, _) in enumerate(found)])
        drawn, pixels = (np.concatenate([one[k] for one in found]) for k in (0, 1))
        kept['found'] = tuple(map(torch.from_numpy, (drawn, pixels, images)))
    found = kept['found']
    if not kept['wanted']:
        kept['found'] = None
    return found


def _formulas_of_harmonics(degree, dirs, coeffs, masks=None):
    found = sys.modules['gsplat.cuda._torch_impl']._spherical_harmonics(degree, dirs, coeffs)
    return found if masks is None else torch.where(masks[..., None], found, torch.zeros_like(found))


def formulas(folder):
    package = types.ModuleType('gsplat')
    package.__path__ = [str(Path(folder) / 'gsplat')]
    cuda = types.ModuleType('gsplat.cuda')
    cuda.__path__ = [str(Path(folder) / 'gsplat/cuda')]
    wrapper = types.ModuleType('gsplat.cuda._wrapper')
    vars(wrapper).update(
        isect_tiles=isect_tiles, isect_offset_encode=isect_offset_encode, rasterize_to_indices_in_range=rasterize_to_indices_in_range,
        spherical_harmonics=_formulas_of_harmonics, RollingShutterType=enum.Enum('RollingShutterType', 'GLOBAL'))
    for name in ('FThetaCameraDistortionParameters', 'FThetaPolynomialType', 'fully_fused_projection', 'fully_fused_projection_2dgs',
                 'fully_fused_projection_with_ut', 'rasterize_to_pixels', 'rasterize_to_pixels_2dgs', 'rasterize_to_pixels_eval3d'):
        setattr(wrapper, name, type(name, (), {}))
    sys.modules |= {'gsplat': package, 'gsplat.cuda': cuda, 'gsplat.cuda._wrapper': wrapper}
    importlib.import_module('gsplat.cuda._torch_impl')
    package.rendering = importlib.import_module('gsplat.rendering')
    return package.rendering
