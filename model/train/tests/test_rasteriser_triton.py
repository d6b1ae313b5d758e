"""The Triton kernels against the CPU rasteriser: on CUDA where there is one, else by Triton's interpreter."""
import pytest
import torch

from train.rasteriser import fitted_colours, render_pair, splat

DEVICE = 'cuda' if torch.cuda.is_available() else 'cpu'


def scene(M=2, N=40, H=20, W=37, seed=0):
    g = torch.Generator().manual_seed(seed)
    r = lambda *n: torch.rand(*n, generator=g)
    P = torch.stack([r(M, N) * (W + 8) - 4, r(M, N) * (H + 8) - 4, 0.4 + 9 * r(M, N), 0.4 + 6 * r(M, N), 1.1 * r(M, N)], -1)
    P[:, ::9, 4] = 1.0                                   # opaque ones end pixels
    P[:, 1::9, 4] = 0.0                                  # invisible ones
    key = r(M, N)
    key[:, : N // 2] = key[:, :1]                        # ties
    return P, r(M, N, 4), key, r(M, 4), H, W


def both(P, values, key, background, H, W, pull):
    out = []
    for kernels, device in (('cpu', 'cpu'), ('triton', DEVICE)):
        p, v = (t.detach().clone().to(device).requires_grad_() for t in (P, values))
        image, T = splat(p, v, key.to(device), background.to(device), H, W, kernels)
        (image * pull.to(device)).sum().backward()
        out.append([t.detach().cpu() for t in (image, T, p.grad, v.grad)])
    return out


@pytest.mark.parametrize('size', ((20, 37), (16, 16), (5, 50)))
def test_values_and_gradients_are_those_of_the_cpu(size):
    P, values, key, background, H, W = scene(H=size[0], W=size[1])
    pull = torch.randn(2, 4, H, W, generator=torch.Generator().manual_seed(1))
    (a, aT, aP, aV), (b, bT, bP, bV) = both(P, values, key, background, H, W, pull)
    assert float((a - b).abs().max()) < 1e-5 and float((aT - bT).abs().max()) < 1e-5
    assert bool(((aP - bP).flatten(0, 1).norm(dim=0) <= 2e-4 * aP.flatten(0, 1).norm(dim=0)).all())
    assert float((aV - bV).norm() / aV.norm()) < 1e-5


def test_a_stack_that_ends_pixels_ends_them_alike():
    M, N, H, W = 1, 12, 18, 18
    P = torch.tensor([9.0, 9.0, 60.0, 60.0, 1.0]).expand(M, N, 5).clone()
    P[..., 0] += torch.arange(N) * 0.25
    values, key = torch.rand(M, N, 4, generator=torch.Generator().manual_seed(3)), torch.arange(N).float()[None]
    background = torch.full((M, 4), 0.5)
    (a, aT, aP, aV), (b, bT, bP, bV) = both(P, values, key, background, H, W, torch.ones(M, 4, H, W))
    assert float(aT.min()) < 1e-3                        # some pixels end
    assert float((a - b).abs().max()) < 1e-5 and float((aV - bV).norm() / aV.norm()) < 1e-4 and float((aP - bP).norm() / aP.norm()) < 1e-3


def test_nothing_visible_is_the_background():
    P, values, key, background, H, W = scene()
    P[..., 4] = 0.0
    (a, aT, aP, aV), (b, bT, bP, bV) = both(P, values, key, background, H, W, torch.ones(2, 4, H, W))
    assert torch.equal(b, background[:, :, None, None].expand_as(b)) and not bP.any() and not bV.any()


def test_a_pair_in_time_and_its_gradient_repeat_to_the_bit():
    g = torch.Generator().manual_seed(4)
    r = lambda *n: torch.rand(*n, generator=g)
    n = 30
    start = dict(xyz=r(1, 2, n, 3) * 2 - 1, scale=0.02 + 0.1 * r(1, 2, n, 2), opacity=r(1, 2, n, 1), rgb=r(1, 2, n, 3), velocity=0.2 * r(1, 2, n, 3) - 0.1, gamma=r(1, 2, n, 2))
    start['xyz'][..., 1].clamp_(0.1, 0.9)
    runs = []
    for kernels, device in (('triton', DEVICE), ('triton', DEVICE), ('cpu', 'cpu')):
        s = {k: v.to(device).requires_grad_() for k, v in ((k, v.clone()) for k, v in start.items())}
        image, _ = render_pair(s, torch.tensor([[0.0, 0.4]], device=device), 24, 32, torch.full((1, 2, 3), 0.5, device=device), kernels)
        image.pow(2).mean().backward()
        runs.append([image.detach().cpu(), *(t.grad.cpu() for t in s.values())])
    assert all(torch.equal(a, b) for a, b in zip(runs[0], runs[1]))
    for a, b in zip(runs[0], runs[2]):
        assert float((a - b).norm() / b.norm()) < 1e-3


def test_fitted_colours_are_those_of_the_cpu():
    P, values, key, background, H, W = scene(M=1, N=30, H=16, W=20)
    args = P, values[..., :3].contiguous(), key, background[:, :3].contiguous(), torch.rand(1, 3, H, W, generator=torch.Generator().manual_seed(7)), 3
    a, b = fitted_colours(*args, kernels='cpu'), fitted_colours(*(t.to(DEVICE) if torch.is_tensor(t) else t for t in args), kernels='triton').cpu()
    assert float((a - b).abs().max()) < 1e-4
