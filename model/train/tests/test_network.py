"""The network is the reference's: every intermediate of the parity fixtures."""
import json

import pytest
import torch
from conftest import FIXTURES
from safetensors.torch import load_file

from train import network

CASES = ('tiny-dino', 'tiny-nodino', 'tiny-sampled', 'tiny-window')


def rel(a, b):
    return float((a.double() - b.double()).norm() / b.double().norm())


@pytest.mark.parametrize('name', CASES)
@torch.no_grad()
def test_every_output_agrees_with_the_reference(name):
    folder = FIXTURES / 'parity'
    entries = json.loads((folder / f'{name}.json').read_text())
    io, weights = load_file(str(folder / f'{name}.io.safetensors')), load_file(str(folder / f'{name}.safetensors'))
    c = network.Config.of(entries['config'])
    key = lambda k: next(v for n, v in weights.items() if n.endswith(k))
    c.condition_len = key('decoder.transformer_decoder.positional_encoding.pe').shape[0]
    if c.use_dino:
        c.condition_dim = key('condition_proj.weight').shape[1]
    net = network.load_official(network.StreamSplat(c), weights)
    frames, depths = io['in.frames'], io['in.depths']
    enc = net.gs_predictor.encoder.transformer_encoder
    got = dict(tokens_conv=enc.tokens(torch.cat([frames, depths], 1)), h=net.encode(frames, depths))
    g, got['static_tokens'] = net.static(got['h'])
    head = net.gs_predictor.predictor
    got.update({f'static.{k}': g[k] for k in ('scale', 'opacity', 'rgb')})
    v, gamma, got['d'], got['dynamic_tokens'] = net.dynamic(got['h'], got['static_tokens'], io.get('in.condition'))
    got.update({'dynamic.velocity': v, 'dynamic.gamma': gamma})
    for k, x in got.items():
        assert rel(x, io['out.' + k].reshape(x.shape)) < 1e-5, k
    want = io['out.static.xyz_static']
    assert min(rel(g['xyz'], want), rel(offsets(g['xyz'], head), want)) < 1e-5


def offsets(xyz, head):
    h, w = head.grid
    return torch.stack([(xyz[..., 0] - head.x_map) * w, (xyz[..., 1] - 0.5) * 2, (xyz[..., 2] - head.z_map) * h], -1)


def test_a_checkpoint_survives_saving_and_opening(tmp_path):
    torch.manual_seed(0)
    net = network.StreamSplat(network.Config(hidden_dim=128, resolution=(32, 64), condition_len=32, decoder_layers=1, upsampler_window=32))
    network.save_official(net, tmp_path / 'm.safetensors', torch.float32)
    again = network.open_official(tmp_path / 'm.safetensors')
    assert again.config == net.config
    for (k, a), b in zip(net.state_dict().items(), again.state_dict().values()):
        assert torch.equal(a, b), k


@pytest.mark.parametrize('more', ({}, dict(depth='ignored')))
def test_what_is_said_of_depth_is_kept_and_nothing_said_where_nothing_was(more, tmp_path):
    net = network.StreamSplat(network.Config(hidden_dim=64, resolution=(16, 32), condition_len=8, **more))
    network.save_official(net, tmp_path / 'a.safetensors')
    network.save_official(network.open_official(tmp_path / 'a.safetensors'), tmp_path / 'b.safetensors')
    assert (tmp_path / 'a.json').read_bytes() == (tmp_path / 'b.json').read_bytes()
    assert json.loads((tmp_path / 'b.json').read_text()).get('depth') == more.get('depth')


def test_a_missing_key_is_an_error():
    net = network.StreamSplat(network.Config(hidden_dim=128, resolution=(32, 64), condition_len=32, decoder_layers=1, upsampler_window=32))
    entries = {'model.' + k: v for k, v in net.state_dict().items()}
    entries.pop('model.encoder_proj.weight')
    with pytest.raises(KeyError, match='encoder_proj'):
        network.load_official(net, entries)


def test_truncated_normal_agrees_with_the_table_where_the_formula_is_accurate():
    io = load_file(str(FIXTURES / 'parity' / 'truncated-normal.io.safetensors'))
    m, s, u = (io['in.' + k].double() for k in ('mean', 'log_scale', 'uniform'))
    got = network.truncated_normal(m, s, u)
    tame = (m.abs() < 0.8) & (s > -3) & (s < 1)
    assert tame.sum() > 100
    assert float((got - io['out.value'].double())[tame].abs().max()) < 2e-3
    assert float(got.abs().max()) <= 1 - network.EPS
