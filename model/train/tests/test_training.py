"""The analytic start does what it says, and a run that stopped goes on exactly."""
import types

import numpy as np
import pytest
import torch

from train import layering, network, stages, start
from train.checkpoint import Run
from train.rasteriser import render_pair

CONFIG = dict(hidden_dim=256, resolution=(48, 64), upsampler_window=64, condition_len=48)


@pytest.fixture(scope='module')
def begun(clips_module):
    torch.manual_seed(0)
    net = network.StreamSplat(network.Config(**CONFIG))
    for p in net.parameters():
        p.requires_grad_(False)
    frames = torch.from_numpy(np.stack([c[i] for c in clips_module for i in (1, 5)])).permute(0, 3, 1, 2).float() / 255
    readers, info = start.write_encoder(net, frames)
    start.write_static(net, readers, frames)
    start.write_decoder(net, readers, frames)
    start.write_motion(net, readers, frames)
    return net, readers, frames, info


@pytest.fixture(scope='module')
def clips_module():
    r = np.random.default_rng(0)
    out = []
    for _ in range(3):
        base = np.kron(r.random((10, 12, 3)), np.ones((8, 8, 1)))
        base = (base + np.roll(base, 3, 0) + np.roll(base, 3, 1) + np.roll(base, (2, 2), (0, 1))) / 4
        out.append(np.stack([(np.roll(base, t, 1)[:48, :64] * 255).astype(np.uint8) for t in range(12)]))
    return out


@torch.no_grad()
def test_the_encoder_reads_out_every_pixel_and_the_neighbours_borders(begun):
    net, readers, frames, _ = begun
    raw = start.raw_values(frames).view(len(frames), 6, 8, -1)[:, 1:-1, 1:-1]
    got = (net.encode(frames).double() @ readers['raw'].T).view(len(frames), 6, 8, -1)[:, 1:-1, 1:-1]
    error = (got - raw).pow(2).mean((0, 1, 2)).sqrt()
    assert float(error[:64].mean()) < 0.03 and float(error[96:].mean()) < 0.04


@torch.no_grad()
def test_identical_frames_do_not_move(begun):
    net, readers, frames, _ = begun
    h = net.encode(frames[[0, 0]])
    s = start.block0_stream(net, h).double()
    still = (s @ readers['motion']['nx']).abs().max() * start.UNIT
    assert float(still) < 1.5                                     # tokens; what is left is the two streams' different gains


@torch.no_grad()
def test_the_frame_nearer_in_time_lies_in_front_and_keeps_its_order(begun):
    net, _, frames, _ = begun
    g = net(frames[:2])
    v = g['velocity'][0, :, :, 1]
    assert v[0].unique().numel() == 1 and v[1].unique().numel() == 1
    assert float(v[0, 0]) < 0 < float(v[1, 0])
    y = lambda k, t: g['xyz'][0, k, :, 1] + v[k] * (t - k)
    assert float(y(0, 0.25).min()) > float(y(1, 0.25).max()) and float(y(1, 0.75).min()) > float(y(0, 0.75).max())


def options(**more):
    return types.SimpleNamespace(**dict(dict(seed=3, batch=1, steps=6, minutes=0, until=None, crop=None, encoder=False, attention=False, depth=False, gradient=0.01,
                                             mean_positions=False, procedural=0.5, gaps=(2, 6), middle=1, flow=0.05, decoder=False), **more))


@pytest.mark.parametrize('stage', ('static', 'dynamic'))
def test_half_a_run_and_its_continuation_are_the_whole_run_to_the_bit(stage, begun, clips_module, tmp_path):
    net, _, _, _ = begun
    first = {k: v.clone() for k, v in net.state_dict().items()}
    runner = getattr(stages, stage)

    def fresh():
        n = network.StreamSplat(network.Config(**CONFIG))
        n.load_state_dict(first)
        return n

    whole = fresh()
    runner(whole, options(), Run(tmp_path / 'whole'), clips_module)
    half = fresh()
    runner(half, options(until=3), Run(tmp_path / 'halves'), clips_module)
    state = Run(tmp_path / 'halves').state
    assert state['step'] == 3 and not state['done']
    other = fresh()
    runner(other, options(), Run(tmp_path / 'halves'), clips_module, state)
    for k, v in whole.state_dict().items():
        assert torch.equal(v, other.state_dict()[k]), k
    assert any(not torch.equal(v, first[k]) for k, v in whole.state_dict().items())


@torch.no_grad()
def test_layering_can_be_written_into_a_trained_network(begun):
    net, _, frames, _ = begun
    n = network.StreamSplat(network.Config(**CONFIG))
    n.load_state_dict(net.state_dict())
    last = n.gs_dynamic_predictor.gs_layer['xyz_dynamic'].layers['7']
    last.weight[1] = 0
    before = n(frames[:2])['velocity'][..., [0, 2]]
    info = layering.write_layering(n, frames)
    assert info['margin'] > 0.5
    v = n(frames[:2])['velocity']
    assert v[0, 0, :, 1].unique().numel() == 1 and float(v[0, 0, 0, 1]) < 0 < float(v[0, 1, 0, 1])
    assert float((v[..., [0, 2]] - before).abs().max()) < 0.05
