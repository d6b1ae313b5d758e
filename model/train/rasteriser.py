"""Differentiable splatting and StreamSplat's Gaussians in time: the engine's own rasteriser on the CPU, rasteriser_triton.py on CUDA."""
import math

import torch
from streamsplat_cpu._streamsplat import Planes

# α is limited to this, as in the images that the engine draws.
LARGEST_ALPHA = 0.99


class Splat(torch.autograd.Function):
    """P [M,N,5] = u, v, var_x, var_y, opacity in pixels; values [M,N,4]; depth key [M,N]; background [M,4] -> image [M,4,H,W], T [M,H,W]."""

    @staticmethod
    def paint(P, values, key, background, H, W, lists=None):
        """(image, T, the rasteriser's image and alpha, lists of the splats), without gradients."""
        P, values, key, background = (t.detach().numpy() for t in (P, values, key, background))
        lists = lists or Planes(P, key, W, H, LARGEST_ALPHA)
        drawn = lists.draw(values, background)
        image, alpha = (torch.from_numpy(array) for array in drawn)
        return image.permute(0, 3, 1, 2), 1 - alpha, drawn, lists

    @staticmethod
    def pull(P, values, background, T, drawn, lists, G, geometry=True):
        """The gradients (of P, of values) under G [M,4,H,W]."""
        G = G.detach().float().permute(0, 2, 3, 1).contiguous()
        gradients = lists.gradients(values.detach().numpy(), background.detach().numpy(), *drawn, G.numpy())
        return [torch.from_numpy(array) for array in gradients]

    @staticmethod
    def forward(ctx, P, values, key, background, H, W):
        P, values, key, background = (t.detach().contiguous().float() for t in (P, values, key, background))
        image, T, ctx.drawn, ctx.lists = Splat.paint(P, values, key, background, H, W)
        ctx.save_for_backward(P, values, background, T)
        ctx.mark_non_differentiable(T)
        return image, T

    @staticmethod
    def backward(ctx, G, _):
        return *Splat.pull(*ctx.saved_tensors, ctx.drawn, ctx.lists, G), None, None, None, None


def _splat_class(P, kernels):
    """`kernels`: 'cpu' or 'triton'; by default the one for the tensors' device."""
    if (kernels or ('triton' if P.is_cuda else 'cpu')) == 'cpu':
        return Splat
    from .rasteriser_triton import SplatTriton
    return SplatTriton


def splat(P, values, key, background, H, W, kernels=None):
    return _splat_class(P, kernels).apply(P, values, key, background, H, W)


@torch.no_grad()
def fitted_colours(P, rgb, key, background, target, steps, ridge=1e-3, limits=(-0.2, 1.2), kernels=None):
    """Colours [M,N,3] whose image is nearest to `target` [M,3,H,W], with geometry and order fixed: the engine's fit to a key frame.

    `steps` steps of conjugate gradients from `rgb`, preconditioned by the row sums of the matrix. The ridge keeps colours near `rgb`."""
    kind, (H, W) = _splat_class(P, kernels), target.shape[-2:]
    P, key, zero = P.contiguous().float(), key.contiguous().float(), torch.zeros_like(background)
    wide = lambda c, last: torch.cat([c, torch.full_like(c[..., :1], last)], -1).contiguous()
    image, T, last, lists = kind.paint(P, wide(rgb, 1.0), key, wide(background, 0.0), H, W)
    zero = wide(zero, 0.0)
    normal = lambda image: kind.pull(P, wide(rgb, 0.0), zero, T, last, lists, image, False)[1]
    rest = normal(torch.cat([target - image[:, :3], image[:, 3:]], 1))
    r, scale = rest[..., :3], 1 / (rest[..., 3:] + ridge)
    x, p = torch.zeros_like(r), r * scale
    rz = (r * p).sum(1, keepdim=True)
    for _ in range(steps):
        q = normal(kind.paint(P, wide(p, 0.0), key, zero, H, W, lists)[0])[..., :3] + ridge * p
        a = rz / (p * q).sum(1, keepdim=True).clamp_min(1e-20)
        x, r = x + a * p, r - a * q
        z = r * scale
        after = (r * z).sum(1, keepdim=True)
        p, rz = z + after / rz.clamp_min(1e-20) * p, after
    return (rgb + x).clamp(*limits)


def opacity_at(gamma, dt):
    """Factor of the static opacity at distance `dt` from the Gaussian's own frame; 1 at 0, never overflows."""
    g0, g1 = gamma[..., 0], gamma[..., 1]
    return torch.sigmoid(-g0 * (dt.abs() - g1)) / torch.sigmoid(g0 * g1)


def projected(xyz, scale, opacity, H, W, offset=(0, 0)):
    """World-space Gaussians [M,N,.] in the canonical camera of an H x W image -> P [M,N,5], depth [M,N]."""
    y = xyz[..., 1]
    depth = 1.0 / (9.8 * y.clamp(0, 1) + 0.2 + 1e-6)
    u = ((xyz[..., 0] + 1) * W - 1) * 0.5 - offset[1]
    v = ((1 - xyz[..., 2]) * H - 1) * 0.5 - offset[0]
    variance = lambda s, focal: (s * focal) ** 2 + 0.3
    visible = ((y >= 0) & (y <= 1)).to(y.dtype)
    return torch.stack([u, v, variance(scale[..., 0], W / 2), variance(scale[..., 1], H / 2), opacity * visible], -1), depth


def render(xyz, scale, opacity, rgb, H, W, background, full=None, offset=(0, 0), kernels=None, order=None):
    """World-space Gaussians [M,N,.] in the canonical camera -> image [M,4,H,W] (r, g, b, depth), transmittance [M,H,W].

    `full` (rows, columns) and `offset` (row, column) cut a window out of a larger image; y is normalised inverse depth. Gaussians are sorted by `order` [M,N]
    instead of depth where it is set."""
    P, depth = projected(xyz, scale, opacity, *(full or (H, W)), offset)
    values = torch.cat([rgb, depth[..., None]], -1)
    return splat(P, values, depth.detach() if order is None else order, torch.cat([background, torch.zeros_like(background[:, :1])], 1), H, W, kernels)


def render_static(g, H, W, background, full=None, offset=(0, 0), kernels=None):
    return render(g['xyz'], g['scale'], g['opacity'][..., 0], g['rgb'], H, W, background, full, offset, kernels)


def render_fitted(g, target, background, steps, kernels=None):
    """Whole frames with colours fitted to `target` [M,3,H,W] (`fitted_colours`) -> image [M,3,H,W], the colours [M,N,3].

    The fitted colours are constants: at the least squared error, their own change adds nothing to its gradient."""
    H, W = target.shape[-2:]
    P, depth = projected(g['xyz'], g['scale'], g['opacity'][..., 0], H, W)
    rgb = fitted_colours(P, g['rgb'].detach(), depth, background, target, steps, kernels=kernels)
    image, _ = splat(P, torch.cat([rgb, torch.zeros_like(rgb[..., :1])], -1), depth.detach(), torch.cat([background, torch.zeros_like(background[:, :1])], 1), H, W, kernels)
    return image[:, :3], rgb


def at_times(g, times):
    """Both frames' Gaussians [B,2,N,.], or the first one's alone [B,1,N,.], at `times` [B,K] in [0,1] -> xyz, scale, opacity, rgb [B*K,F*N,.]."""
    B, F, N, _ = g['xyz'].shape
    K = times.shape[1]
    dt = times[:, :, None, None] - times.new_tensor([0.0, 1.0])[:F].view(1, 1, F, 1)                   # [B,K,F,1]
    xyz = g['xyz'][:, None] + g['velocity'][:, None] * dt[..., None]
    opacity = g['opacity'][:, None, ..., 0] * opacity_at(g['gamma'][:, None], dt)
    flat = lambda a: a.reshape(B * K, F * N, a.shape[-1])
    spread = lambda a: flat(a[:, None].expand(B, K, *a.shape[1:]))
    return flat(xyz), spread(g['scale']), opacity.reshape(B * K, F * N), spread(g['rgb'])


def render_pair(g, times, H, W, background, kernels=None):
    """Gaussians of pairs at `times` (`at_times`), background [B,K,3] -> image [B,K,4,H,W], T [B,K,H,W]."""
    B, K = times.shape
    image, T = render(*at_times(g, times), H, W, background.reshape(B * K, 3), kernels=kernels)
    return image.view(B, K, 4, H, W), T.view(B, K, H, W)


def render_turned(xyz, scale, opacity, rgb, H, W, background, degrees, pivot, thickness=1.0, kernels=None):
    """As `render`, by an orthographic camera turned around the vertical line through the optical axis at distance `pivot` [M]; the scale
    along the optical axis is `thickness` times the mean of the two others."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    y = xyz[..., 1]
    behind = 1.0 / (9.8 * y.clamp(0, 1) + 0.2 + 1e-6) - pivot[:, None]
    x, distance = c * xyz[..., 0] - s * behind, pivot[:, None] + s * xyz[..., 0] + c * behind
    u, v = ((x + 1) * W - 1) * 0.5, ((1 - xyz[..., 2]) * H - 1) * 0.5
    variance_x = (c * scale[..., 0]) ** 2 + (s * thickness * scale.mean(-1)) ** 2
    visible = ((y >= 0) & (y <= 1) & (distance > 0)).to(y.dtype)
    P = torch.stack([u, v, variance_x * (W / 2) ** 2 + 0.3, (scale[..., 1] * H / 2) ** 2 + 0.3, opacity * visible], -1)
    return splat(P, torch.cat([rgb, distance[..., None]], -1), distance.detach(), torch.cat([background, torch.zeros_like(background[:, :1])], 1), H, W, kernels)
