"""What is measured of depth, and what keeps two frames apart in it."""
import types

import numpy as np
import pytest
import torch

from train import data, depth, network
from train.rasteriser import render_pair, render_static

CONFIG = dict(hidden_dim=64, resolution=(48, 64), upsampler_window=64, condition_len=48)


@pytest.fixture
def net():
    torch.manual_seed(1)
    net = network.StreamSplat(network.Config(**CONFIG)).requires_grad_(False)
    head = net.gs_predictor.predictor.gs_layer
    head['xyz_static'].weight[1], head['xyz_static'].bias[1] = 0, 0
    head['scale'].bias.fill_(-1.0)
    last = net.gs_dynamic_predictor.gs_layer['xyz_dynamic'].layers['7']
    last.weight[1], last.bias[1] = 0, 0
    return net


def of_truth(clips, sign):
    """A `near_of` that knows the scenes that are asked, in their order."""
    source, calls = data.Pairs(clips, depth.VALIDATION, 1, middle=1), iter(range(1 << 20))
    return lambda frames: sign * source.scene(np.random.default_rng([depth.VALIDATION, next(calls)]))['depth']


@pytest.mark.parametrize('sign, share', ((1.0, 1.0), (-1.0, 0.0)))
def test_true_depth_is_in_order_and_its_opposite_is_not(clips, sign, share):
    got = depth.order_of_scenes(of_truth(clips, sign), clips, 12)
    assert got['count'] >= 6 and got['pixels'] == share and got['frames'] == share


def test_equal_depths_are_half_in_order_whatever_the_rounding(clips):
    r = np.random.default_rng(0)
    flat = lambda frames: 5.0 + 1e-6 * r.standard_normal((2, *frames.shape[-2:]))
    got = depth.order_of_scenes(flat, clips, 12)
    assert got['pixels'] == 0.5 and got['frames'] == 0.0


@torch.no_grad()
def test_what_lies_nearer_is_rendered_nearer(net):
    frames = torch.rand(2, 3, 48, 64)
    net.gs_predictor.predictor.gs_layer['xyz_static'].bias[1] = 0.2
    nearer = depth.rendered_nearness(net, frames)
    net.gs_predictor.predictor.gs_layer['xyz_static'].bias[1] = -0.2
    assert nearer.shape == (2, 48, 64) and (nearer > depth.rendered_nearness(net, frames)).all()


@torch.no_grad()
def test_frames_kept_apart_are_composited_as_with_equal_depths(net):
    frames, times = torch.rand(2, 3, 48, 64), torch.tensor([[0.0, 0.3, 1.0]])
    before = net(frames)
    want, _ = render_pair(before, times, 48, 64, torch.full((1, 3, 3), 0.5))
    depth.keep_frames_apart(net)
    got, _ = render_pair(net(frames), times, 48, 64, torch.full((1, 3, 3), 0.5))
    torch.testing.assert_close(got[:, :, :3], want[:, :, :3])
    turned = {k: v.flip(1) if k in ('rgb', 'scale') else v for k, v in before.items()}
    assert (render_pair(turned, times, 48, 64, torch.full((1, 3, 3), 0.5))[0] - want).abs().max() > 1e-3         # the pictures do depend on who is in front


@torch.no_grad()
def test_the_second_frame_lies_behind_the_first_at_every_time(net):
    net.gs_predictor.predictor.gs_layer['xyz_static'].weight[1] = 0.003
    depth.keep_frames_apart(net)
    g = net(torch.rand(2, 3, 48, 64))
    y, v = g['xyz'][0, :, :, 1], g['velocity'][0, :, :, 1]
    assert 0 < float(y.max() - y.min()) < depth.APART and v.unique().numel() == 1
    for t in (0.0, 0.4, 1.0):
        assert float((y[0] + t * v[0]).min()) > float((y[1] + (t - 1) * v[1]).max())


@torch.no_grad()
def test_storage_order_is_how_equal_depths_are_composited_and_others_are_not(net):
    frames = torch.rand(2, 3, 48, 64)
    g, _ = net.static(net.encode(frames))
    plain, _ = render_static(g, 48, 64, torch.full((2, 3), 0.5))
    got = depth.fragility(net, frames)
    want = float((-10 * torch.log10((plain[:, :3] - frames).pow(2).mean((1, 2, 3)))).mean())
    assert got['storage'] == got['depth'] and abs(got['depth'] - want) < 0.006
    for order in depth.ORDERS:
        assert depth.keys_of(order, (12, 16), torch.Generator().manual_seed(0)).unique().numel() == 12 * 16, order
    assert len(set(got.values())) > 1
