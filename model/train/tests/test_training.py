"""The analytic start works as documented, and a stopped run resumes exactly."""
import types

import numpy as np
import pytest
import torch

from train import depth, layering, losses, network, stages, start
from train.checkpoint import Run
from train.rasteriser import opacity_at

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
    assert float(still) < 1.5                                     # tokens; the rest is due to the two streams' different gains


@torch.no_grad()
def test_the_first_frame_fades_and_the_second_stays_behind_it_at_one_depth(begun):
    net, _, frames, _ = begun
    g = net(frames[:2])
    assert not g['velocity'][0, :, :, 1].any() and g['xyz'][0, :, :, 1].unique().numel() == 1
    fade = opacity_at(g['gamma'], torch.tensor(0.9))[0]
    assert float(fade[0].max()) < 0.15 and float(fade[1].min()) > 0.5


@torch.no_grad()
def test_differences_of_cells_are_read_off_the_embedding(begun):
    """The deformation token's content of the other frame: the luma of 2x2 pixels, own minus other, up to the patch's finest waves."""
    net, readers, _, _ = begun
    y, x = torch.meshgrid(torch.arange(48.0), torch.arange(64.0), indexing='ij')
    wave = lambda phase: (0.5 + 0.3 * torch.sin(x / 6 + phase) * torch.cos(y / 7)).expand(3, 48, 64)
    h = net.encode(torch.stack([wave(0.0), wave(0.4)])).double()
    got = (start.cell_differences(readers['content_spread']) @ (readers['content'] @ (h[0] - h[1]).T)).T[:, :16]
    cells = lambda f: torch.nn.functional.unfold(torch.nn.functional.avg_pool2d(f[None, :1], 2), 4, stride=4)[0].T
    want = cells(wave(0.0)) - cells(wave(0.4))
    assert float((got - want).abs().mean()) < 0.15 * float(want.abs().mean())


def test_a_gaussian_wider_than_the_limit_is_drawn_at_it_and_pulled_back():
    most = losses.LOCAL * 2 / 128
    raw = torch.tensor([[0.5 * most, most], [1.2 * most, 20 * most]], requires_grad=True)
    g, wide = losses.kept_local(dict(scale=raw, opacity=torch.ones(2, 1)), (72, 128))
    torch.testing.assert_close(g['scale'], torch.tensor([[0.5 * most, most], [most, most]]))
    (wide + g['scale'].sum()).backward()
    assert raw.grad[0, 0] == 1 and raw.grad[1, 0] > 0 and raw.grad[1, 1] > 0 and float(wide) > 0


def options(**more):
    return types.SimpleNamespace(**dict(dict(seed=3, batch=1, steps=6, minutes=0, until=None, crop=None, encoder=False, attention=False, depth=0.0, gradient=0.01,
                                             mean_positions=False, procedural=0.5, gaps=(2, 6), middle=1, flow=0.05, one_way=False, rate=0.5,
                                             mixed=False, rasteriser=None, pairs=2, keep_zero_output=False,
                                             magnified=0.0, fit=0.0, fit_steps=2, turned=0.0, scenes=1, workers=0), **more))


@pytest.mark.parametrize('stage, more', (('static', {}), ('static', dict(mixed=True)), ('static', dict(depth=1.0)),
                                         ('static', dict(depth=1.0, magnified=0.5, fit=1.0, scenes=2, workers=1)), ('static', dict(depth=1.0, turned=1.0, scenes=2)), ('heads', {}), ('flow', {}), ('dynamic', {}),
                                         ('dynamic', dict(mixed=True)), ('dynamic', dict(keep_zero_output=True))))
def test_half_a_run_and_its_continuation_are_the_whole_run_to_the_bit(stage, more, begun, clips_module, tmp_path):
    net, _, _, _ = begun
    first = {k: v.clone() for k, v in net.state_dict().items()}
    runner = getattr(stages, stage)

    def fresh():
        n = network.StreamSplat(network.Config(**CONFIG))
        n.load_state_dict(first)
        return n

    whole = fresh()
    runner(whole, options(**more), Run(tmp_path / 'whole'), clips_module)
    half = fresh()
    runner(half, options(until=3, **more), Run(tmp_path / 'halves'), clips_module)
    state = Run(tmp_path / 'halves').state
    assert state['step'] == 3 and not state['done']
    other = fresh()
    runner(other, options(**more), Run(tmp_path / 'halves'), clips_module, state)
    for k, v in whole.state_dict().items():
        assert torch.equal(v, other.state_dict()[k]), k
    assert any(not torch.equal(v, first[k]) for k, v in whole.state_dict().items())


def trained(begun, clips, stage, folder, **more):
    n = network.StreamSplat(network.Config(**CONFIG))
    n.load_state_dict(begun[0].state_dict())
    getattr(stages, stage)(n, options(**more), Run(folder), clips)
    return n


def test_depth_moves_where_it_is_trained_and_nowhere_else(begun, clips_module, tmp_path):
    row = lambda n: n.gs_predictor.predictor.gs_layer['xyz_static'].weight[1]
    flat, deep = (trained(begun, clips_module, 'static', tmp_path / name, depth=weight) for name, weight in (('flat', 0.0), ('deep', 1.0)))
    assert not row(flat).any() and row(deep).any()
    with torch.no_grad():
        assert float(deep(begun[2][:2])['velocity'][..., 1].unique()) == pytest.approx(depth.APART, abs=4e-4)      # the frames are kept apart


def test_fitting_colours_trains_the_geometry_for_pictures_of_fitted_colours(begun, clips_module, tmp_path):
    """Training with the fit yields better pictures with fitted colours than training without it."""
    from train.rasteriser import render_fitted
    got = []
    for weight in (0.0, 1.0):
        n = trained(begun, clips_module, 'static', tmp_path / str(weight), steps=40, batch=2, fit=weight, fit_steps=4)
        with torch.no_grad():
            g, _ = n.static(n.encode(begun[2]))
            got.append(float(losses.psnr(render_fitted(g, begun[2], torch.full((len(begun[2]), 3), 0.5), 4)[0], begun[2]).mean()))
    assert got[1] > got[0]


@torch.no_grad()
def test_a_gate_that_brings_the_second_frame_forward_is_taken_out_again_when_frames_are_kept_apart(begun):
    net, _, frames, _ = begun
    n = network.StreamSplat(network.Config(**CONFIG))
    n.load_state_dict(net.state_dict())
    depth.keep_frames_apart(n)
    assert depth.come_forward(n, frames, margin=1e-9) > 0
    assert n.gs_dynamic_predictor.gs_layer['xyz_dynamic'].layers['7'].weight[1].any()
    depth.keep_frames_apart(n)
    again = {k: v.clone() for k, v in n.state_dict().items()}
    depth.come_forward(n, frames, margin=1e-9)
    depth.keep_frames_apart(n)
    assert all(torch.equal(v, again[k]) for k, v in n.state_dict().items())


def test_zero_output_branches_stay_so_where_that_is_asked(begun, clips_module, tmp_path):
    zero_output = [name for name, _, size in network.branches(begun[0]) if not size and name.startswith(('decoder', 'gaussian_upsampler'))]
    kept, grown = (trained(begun, clips_module, 'dynamic', tmp_path / str(keep), keep_zero_output=keep) for keep in (True, False))
    sizes = lambda n: {name: size for name, _, size in network.branches(n)}
    assert zero_output and not any(sizes(kept)[name] for name in zero_output) and any(sizes(grown)[name] for name in zero_output)
    velocity = 'gs_dynamic_predictor.gs_layer.xyz_dynamic.layers.7.weight'
    assert not torch.equal(kept.state_dict()[velocity], begun[0].state_dict()[velocity])


@torch.no_grad()
def test_a_zero_output_branch_that_is_left_out_changes_nothing(begun):
    net, _, frames, _ = begun
    computed, left_out = (network.StreamSplat(network.Config(**CONFIG)).requires_grad_(grad) for grad in (True, False))
    for n in (computed, left_out):
        n.load_state_dict(net.state_dict())
    a, b = computed(frames[:2]), left_out(frames[:2])
    assert left_out.gaussian_upsampler.attention_0.resblocks[0].mlp.zero_output and not computed.gaussian_upsampler.attention_0.resblocks[0].mlp.zero_output
    assert all(torch.equal(a[k], b[k]) for k in a)


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


def test_a_stage_runs_on_the_triton_kernels_and_resumes_to_the_bit(begun, clips_module, tmp_path):
    """Uses the interpreter where there is no GPU: one small crop."""
    net, _, _, _ = begun
    first = {k: v.clone() for k, v in net.state_dict().items()}
    more = dict(rasteriser='triton', mixed=True, steps=2, crop=(3, 3))
    results = []
    for name, stops in (('whole', (None,)), ('halves', (1, None)), ('cpu', (None,))):
        for until in stops:
            n = network.StreamSplat(network.Config(**CONFIG))
            n.load_state_dict(first)
            if name == 'cpu':
                more['rasteriser'] = 'cpu'
            stages.static(n, options(until=until, **more), Run(tmp_path / name), clips_module, Run(tmp_path / name).state)
        results.append(n.state_dict())
    assert all(torch.equal(v, results[1][k]) for k, v in results[0].items())
    head = 'gs_predictor.predictor.gs_layer.rgb.bias'
    assert not torch.equal(results[0][head], first[head])
    assert float((results[0][head] - results[2][head]).abs().max()) < 0.2 * float((results[0][head] - first[head]).abs().max())
