"""The network under its official parameter names, so that `state_dict()` is a checkpoint (except for the prefix `model.`).

Frames are `[2B, 3, H, W]` in [0, 1] with the two frames of a pair adjacent; every per-frame quantity is `[2B, ...]`.
"""
import json
import math
from dataclasses import asdict, dataclass, fields

import torch
import torch.nn as nn
import torch.nn.functional as F

EPS = 1e-3                                # the truncated normal is on [-1 + EPS, 1 - EPS]


@dataclass
class Config:
    hidden_dim: int = 256
    encoder_layers: int = 1
    decoder_layers: int = 2
    resolution: tuple = (144, 256)
    patch_size: int = 8
    upsampler_window: int = 64
    upsampler_stages: int = 2
    condition_len: int = 576              # length of the condition's position table
    condition_dim: int = 0                # width of external condition features (use_dino); 0: the other frame's embedding
    use_dino: bool = False
    encoder_window: int = 0               # 0: full attention
    static_position: str = 'tanh'         # or 'truncated_normal'
    depth: str = ''                       # 'ignored': the weights ignore the depth channel, so the engine lifts Gaussians by maps instead

    @property
    def grid(self):
        return self.resolution[0] // self.patch_size, self.resolution[1] // self.patch_size

    @property
    def splat_grid(self):
        k = 2 ** self.upsampler_stages
        return self.grid[0] * k, self.grid[1] * k

    @staticmethod
    def of(entries):
        known = {f.name for f in fields(Config)}
        entries = {k: v for k, v in entries.items() if k in known}
        entries['resolution'] = tuple(entries['resolution'])
        return Config(**entries)


def sinusoid(n, d):
    """1-D position table: sine on even channels, cosine on odd ones."""
    freq = torch.exp(torch.arange(0, d, 2, dtype=torch.float32) * (-math.log(10000.0) / d))
    angle = torch.arange(n, dtype=torch.float32)[:, None] * freq
    return torch.stack([torch.sin(angle), torch.cos(angle)], -1).flatten(1)


class RmsNorm(nn.Module):
    def __init__(self, d):
        super().__init__()
        self.weight = nn.Parameter(torch.ones(d))

    def forward(self, x):
        return F.rms_norm(x, (x.shape[-1],), self.weight, 1e-5)


class Branch(nn.Module):
    """A residual branch; `last` is its output projection."""

    @property
    def zero_output(self):
        """True if the branch adds exactly zero and is not trained: its product need not be computed."""
        if self.last.weight.requires_grad:
            return False
        if not hasattr(self, '_zero_output'):
            self._zero_output = not any(bool(p.any()) for p in self.last.parameters())
        return self._zero_output


class Attention(Branch):
    def __init__(self, d):
        super().__init__()
        self.heads = d // 64
        self.packed_proj = nn.Linear(d, 3 * d)
        self.out_proj = nn.Linear(d, d)

    @property
    def last(self):
        return self.out_proj

    def forward(self, query, source=None):
        d = query.shape[-1]
        if source is None:
            q, k, v = self.packed_proj(query).chunk(3, -1)
        else:
            w, b = self.packed_proj.weight, self.packed_proj.bias
            q = F.linear(query, w[:d], b[:d])
            k, v = F.linear(source, w[d:], b[d:]).chunk(2, -1)
        split = lambda t: t.unflatten(-1, (self.heads, 64)).transpose(1, 2)
        o = F.scaled_dot_product_attention(split(q), split(k), split(v))
        return self.out_proj(o.transpose(1, 2).flatten(-2))


class FeedForward(Branch):
    def __init__(self, d):
        super().__init__()
        self.c_fc = nn.Linear(d, 4 * d, bias=False)
        self.c_proj = nn.Linear(4 * d, d, bias=False)

    @property
    def last(self):
        return self.c_proj

    def forward(self, x):
        return self.c_proj(F.silu(self.c_fc(x)))


def windowed(x, window, rolled, attend):
    """`attend` inside consecutive runs of `window` tokens; `rolled` moves the runs by half a window around the end."""
    if not window:
        return attend(x)
    b, n, d = x.shape
    if rolled:
        x = torch.roll(x, window // 2, 1)
    x = attend(x.reshape(b * n // window, window, d)).reshape(b, n, d)
    return torch.roll(x, -(window // 2), 1) if rolled else x


class Block(nn.Module):
    def __init__(self, d, window=0, rolled=False):
        super().__init__()
        self.attn, self.layernorm1 = Attention(d), RmsNorm(d)
        self.mlp, self.layernorm2 = FeedForward(d), RmsNorm(d)
        self.window, self.rolled = window, rolled

    def forward(self, x):
        if not self.attn.zero_output:
            x = x + windowed(self.layernorm1(x), self.window, self.rolled, self.attn)
        return x if self.mlp.zero_output else x + self.mlp(self.layernorm2(x))


class Stack(nn.Module):
    def __init__(self, blocks):
        super().__init__()
        self.resblocks = nn.ModuleList(blocks)

    def forward(self, x):
        for block in self.resblocks:
            x = block(x)
        return x


class PositionTable(nn.Module):
    def __init__(self, n, d):
        super().__init__()
        self.register_buffer('pe', sinusoid(n, d))


class FrameEncoder(nn.Module):
    def __init__(self, c):
        super().__init__()
        d = c.hidden_dim
        self.conv = nn.Conv2d(4, d, c.patch_size, c.patch_size, bias=False)
        self.positional_encoding = PositionTable(c.grid[0] * c.grid[1], d)
        self.layernorm1, self.layernorm2 = RmsNorm(d), RmsNorm(d)
        self.transformer = Stack([Block(d, c.encoder_window, i % 2 == 1) for i in range(c.encoder_layers)])
        self.columns = c.grid[1]

    def tokens(self, rgbd):
        return self.conv(rgbd).flatten(2).transpose(1, 2)

    def forward(self, rgbd, place=(0, 0)):
        """`place`: token row and column of the full grid at which a smaller crop is placed."""
        h, w = rgbd.shape[2] // self.conv.kernel_size[0], rgbd.shape[3] // self.conv.kernel_size[1]
        index = ((torch.arange(h, device=rgbd.device) + place[0])[:, None] * self.columns + torch.arange(w, device=rgbd.device) + place[1]).flatten()
        x = self.layernorm1(self.tokens(rgbd) + self.positional_encoding.pe[index])
        return self.layernorm2(self.transformer(x))


class PixelShuffleUp(nn.Module):
    def __init__(self, d, d_out):
        super().__init__()
        self.residual_fc = nn.Linear(d, 4 * d_out)
        self.d_out = d_out

    def forward(self, x, grid):
        b, (h, w), k = x.shape[0], grid, self.d_out
        x = self.residual_fc(x).view(b, h, w, k, 2, 2)                    # channel 4c + 2i + j -> channel c of sub-token (i, j)
        return x.permute(0, 1, 4, 2, 5, 3).reshape(b, 4 * h * w, k)


class Upsampler(nn.Module):
    def __init__(self, c):
        super().__init__()
        d = c.hidden_dim
        self.stages, self.grid = c.upsampler_stages, c.grid
        for i in range(self.stages):
            d_out = max(d // 2, 64) // 64 * 64
            self.add_module(f'upsampler_{i}', PixelShuffleUp(d, d_out))
            self.add_module(f'attention_{i}', Stack([Block(d_out, c.upsampler_window, j == 1) for j in range(2)]))
            d = d_out
        self.layernorm2 = RmsNorm(d)
        self.d_out = d

    def forward(self, x, grid=None):
        h, w = grid or self.grid
        for i in range(self.stages):
            x = getattr(self, f'attention_{i}')(getattr(self, f'upsampler_{i}')(x, (h, w)))
            h, w = 2 * h, 2 * w
        return self.layernorm2(x)


def truncated_normal(mean, log_scale, u):
    """Sample on [-1+EPS, 1-EPS] by inverse cdf; see the kernels' `truncated_normal` for the numerically careful version."""
    lo, hi, sigma = -1 + EPS, 1 - EPS, log_scale.clamp(-5, 10).exp()
    cdf = lambda x: 0.5 * (1 + torch.erf(x / math.sqrt(2)))
    cl, ch = cdf((lo - mean) / sigma), cdf((hi - mean) / sigma)
    v = mean + sigma * math.sqrt(2) * torch.erfinv((2 * (u.clamp(EPS, 1 - EPS) * (ch - cl) + cl) - 1).clamp(-1 + 1e-6, 1 - 1e-6))
    v = torch.where(ch - cl <= EPS, torch.full_like(v, lo), v)
    return torch.where(log_scale <= -5, mean, v).clamp(lo, hi)


class StaticHead(nn.Module):
    def __init__(self, c, d):
        super().__init__()
        h, w = c.splat_grid
        self.sampled = c.static_position == 'truncated_normal'
        layers = {'scale': nn.Linear(d, 2), 'opacity': nn.Linear(d, 1), 'rgb': nn.Linear(d, 3)}
        if self.sampled:
            self.mix_layer = nn.ModuleDict({'xyz_static_mean': nn.Linear(d, 3), 'xyz_static_scale': nn.Linear(d, 3)})
        else:
            layers['xyz_static'] = nn.Linear(d, 3)
        self.gs_layer = nn.ModuleDict(layers)
        xs, zs = torch.linspace(-1, 1, w + 1), torch.linspace(1, -1, h + 1)
        z, x = torch.meshgrid((zs[1:] + zs[:-1]) / 2, (xs[1:] + xs[:-1]) / 2, indexing='ij')
        self.register_buffer('x_map', x.flatten())
        self.register_buffer('z_map', z.flatten())
        self.grid = (h, w)

    def forward(self, token, u=None, cells=None):
        """`u` [.., N, 3] in [0, 1): sample positions where the head has a distribution; `cells`: this crop's part of the maps."""
        if self.sampled:
            mean = torch.tanh(self.mix_layer['xyz_static_mean'](token)) * (1 - EPS)
            o = mean if u is None else truncated_normal(mean, self.mix_layer['xyz_static_scale'](token), u)
        else:
            o = torch.tanh(self.gs_layer['xyz_static'](token))
        x_map, z_map = (self.x_map, self.z_map) if cells is None else (self.x_map[cells], self.z_map[cells])
        xyz = torch.stack([x_map + o[..., 0] / self.grid[1], 0.5 + 0.5 * o[..., 1], z_map + o[..., 2] / self.grid[0]], -1)
        return dict(xyz=xyz, scale=0.1 * F.softplus(self.gs_layer['scale'](token)),
                    opacity=0.05 + 0.95 * torch.sigmoid(self.gs_layer['opacity'](token)), rgb=torch.sigmoid(self.gs_layer['rgb'](token)))


class HeadMlp(nn.Module):
    """Three linear layers with SiLU between, stored at the indices of the official Sequential."""

    def __init__(self, d_in, d, d_out):
        super().__init__()
        self.layers = nn.ModuleDict({'1': nn.Linear(d_in, d), '4': nn.Linear(d, d), '7': nn.Linear(d, d_out)})

    def forward(self, x):
        return self.layers['7'](F.silu(self.layers['4'](F.silu(self.layers['1'](x)))))


class DynamicHead(nn.Module):
    def __init__(self, d):
        super().__init__()
        self.gs_layer = nn.ModuleDict({'xyz_dynamic': HeadMlp(2 * d, d, 3), 'opacity_dynamic': HeadMlp(2 * d, d, 2),
                                       'xyz_dynamic_scale': nn.Linear(2 * d, 3, bias=False)})
        self.register_buffer('dynamic_scalar', torch.tensor([0.5, 0.1, 0.5]))

    def forward(self, token, u=None):
        mean = torch.tanh(self.gs_layer['xyz_dynamic'](token)) * (1 - EPS)
        if u is not None:
            mean = truncated_normal(mean, self.gs_layer['xyz_dynamic_scale'](token), u)
        g = self.gs_layer['opacity_dynamic'](token)
        return mean * self.dynamic_scalar, torch.stack([F.relu(g[..., 0]), torch.sigmoid(g[..., 1])], -1)


class PairBlock(nn.Module):
    def __init__(self, d, window=0, rolled=False):
        super().__init__()
        self.self_attn, self.self_attn_ln = Attention(d), RmsNorm(d)
        self.cross_attn, self.cross_attn_ln = Attention(d), RmsNorm(d)
        self.mlp, self.mlp_ln = FeedForward(d), RmsNorm(d)
        self.window, self.rolled = window, rolled

    def forward(self, x, condition):                     # x [B, 2N, d], condition [2B, M, d]
        if not self.self_attn.zero_output:
            x = x + windowed(self.self_attn_ln(x), self.window, self.rolled, self.self_attn)
        b, n, d = x.shape
        x = x.reshape(2 * b, n // 2, d)
        if not self.cross_attn.zero_output:
            x = x + self.cross_attn(self.cross_attn_ln(x), condition)
        if not self.mlp.zero_output:
            x = x + self.mlp(self.mlp_ln(x))
        return x.reshape(b, n, d)


class PairDecoder(nn.Module):
    def __init__(self, c):
        super().__init__()
        d, n = c.hidden_dim, c.grid[0] * c.grid[1]
        self.positional_embedding = nn.Parameter(torch.zeros(1, 2 * n, d))
        self.cls_embedding = nn.Parameter(torch.zeros(1, 2, d))
        self.positional_encoding = PositionTable(c.condition_len, d)
        self.condition_proj = nn.Linear(c.condition_dim or d, d, bias=False)
        self.condition_ln = RmsNorm(d)
        self.layernorm1, self.layernorm2 = RmsNorm(d), RmsNorm(d)
        self.transformer = Stack([PairBlock(d, c.encoder_window, i % 2 == 1) for i in range(c.decoder_layers)])

    def forward(self, h, features=None):
        """`features` [2B, M, D']: of each frame, in frame order; every frame is conditioned on the other one's."""
        b2, n, d = h.shape
        features = h if features is None else features
        other = features.unflatten(0, (-1, 2)).flip(1).flatten(0, 1)
        condition = self.condition_ln(self.condition_proj(other) + self.positional_encoding.pe[:other.shape[1]])
        x = h.reshape(b2 // 2, 2 * n, d) + self.positional_embedding + self.cls_embedding.repeat_interleave(n, 1)
        x = self.layernorm1(x)
        for block in self.transformer.resblocks:
            x = block(x, condition)
        return self.layernorm2(x).reshape(b2, n, d)


class _Named(nn.Module):
    def __init__(self, **children):
        super().__init__()
        for k, v in children.items():
            self.add_module(k, v)


class StreamSplat(nn.Module):
    def __init__(self, c):
        super().__init__()
        self.config = c
        self.gaussian_upsampler = Upsampler(c)                              # of the deformation tokens
        d = self.gaussian_upsampler.d_out
        self.gs_predictor = _Named(encoder=_Named(transformer_encoder=FrameEncoder(c)), gaussian_upsampler=Upsampler(c), predictor=StaticHead(c, d))
        self.decoder = _Named(transformer_decoder=PairDecoder(c))
        self.gs_dynamic_predictor = DynamicHead(d)
        self.encoder_proj = nn.Linear(d, d, bias=False)

    def encode(self, rgb, depth=None, place=(0, 0)):
        depth = torch.zeros_like(rgb[:, :1]) if depth is None else depth
        return self.gs_predictor.encoder.transformer_encoder(torch.cat([rgb, depth], 1), place)

    def static(self, h, u=None):
        token = self.gs_predictor.gaussian_upsampler(h)
        return self.gs_predictor.predictor(token, u), token

    def cells(self, grid, place):
        """Indices into the cell maps of a crop of `grid` tokens at token `place`; None for the full frame."""
        if tuple(grid) == self.config.grid:
            return None
        k = 2 ** self.config.upsampler_stages
        rows, columns = torch.arange(grid[0] * k) + place[0] * k, torch.arange(grid[1] * k) + place[1] * k
        return (rows[:, None] * self.config.splat_grid[1] + columns).flatten().to(self.gs_predictor.predictor.x_map.device)

    def dynamic(self, h, static_token, features=None, u=None):
        d = self.decoder.transformer_decoder(h, features)
        token = self.gaussian_upsampler(d)
        velocity, gamma = self.gs_dynamic_predictor(torch.cat([self.encoder_proj(static_token), token], -1), u)
        return velocity, gamma, d, token

    def forward(self, rgb, depth=None):
        """Frames [2B, 3, H, W] -> Gaussians of both frames of each pair, `[B, 2, N, .]`."""
        h = self.encode(rgb, depth)
        g, token = self.static(h)
        g['velocity'], g['gamma'], _, _ = self.dynamic(h, token)
        return {k: t.unflatten(0, (-1, 2)) for k, t in g.items()}


def load_official(net, entries):
    """Takes a state dict with official names and either prefix; missing keys are an error, extra ones are not."""
    own, out = net.state_dict(), {}
    for k, v in entries.items():
        for prefix in ('model._orig_mod.', 'model.'):
            if k.startswith(prefix):
                k = k[len(prefix):]
                break
        if k in own:
            out[k] = v.float()
    missing = [k for k in own if k not in out]
    if missing:
        raise KeyError(f'checkpoint lacks {missing}')
    net.load_state_dict(out)
    return net


@torch.no_grad()
def branches(net):
    """(name, output projection, largest entry of the projection) of every residual branch."""
    found = [(name, module.last) for name, module in net.named_modules() if isinstance(module, Branch)]
    return [(name, last, max(float(p.abs().max()) for p in last.parameters())) for name, last in found]


@torch.no_grad()
def zero_small_branches(net, least):
    """Zeroes the output projections of residual branches whose weights and biases are all smaller than `least`. They add almost nothing, and the engine skips
    branches that add exactly zero. Returns the names."""
    quiet = [(name, last) for name, last, size in branches(net) if size < least]
    for _, last in quiet:
        for p in last.parameters():
            p.zero_()
    return [name for name, _ in quiet]


def save_official(net, path, dtype=torch.float16):
    """Writes `path` (safetensors, prefix `model.`), and `path` with .json: the settings that shapes do not determine."""
    from safetensors.torch import save_file
    c = net.config
    save_file({'model.' + k: v.detach().cpu().to(dtype).contiguous() for k, v in net.state_dict().items()}, str(path))
    entries = {k: v for k, v in asdict(c).items() if k != 'condition_dim' and not (k in ('encoder_window', 'depth') and not v)}
    entries['resolution'] = list(c.resolution)
    with open(str(path).removesuffix('.safetensors') + '.json', 'w') as f:
        json.dump(entries, f, indent=1)


def open_official(path):
    from safetensors.torch import load_file
    with open(str(path).removesuffix('.safetensors') + '.json') as f:
        c = Config.of(json.load(f))
    return load_official(StreamSplat(c), load_file(str(path)))
