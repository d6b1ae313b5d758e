"""Images against a plain float64 version and the oracle's scenes; gradients against float64 automatic differentiation."""
import pytest
import torch
from conftest import FIXTURES
from safetensors.torch import load_file

from train.rasteriser import Splat, fitted_colours, opacity_at, render, render_fitted, render_pair


def plain(P, values, key, background, H, W):
    """The definition, one splat at a time, differentiable in float64."""
    y, x = torch.meshgrid(torch.arange(H, dtype=torch.float64), torch.arange(W, dtype=torch.float64), indexing='ij')
    T, C, done = torch.ones(H, W, dtype=torch.float64), torch.zeros(4, H, W, dtype=torch.float64), torch.zeros(H, W, dtype=torch.bool)
    for i in torch.argsort(key, stable=True):
        p = P[i]
        a = (p[4] * torch.exp(-0.5 * ((p[0] - x) ** 2 / p[2] + (p[1] - y) ** 2 / p[3]))).clamp(max=0.99)
        hit = (a >= 1 / 255) & ~done
        after = T * (1 - a)
        stop = hit & (after < 1e-4)
        done = done | stop
        use = hit & ~stop
        C = C + torch.where(use, a * T, torch.zeros_like(a)) * values[i][:, None, None]
        T = torch.where(use, after, T)
    return C + T * background[:, None, None]


@pytest.fixture
def scene():
    torch.manual_seed(0)
    M, N, H, W = 3, 60, 14, 21
    P = torch.stack([torch.rand(M, N) * W, torch.rand(M, N) * H, 0.5 + 8 * torch.rand(M, N), 0.5 + 5 * torch.rand(M, N), 0.02 + 0.97 * torch.rand(M, N)], -1)
    P[:, ::7, 4] = 1.0
    return P, torch.rand(M, N, 4), torch.rand(M, N), torch.rand(M, 4), H, W


def test_images_and_gradients_agree_with_float64(scene):
    P, values, key, background, H, W = scene
    P.requires_grad_(); values.requires_grad_()
    pull = torch.randn(3, 4, H, W)
    image, _ = Splat.apply(P, values, key, background, H, W)
    (image * pull).sum().backward()
    for m in range(3):
        p, v = P[m].detach().double().requires_grad_(), values[m].detach().double().requires_grad_()
        want = plain(p, v, key[m], background[m].double(), H, W)
        (want * pull[m].double()).sum().backward()
        assert float((image[m] - want).detach().abs().max()) < 2e-5
        assert bool(((P.grad[m] - p.grad).norm(dim=0) / p.grad.norm(dim=0) < 2e-4).all())
        assert float((values.grad[m] - v.grad).norm() / v.grad.norm()) < 1e-5


def test_equal_depths_keep_the_order_of_storage(scene):
    P, values, key, background, H, W = scene
    a, _ = Splat.apply(P, values, torch.zeros_like(key), background, H, W)
    b, _ = Splat.apply(P, values, torch.arange(key.shape[1]).float().expand_as(key), background, H, W)
    assert torch.equal(a, b)


def test_a_window_is_a_piece_of_the_whole():
    torch.manual_seed(1)
    n = 200
    xyz = torch.stack([torch.rand(n) * 2 - 1, torch.rand(n), torch.rand(n) * 2 - 1], -1)[None]
    args = xyz, 0.01 + 0.05 * torch.rand(1, n, 2), torch.rand(1, n), torch.rand(1, n, 3)
    whole, _ = render(*args, 48, 80, torch.full((1, 3), 0.5))
    part, _ = render(*args, 24, 32, torch.full((1, 3), 0.5), (48, 80), (16, 40))
    assert float((whole[..., 16:40, 40:72] - part).abs().max()) < 1e-5


@pytest.mark.parametrize('name', ('predicted-t000', 'predicted-t050'))
def test_a_predicted_scene_agrees_with_the_oracle(name):
    """View-space Gaussians of the float64 oracle, through the same projection."""
    s = load_file(str(FIXTURES / 'oracle' / f'{name}.safetensors'))
    H, W = s['out.rgb'].shape[1:]
    mean, scale, focal = s['mean'][None], s['scale'][None], s['focal']
    u, v = mean[..., 0] * focal[0] + (W - 1) / 2, mean[..., 1] * focal[1] + (H - 1) / 2
    depth = mean[..., 2]
    P = torch.stack([u, v, (scale[..., 0] * focal[0]) ** 2 + 0.3, (scale[..., 1] * focal[1]) ** 2 + 0.3, s['opacity'][None] * (depth > 0)], -1)
    values = torch.cat([s['rgb'][None], depth[..., None]], -1)
    background = torch.cat([s['background'], torch.zeros(1)])[None]
    image, T = Splat.apply(P, values, depth, background, H, W)
    assert float((image[0, :3].double() - s['out.rgb']).abs().max()) < 1e-4
    assert float((image[0, 3].double() - s['out.depth']).abs().max()) < 1e-4
    assert float((T[0].double() - s['out.final_T']).abs().max()) < 1e-4


def test_opacity_is_static_at_its_own_frame_and_never_overflows():
    gamma = torch.tensor([[0.0, 0.5], [1e6, 0.0], [1e6, 1.0], [3.0, 0.3]])
    assert torch.equal(opacity_at(gamma, torch.zeros(4)), torch.ones(4))
    assert bool(torch.isfinite(opacity_at(gamma, torch.ones(4))).all())


def test_the_first_frame_alone_is_the_pair_with_a_second_one_that_cannot_be_seen():
    torch.manual_seed(1)
    u = lambda n: torch.rand(2, 2, 30, n)
    g = dict(xyz=u(3) * torch.tensor([2.0, 1.0, 2.0]) - torch.tensor([1.0, 0.0, 1.0]), scale=0.1 * u(2), opacity=u(1), rgb=u(3), velocity=0.1 * (u(3) - 0.5), gamma=3 * u(2))
    g['opacity'][:, 1] = 0
    times, background = torch.tensor([[0.0, 0.3, 1.0]] * 2), torch.rand(2, 3, 3)
    both, alone = render_pair(g, times, 16, 24, background), render_pair({k: t[:, :1] for k, t in g.items()}, times, 16, 24, background)
    torch.testing.assert_close(alone, both)
    assert float((alone[0][:, 0] - alone[0][:, 2]).abs().max()) > 0.01


def test_fitted_colours_are_those_of_least_squares(scene):
    P, values, key, _, H, W = scene
    P = P[:, :20].contiguous()
    key, rgb, background, target = key[:, :20].contiguous(), values[:, :20, :3].contiguous(), torch.full((3, 3), 0.5), torch.rand(3, 3, H, W)
    got = fitted_colours(P, rgb, key, background, target, 60, limits=(-1e9, 1e9))
    for m in range(3):
        column = lambda i: plain(P[m].double(), torch.eye(20, dtype=torch.float64)[:, i:i + 1].expand(20, 4), key[m], torch.zeros(4, dtype=torch.float64), H, W)[0].flatten()
        A = torch.stack([column(i) for i in range(20)], 1)
        rest = target[m].double() - plain(P[m].double(), torch.cat([rgb[m], rgb[m, :, :1]], 1).double(), key[m], torch.full((4,), 0.5, dtype=torch.float64), H, W)[:3]
        change = torch.linalg.solve(A.T @ A + 1e-3 * torch.eye(20, dtype=torch.float64), A.T @ rest.flatten(1).T)
        assert float((got[m].double() - rgb[m].double() - change).abs().max()) < 1e-3 * float(change.abs().max())


def test_a_picture_of_fitted_colours_is_nearer_and_its_gradient_is_that_of_the_least_squares():
    torch.manual_seed(2)
    n, H, W = 60, 16, 24
    g = dict(xyz=torch.rand(1, n, 3) * torch.tensor([2.0, 1.0, 2.0]) - torch.tensor([1.0, 0.0, 1.0]), scale=0.05 + 0.1 * torch.rand(1, n, 2), opacity=0.2 + 0.6 * torch.rand(1, n, 1), rgb=torch.rand(1, n, 3))
    target, background = 0.4 + 0.2 * torch.rand(1, 3, H, W), torch.full((1, 3), 0.5)
    error = lambda scale: (render_fitted(dict(g, scale=scale), target, background, 60)[0] - target).pow(2).sum()
    own = (render(g['xyz'], g['scale'], g['opacity'][..., 0], g['rgb'], H, W, background)[0][:, :3] - target).pow(2).sum()
    scale = g['scale'].clone().requires_grad_()
    least = error(scale)
    least.backward()
    assert float(least.detach()) < 0.9 * float(own)
    along = torch.randn_like(scale)
    with torch.no_grad():
        slope = (error(scale + 2e-4 * along) - error(scale - 2e-4 * along)) / 4e-4
    assert float(slope) == pytest.approx(float((scale.grad * along).sum()), rel=0.1)
