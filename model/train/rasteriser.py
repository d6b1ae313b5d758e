"""Differentiable splatting and StreamSplat's Gaussians in time: rasteriser.cpp on the CPU (compiled on first use), rasteriser_triton.py on CUDA."""
import ctypes
import hashlib
import math
import os
import pathlib
import subprocess
import tempfile

import torch

SOURCE = pathlib.Path(__file__).with_name('rasteriser.cpp')
COMMAND = ['g++', '-O3', '-march=native', '-ffast-math', '-std=c++17', '-shared', '-fPIC', '-pthread']


def _library():
    """Compiled once per source and machine, into the user's cache folder."""
    cache = pathlib.Path(os.environ.get('XDG_CACHE_HOME', pathlib.Path.home() / '.cache')) / 'streamsplat-train'
    key = hashlib.sha256(SOURCE.read_bytes() + ' '.join(COMMAND).encode() + os.uname().nodename.encode()).hexdigest()[:16]
    path = cache / f'rasteriser-{key}.so'
    if not path.exists():
        cache.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=cache) as tmp:
            subprocess.check_call([*COMMAND, str(SOURCE), '-o', f'{tmp}/r.so'])
            os.replace(f'{tmp}/r.so', path)
    return ctypes.CDLL(str(path))


_lib = None


def _call(name, *args):
    global _lib
    _lib = _lib or _library()
    getattr(_lib, name)(*[ctypes.c_void_p(a.data_ptr()) if torch.is_tensor(a) else a for a in args], torch.get_num_threads())


class Splat(torch.autograd.Function):
    """P [M,N,5] = u, v, var_x, var_y, opacity in pixels; values [M,N,4]; depth key [M,N]; background [M,4] -> image [M,4,H,W], T [M,H,W]."""

    @staticmethod
    def forward(ctx, P, values, key, background, H, W):
        P, values, key, background = (t.detach().contiguous().float() for t in (P, values, key, background))
        M, N = key.shape
        image, T = torch.empty(M, 4, H, W), torch.empty(M, H, W)
        last, order = torch.empty(M, H, W, dtype=torch.int32), torch.empty(M, N, dtype=torch.int32)
        _call('splat_forward', M, N, H, W, P, values, key, background, image, T, last, order)
        ctx.save_for_backward(P, values, background, T, last, order)
        ctx.mark_non_differentiable(T)
        return image, T

    @staticmethod
    def backward(ctx, G, _):
        P, values, background, T, last, order = ctx.saved_tensors
        M, N = order.shape
        H, W = T.shape[1:]
        gP, gV, G = torch.zeros_like(P), torch.zeros_like(values), G.contiguous().float()
        _call('splat_backward', M, N, H, W, P, values, background, T, last, order, G, gP, gV)
        return gP, gV, None, None, None, None


def splat(P, values, key, background, H, W, kernels=None):
    """`kernels`: 'cpu' or 'triton'; by default what the tensors' device asks for."""
    if (kernels or ('triton' if P.is_cuda else 'cpu')) == 'cpu':
        return Splat.apply(P, values, key, background, H, W)
    from .rasteriser_triton import SplatTriton
    return SplatTriton.apply(P, values, key, background, H, W)


def opacity_at(gamma, dt):
    """Factor of the static opacity at distance `dt` from the Gaussian's own frame; 1 at 0, never overflows."""
    g0, g1 = gamma[..., 0], gamma[..., 1]
    return torch.sigmoid(-g0 * (dt.abs() - g1)) / torch.sigmoid(g0 * g1)


def render(xyz, scale, opacity, rgb, H, W, background, full=None, offset=(0, 0), kernels=None, order=None):
    """World-space Gaussians [M,N,.] in the canonical camera -> image [M,4,H,W] (r, g, b, depth), transmittance [M,H,W].

    `full` (rows, columns) and `offset` (row, column) cut a window out of a larger image; y is normalised inverse depth. `order` [M,N]
    takes the place of depth as what Gaussians are sorted by."""
    full_h, full_w = full or (H, W)
    y = xyz[..., 1]
    depth = 1.0 / (9.8 * y.clamp(0, 1) + 0.2 + 1e-6)
    u = ((xyz[..., 0] + 1) * full_w - 1) * 0.5 - offset[1]
    v = ((1 - xyz[..., 2]) * full_h - 1) * 0.5 - offset[0]
    variance = lambda s, focal: (s * focal) ** 2 + 0.3
    visible = ((y >= 0) & (y <= 1)).to(y.dtype)
    P = torch.stack([u, v, variance(scale[..., 0], full_w / 2), variance(scale[..., 1], full_h / 2), opacity * visible], -1)
    values = torch.cat([rgb, depth[..., None]], -1)
    return splat(P, values, depth.detach() if order is None else order, torch.cat([background, torch.zeros_like(background[:, :1])], 1), H, W, kernels)


def render_static(g, H, W, background, full=None, offset=(0, 0), kernels=None):
    return render(g['xyz'], g['scale'], g['opacity'][..., 0], g['rgb'], H, W, background, full, offset, kernels)


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


def render_turned(xyz, scale, opacity, rgb, H, W, background, degrees, pivot):
    """As `render`, by an orthographic camera that is led around the vertical line through the optical axis at distance `pivot` [M]; the scale
    along the optical axis is the mean of the two others."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    y = xyz[..., 1]
    behind = 1.0 / (9.8 * y.clamp(0, 1) + 0.2 + 1e-6) - pivot[:, None]
    x, distance = c * xyz[..., 0] - s * behind, pivot[:, None] + s * xyz[..., 0] + c * behind
    u, v = ((x + 1) * W - 1) * 0.5, ((1 - xyz[..., 2]) * H - 1) * 0.5
    variance_x = (c * scale[..., 0]) ** 2 + (s * scale.mean(-1)) ** 2
    visible = ((y >= 0) & (y <= 1) & (distance > 0)).to(y.dtype)
    P = torch.stack([u, v, variance_x * (W / 2) ** 2 + 0.3, (scale[..., 1] * H / 2) ** 2 + 0.3, opacity * visible], -1)
    return splat(P, torch.cat([rgb, distance[..., None]], -1), distance, torch.cat([background, torch.zeros_like(background[:, :1])], 1), H, W)
