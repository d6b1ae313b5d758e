"""Gaussians lifted to a known depth: the engine's rule for their order, and views from the side."""
import types

import cv2
import numpy as np
import pytest
import torch

from conftest import HERE
from train import data, lifted, network, stages

GRID, WIDTH = (16, 32), 64


def lattice(slope):
    """A Gaussian every second pixel on a surface that slopes, in a scattered order: u, v, sigma, z, rank [1, R, C]."""
    v, u = torch.meshgrid(torch.arange(GRID[0]) * 2.0 + 1, torch.arange(GRID[1]) * 2.0 + 1, indexing='ij')
    rank = torch.rand(GRID, generator=torch.Generator().manual_seed(0))
    return [t[None] for t in (u, v, torch.ones(GRID), 0.4 + slope * u, rank)]


def wrong(u, v, z, rank):
    """Share of neighbours that are not in their order."""
    at = torch.stack([u.flatten(), v.flatten()], -1)
    near = (torch.cdist(at, at) <= 4) & ~torch.eye(len(at), dtype=torch.bool)
    z, rank = z.flatten(), rank.flatten()
    return float((((rank[:, None] > rank) != (z[:, None] < z)) & near).sum() / near.sum())


def test_neighbours_on_a_slope_keep_their_order_and_the_slope_stays():
    unit = 2 / WIDTH
    for slope in (0.0, 0.2 * unit, -0.5 * unit):
        u, v, sigma, z, rank = lattice(slope)
        kept = lifted.kept_order(u, v, sigma, z, rank, WIDTH)
        assert wrong(u, v, z, rank) > 0.4 and wrong(u, v, kept, rank) < 0.05
        moved = (kept - z) / unit
        assert moved.mean().abs() < 0.2 and moved.abs().max() < 9


def test_what_lies_on_another_surface_stays_and_equal_ranks_keep_the_order_of_storage():
    u, v, sigma, z, rank = lattice(0.0)
    column = torch.arange(GRID[1]) % 2 == 0
    apart = torch.where(column, 0.4, 1.2).expand_as(z)
    kept = lifted.kept_order(u, v, sigma, apart, rank, WIDTH)
    assert (kept - apart).abs().max() < 0.3 and wrong(u, v, kept, torch.where(column, 1.0, 0.0).expand_as(z)) < 0.35
    same = lifted.kept_order(u, v, sigma, z, torch.zeros_like(rank), WIDTH)
    assert wrong(u, v, same, -torch.arange(float(rank.numel())).view_as(rank)) < 0.05


@pytest.mark.parametrize('degrees', (10.0, -10.0))
def test_true_depth_is_nearer_to_the_view_from_the_side_than_flat_depth_or_the_other_side(degrees):
    net = network.open_official(HERE.parents[3] / 'engine' / 'lite' / 'lite.safetensors').requires_grad_(False)
    r = np.random.default_rng(3)
    texture = lambda: cv2.resize(r.integers(0, 256, (18, 32, 3)).astype(np.uint8), (256, 144), interpolation=cv2.INTER_CUBIC)
    source = data.Pairs([np.stack([texture()] * 10) for _ in range(4)], 0, 1, middle=0)
    sums, count = np.zeros(3), 0
    for k in range(40):
        key, front, y, turned, inner = (torch.from_numpy(np.ascontiguousarray(a)).float() for a in source.turned(1, k, degrees))
        assert key.shape == turned.shape == (1, 3, 144, 256) and y.shape == inner.shape == front.shape == (1, 144, 256)
        if count == 3 or y.std() < 0.15:               # one plane, or planes near each other, look the same from everywhere
            continue
        g, _ = net.static(net.encode(key))
        of = lambda y, degrees: float(lifted.lifted_loss(g, y, key, turned, inner, torch.zeros(1, 3), degrees, net.config.splat_grid, 2)[1]['turned'])
        sums += [of(y, degrees), of(torch.full_like(y, 0.5), degrees), of(y, -degrees)]
        count += 1
    assert count == 3
    sums /= count
    assert sums[0] > sums[1] + 2 and sums[0] > sums[2] + 2, sums


def test_views_from_the_side_train_the_static_half(clips):
    def trained(weight):
        torch.manual_seed(2)
        net = network.StreamSplat(network.Config(hidden_dim=64, resolution=(48, 64), upsampler_window=64, condition_len=48))
        o = types.SimpleNamespace(seed=1, batch=1, crop=None, magnified=0.0, depth=1.0, scenes=2, turned=weight, fit=0.0, fit_steps=2, gradient=0.0, mixed=False,
                                  mean_positions=True, rasteriser=None, workers=0, encoder=False, attention=False, rate=0.1, steps=2, minutes=0, until=None)
        stages.static(net, o, types.SimpleNamespace(log=None, save=lambda state: None, curve=lambda: None), clips)
        return net.state_dict()

    without, tiny, whole = trained(0.0), trained(1e-30), trained(1.0)
    assert all(torch.equal(v, tiny[k]) for k, v in without.items())          # the same frames, so only the loss differs
    assert any(not torch.equal(v, whole[k]) for k, v in without.items())
    config = types.SimpleNamespace(config=types.SimpleNamespace(resolution=(48, 64)))
    with pytest.raises(ValueError, match='--turned needs scenes'):
        stages._static(None, config, types.SimpleNamespace(fit=0.0, crop=None, turned=1.0, depth=0.0), clips, False)
