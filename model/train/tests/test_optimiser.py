"""Steps of equal size in all directions, and the two kinds of parameters separated."""
import torch

from train import network
from train.optimiser import Mixed, groups_of, orthogonal


def test_singular_values_come_near_one_and_directions_stay():
    g = torch.Generator().manual_seed(0)
    for m, n in ((24, 60), (60, 24)):
        u, _, v = torch.linalg.svd(torch.randn(m, n, generator=g), full_matrices=False)
        x = u * torch.logspace(0, -1.5, 24) @ v
        o = orthogonal(x[None])[0]
        s = torch.linalg.svdvals(o)
        assert 0.5 < float(s.min()) and float(s.max()) < 1.3
        assert float(torch.linalg.det(u.T @ o @ v.T)) > 0 and float((u.T @ o @ v.T - torch.diag(torch.diag(u.T @ o @ v.T))).abs().max()) < 1e-3


def test_a_stack_of_matrices_is_treated_part_by_part():
    p = torch.nn.Parameter(torch.zeros(6, 5))
    g = torch.randn(6, 5, generator=torch.Generator().manual_seed(1))
    whole, apart = [], []
    for parts, out in ((1, whole), (2, apart)):
        p.data.zero_(); p.grad = g.clone()
        Mixed([dict(params=[p], lr=1.0, kind='matrix', parts=parts)]).step()
        out.append(p.detach().clone())
    assert torch.allclose(apart[0][:3], -orthogonal(g[:3][None])[0], atol=1e-5)
    assert not torch.allclose(whole[0], apart[0], atol=1e-2)


def test_a_badly_scaled_valley_is_descended_evenly():
    """Curvatures differ by a factor of ten. Steps of the same length along the gradient would leave the faint rows behind."""
    torch.manual_seed(2)
    scale, target, left = torch.logspace(0, -0.5, 8), torch.randn(8, 8), []
    for plain in (False, True):
        w = torch.nn.Parameter(torch.zeros(8, 8))
        opt = Mixed([dict(params=[w], lr=0.05, kind='matrix')])
        for step in range(200):
            opt.param_groups[0]['lr'] = 0.05 * (1 - step / 200)
            opt.zero_grad()
            (scale[:, None] * (w - target)).pow(2).sum().backward()
            if plain:
                w.data -= opt.param_groups[0]['lr'] * w.grad / torch.linalg.matrix_norm(w.grad, 2)
            else:
                opt.step()
        left.append(float((w - target).detach().abs().max()))
    assert left[0] < 0.4 and left[1] > 2 * left[0], left


def test_every_parameter_lands_in_one_group_and_matrices_in_theirs():
    net = network.StreamSplat(network.Config(hidden_dim=128, resolution=(32, 32), upsampler_window=16, condition_len=16))
    up = net.gs_predictor.gaussian_upsampler
    groups = groups_of(up, 0.1, 0.01, slow={'residual_fc': 0.05})
    assert sum(len(g['params']) for g in groups) == len(list(up.parameters()))
    rates = {name: next(g for g in groups if g['params'][0] is p) for name, p in up.named_parameters()}
    assert rates['upsampler_0.residual_fc.weight']['lr'] == 0.05 and rates['upsampler_0.residual_fc.bias']['kind'] == 'adam'
    assert rates['attention_0.resblocks.0.attn.packed_proj.weight']['parts'] == 3
