"""Views from the side of Gaussians lifted to a known depth, by the rules of `engine/src/stream/lift` away from depth edges.

Each Gaussian takes the depth of the surface at its centre. Neighbours on one surface keep the order of their y: they are moved apart until a camera turned by
up to 10° draws them in that order.
"""
import math

import torch
import torch.nn.functional as F

from .losses import FITTED_FLOOR, log_error, psnr
from .rasteriser import render_fitted, render_turned

SLOPE, WIDE, SURFACE, ROUNDS = 0.18, 2.0, 2.0, 16      # of the engine's lift/order.rs
TEAR = 11.5                                            # of lift/edges.rs: z apart at an edge, times pixels of a row
LARGEST = 4.0                                          # standard deviation in pixels
NARROWER, THIN = 0.95, 0.5                             # of lift/mod.rs
NEIGHBOURS = 3                                         # cells of the splat grid around a Gaussian that are compared


def depth_of(y):
    return 1 / (9.8 * y + 0.2)


def nearness_of(z):
    return (1 / z - 0.2) / 9.8


def around(x, fill):
    """[B, R, C, n, n]: x [B, R, C] of the cells around each, `fill` from outside."""
    side = 2 * NEIGHBOURS + 1
    return F.pad(x, (NEIGHBOURS,) * 4, value=fill).unfold(1, side, 1).unfold(2, side, 1)


@torch.no_grad()
def kept_order(u, v, sigma, z, rank, width):
    """z [B, R, C] with neighbours on one surface moved apart; u, v: centres and sigma: standard deviations in pixels of a picture of
    `width`, rank: y of the network, the larger is in front, of equal ones the earlier in storage."""
    own, sigma = lambda x: x[..., None, None], sigma.clamp(max=LARGEST)
    apart = torch.hypot(around(u, 0.0) - own(u), around(v, 0.0) - own(v))
    near = (apart <= WIDE * (own(sigma) + around(sigma, 0.0))) & ((around(z, math.inf) - own(z)).abs() <= SURFACE * TEAR / width)
    later = torch.arange(apart[0, 0, 0].numel(), device=z.device).view(apart.shape[3:]) > apart[0, 0, 0].numel() // 2
    near[..., NEIGHBOURS, NEIGHBOURS] = False
    front = torch.where((own(rank) > around(rank, 0.0)) | (own(rank) == around(rank, 0.0)) & later, 1.0, -1.0)
    room = torch.where(near, SLOPE * 2 / width * apart, -math.inf)
    for _ in range(ROUNDS):
        lacking = (room - front * (around(z, 0.0) - own(z))).clamp_min(0)
        z = z - (front * lacking).sum((-2, -1)) / (lacking > 0).sum((-2, -1)).clamp_min(1)
    return z


def lifted(g, depth, splat_grid):
    """Gaussians `g` of frames, one per cell of the splat grid, on the surfaces whose y is `depth` [B, H, W]. Positions have gradients, depths do not."""
    H, W = depth.shape[1:]
    x, y, z = g['xyz'].detach().unbind(-1)
    u, v = ((x + 1) * W - 1) * 0.5, ((1 - z) * H - 1) * 0.5
    at = v.round().clamp(0, H - 1).long() * W + u.round().clamp(0, W - 1).long()
    scale = NARROWER * g['scale']
    sigma = torch.maximum(scale[..., 0] * W / 2, scale[..., 1] * H / 2).detach()
    grid = lambda t: t.unflatten(1, splat_grid)
    kept = kept_order(grid(u), grid(v), grid(sigma), grid(depth_of(depth.flatten(1).gather(1, at))), grid(y), W).flatten(1)
    xyz = torch.stack([g['xyz'][..., 0], nearness_of(kept).clamp(0, 1), g['xyz'][..., 2]], -1)
    return dict(g, xyz=xyz, scale=scale)


def lifted_loss(g, depth, key, turned, inner, background, degrees, splat_grid, steps, kernels=None):
    """(loss, figures) of lifted Gaussians whose colours are fitted to the key frame `key` [B,3,H,W], from its camera and from the side, where `inner` [B,H,W]
    is 1: there `turned` shows one surface that the key frame also shows. Fitted colours are constants."""
    H, W = key.shape[-2:]
    g = lifted(g, depth, splat_grid)
    front, rgb = render_fitted(g, key, background, steps, kernels)
    side, _ = render_turned(g['xyz'], g['scale'], g['opacity'][..., 0], rgb, H, W, background, degrees, depth_of(depth).mean((1, 2)), THIN, kernels)
    share = inner.mean((1, 2)).clamp_min(1e-3)
    error = ((side[:, :3] - turned).square().mean(1) * inner).mean((1, 2)) / share
    loss = log_error(front, key, FITTED_FLOOR) + torch.log(error + FITTED_FLOOR).mean()
    return loss, dict(lifted=psnr(front.detach(), key).mean(), turned=(-10 * torch.log10(error.detach() + 1e-10)).mean())
