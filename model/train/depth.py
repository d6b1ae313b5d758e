"""Depth: what is measured of it on procedural scenes, and what a checkpoint needs whose depths are not all equal.

`y` is normalised inverse depth, larger is nearer. A rendering gives the mean distance of what a pixel shows; one over it is the pixel's
nearness, an increasing affine function of `y` where one depth is seen.
"""
import numpy as np
import torch

from . import data
from .losses import psnr
from .rasteriser import render, render_pair

VALIDATION = 1 << 30       # seeds the scenes that are measured; training draws its samples from (seed, step, place in the batch)
EQUAL = 1e-3               # two pixels are as near as each other when their nearness differs by less than this share
APART = 0.1                # of the inverse-depth range: how far the second frame lies behind the first


def nearness(image, transmittance):
    """[.., H, W] of a rendering [.., 4, H, W]: one over the mean distance of what is seen; 0 where nothing is."""
    return (1 - transmittance) / image[..., 3, :, :].clamp_min(1e-6)


def ordered(near, foreground, background, r, pairs=2000):
    """Share of random pixel pairs (one of each mask [H,W]) whose foreground pixel is nearer; equal ones count half."""
    front, behind = (near[mask][r.integers(int(mask.sum()), size=pairs)] for mask in (foreground, background))
    equal = np.abs(front - behind) <= EQUAL * np.maximum(front, behind)
    return float(np.where(equal, 0.5, front > behind).mean())


def order_of_scenes(near_of, clips, scenes):
    """How well `near_of` (frames [2,3,H,W] of a pair -> nearness [2,H,W]) orders foreground before background.

    -> dict: `pixels`, the mean share of pixel pairs in order; `frames`, the share of key frames with more than half in order; `count` of them.
    Scenes are textured from `clips` and depend on nothing else; those without a foreground are left out."""
    source = data.Pairs(clips, VALIDATION, 1, middle=1)
    shares = []
    for k in range(scenes):
        r = np.random.default_rng([VALIDATION, k])
        scene = source.scene(r)
        near = near_of(torch.from_numpy(np.ascontiguousarray(scene['rgb'][:2].transpose(0, 3, 1, 2), dtype=np.float32)))
        for key in (0, 1):
            front, behind = scene['foreground'][key] > 0.99, scene['foreground'][key] < 0.01
            if min(front.sum(), behind.sum()) >= 50:
                shares.append(ordered(near[key], front, behind, r))
    return dict(pixels=round(float(np.mean(shares)), 4), frames=round(float(np.mean([s > 0.5 for s in shares])), 4), count=len(shares))


@torch.no_grad()
def rendered_nearness(net, frames):
    """Of both key frames of a pair, as the pair is rendered at its two ends."""
    h, w = net.config.resolution
    image, transmittance = render_pair(net(frames), torch.tensor([[0.0, 1.0]]), h, w, torch.full((1, 2, 3), 0.5))
    return nearness(image, transmittance)[0].numpy()


def lower_is_nearer(frames):
    """What the position in the picture says alone: the baseline that takes no look."""
    h, w = frames.shape[-2:]
    return np.broadcast_to(np.arange(1.0, h + 1)[:, None], (len(frames), h, w))


@torch.no_grad()
def keep_frames_apart(net, step=APART):
    """One depth velocity for all Gaussians: the second frame lies `step` behind the first at every time of the interval.

    At time t the first frame has moved by step * t and the second by step * (t - 1). Order inside a frame stays as it is. Where depths differ by
    less than `step` the pair is composited as with equal depths: the first frame in front."""
    last = net.gs_dynamic_predictor.gs_layer['xyz_dynamic'].layers['7']
    last.weight[1] = 0
    last.bias[1] = 20                              # tanh is 1 to the last bit
    net.gs_dynamic_predictor.dynamic_scalar[1] = step


ORDERS = ('storage', 'lowest row first', 'rightmost first in each row', 'patches at random', 'at random')


def keys_of(order, grid, generator):
    """Sorting keys [N] of a frame's Gaussians on the splat grid `grid`: what is smaller is in front."""
    rows, columns = torch.meshgrid(torch.arange(float(grid[0])), torch.arange(float(grid[1])), indexing='ij')
    inside = (rows % 4) * 4 + columns % 4
    chance = torch.rand(grid, generator=generator)
    return dict(zip(ORDERS, (rows * grid[1] + columns, -rows * grid[1] + columns, rows * grid[1] - columns,
                             100 * chance[::4, ::4].repeat_interleave(4, 0).repeat_interleave(4, 1) + inside, chance)))[order].flatten()


@torch.no_grad()
def fragility(net, frames, seed=0):
    """PSNR (dB) of single frames [B,3,H,W] at 0.5 grey by the order in which their Gaussians are composited, nothing else changed."""
    h, w = net.config.resolution
    g, _ = net.static(net.encode(frames))
    out = {}
    for order in ('depth', *ORDERS):
        key = None if order == 'depth' else keys_of(order, net.config.splat_grid, torch.Generator().manual_seed(seed)).expand(len(frames), -1)
        image, _ = render(g['xyz'], g['scale'], g['opacity'][..., 0], g['rgb'], h, w, torch.full((len(frames), 3), 0.5), order=key)
        out[order] = round(float(psnr(image[:, :3], frames).mean()), 2)
    return out
