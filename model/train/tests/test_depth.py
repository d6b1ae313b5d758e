"""Measurements of depth, and the separation of two frames in depth."""
import types

import numpy as np
import pytest
import torch

from conftest import HERE
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
    """A `near_of` that returns the true nearness of the scenes, in their order."""
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
    assert (render_pair(turned, times, 48, 64, torch.full((1, 3, 3), 0.5))[0] - want).abs().max() > 1e-3         # the pictures depend on the order


@torch.no_grad()
def test_the_second_frame_lies_behind_the_first_at_every_time(net):
    net.gs_predictor.predictor.gs_layer['xyz_static'].weight[1] = 0.0005
    depth.keep_frames_apart(net)
    g = net(torch.rand(2, 3, 48, 64))
    y, v = g['xyz'][0, :, :, 1], g['velocity'][0, :, :, 1]
    assert 0 < float(y.max() - y.min()) < depth.APART and v.unique().numel() == 1
    for t in (0.0, 0.4, 1.0):
        assert float((y[0] + t * v[0]).min()) > float((y[1] + (t - 1) * v[1]).max())


@torch.no_grad()
def test_what_ships_keeps_the_first_frames_depth_and_brings_the_second_forward():
    net = network.open_official(HERE.parents[3] / 'engine' / 'lite' / 'lite.safetensors')
    frames = torch.nn.functional.interpolate(torch.rand(4, 3, 18, 32, generator=torch.Generator().manual_seed(0)), size=net.config.resolution, mode='bicubic').clamp(0, 1)
    before = net(frames)
    assert not before['velocity'][:, 0, :, 1].any()
    assert (before['velocity'][:, 1, :, 1] - depth.APART).abs().max() < 2e-4
    # Written once more it opens the same gate, and the visible motion stays.
    assert depth.come_forward(net, frames) >= 0.1
    after = net(frames)
    assert not after['velocity'][:, 0, :, 1].any() and (after['velocity'][:, 1, :, 1] - depth.APART).abs().max() < 2e-4
    assert (after['velocity'] - before['velocity']).pow(2).mean().sqrt() < 0.05 * before['velocity'][..., ::2].pow(2).mean().sqrt()


@torch.no_grad()
def test_nothing_is_written_where_the_frames_cannot_be_told_apart(net):
    kept = {k: v.clone() for k, v in net.state_dict().items()}
    assert depth.come_forward(net, torch.rand(1, 3, 48, 64).repeat(2, 1, 1, 1), margin=0.9) < 0.9
    assert all(torch.equal(v, kept[k]) for k, v in net.state_dict().items())


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


@pytest.fixture
def leaning(net):
    """A network like the analytic start in the relevant parts: tokens with a constant, residual branches that add nothing."""
    up = net.gs_predictor.gaussian_upsampler
    for _, last, _ in network.branches(net):
        for p in last.parameters():
            p.zero_()
    up.upsampler_1.residual_fc.bias.view(-1, 4)[-4:] = 20
    depth.write_lean(net, torch.rand(1, 3, 48, 64))
    return net


@torch.no_grad()
def test_patches_lean_in_the_order_of_storage_and_stand_level(leaning):
    g, _ = leaning.static(leaning.encode(torch.rand(2, 3, 48, 64)))
    uneven, _ = depth.lean_loss(g['xyz'][..., 1], (24, 32), torch.zeros(1, 48, 64))
    assert float(uneven) < 0.1
    patches = g['xyz'][..., 1].unflatten(1, (6, 4, 8, 4)).permute(0, 1, 3, 2, 4).flatten(-2)
    assert (patches.diff() < 0).all()


@torch.no_grad()
def test_what_settles_keeps_its_order_and_is_scaled_back_where_it_goes_on(leaning):
    frames, row = torch.rand(2, 3, 48, 64), depth.position_layer(leaning).weight[1].clone()
    y = lambda: leaning.static(leaning.encode(frames))[0]['xyz'][..., 1]
    before = y()
    depth.settle(leaning)
    after = y()
    assert (after.gather(1, before.argsort(1)).diff() > -1e-6).all() and float(after.max() - after.min()) < 0.5 * float(before.max() - before.min())
    depth.write_lean(leaning, frames)
    torch.testing.assert_close(depth.position_layer(leaning).weight[1], row)


def test_depth_learns_before_the_last_channel_and_not_behind_it(leaning):
    up = leaning.requires_grad_(True).gs_predictor.gaussian_upsampler
    hooks = depth.kept_lean(leaning)
    y = leaning.static(leaning.encode(torch.rand(2, 3, 48, 64)))[0]['xyz'][..., 1]
    sum(depth.lean_loss(y, (24, 32), torch.rand(2, 48, 64).round())).backward()
    c = int(depth.position_layer(leaning).weight[1].abs().argmax())
    assert up.upsampler_0.residual_fc.weight.grad.any() and not depth.position_layer(leaning).weight.grad[1].any()
    assert not up.upsampler_1.residual_fc.weight.grad[4 * c:4 * c + 4].any() and not up.attention_1.resblocks[0].mlp.c_proj.weight.grad[c].any()
    for hook in hooks:
        hook.remove()


def test_foreground_in_front_is_no_loss_and_behind_it_is_one():
    front = torch.zeros(2, 48, 64)
    front[0, 8:24, 16:32] = 1
    stands = torch.nn.functional.avg_pool2d(front, 8).mul(2).sub(1).mul(depth.STANDS).repeat_interleave(4, 1).repeat_interleave(4, 2)
    y = lambda sign: (0.5 + 0.5 * torch.tanh(sign * stands + depth.lean().repeat(6, 8))).flatten(1)
    for sign, want in ((1.0, 0.0), (0.0, 1.0 / 2), (-1.0, 4.0 / 2)):           # the second frame has no foreground and does not count
        uneven, misplaced = depth.lean_loss(y(sign), (24, 32), front)
        assert float(uneven) < 1e-6 and float(misplaced) == pytest.approx(want, rel=0.25, abs=1e-6)


@torch.no_grad()
def test_flat_depth_from_the_side_is_the_picture_turned_on_its_plane(net, clips):
    got = depth.turned_scenes(net, clips, 8)
    assert got['count'] > 0 and got['count'] % 2 == 0 and abs(got['views'] - got['flat']) < 0.5
