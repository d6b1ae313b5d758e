"""The encoder, upsampler and decoder in PyTorch, written out for the comparison: the graphs that every peer runs.

Names of parameters are the checkpoint's; shapes are row-major tokens [N, D] without a batch axis, so that exporters see
constants. Residual streams and norms are float32 in every mode.
"""
import math

import torch
import torch.nn.functional as F
from torch import nn


class RMSNorm(nn.Module):
    def __init__(self, d):
        super().__init__()
        self.weight = nn.Parameter(torch.ones(d))

    def forward(self, x):
        return x * torch.rsqrt(x.square().mean(-1, keepdim=True) + 1e-5) * self.weight


class Attention(nn.Module):
    """Heads of 64 channels; queries from x, keys and values from y, in windows of consecutive tokens where one is given."""

    def __init__(self, d, window=0, roll=False):
        super().__init__()
        self.heads, self.window, self.shift = d // 64, window, window // 2 if roll else 0
        self.packed_proj = nn.Linear(d, 3 * d)
        self.out_proj = nn.Linear(d, d)

    def forward(self, x, y=None):
        n, d = x.shape
        if self.shift:
            x = torch.roll(x, self.shift, 0)
        if y is None:
            q, k, v = self.packed_proj(x).split(d, -1)
        else:
            w, b = self.packed_proj.weight, self.packed_proj.bias
            q = F.linear(x, w[:d], b[:d])
            k, v = F.linear(y, w[d:], b[d:]).split(d, -1)
        span = self.window or n
        q = q.reshape(n // span, span, self.heads, 64).transpose(1, 2)
        k, v = (t.reshape(n // span, -1, self.heads, 64).transpose(1, 2) for t in (k, v))
        x = F.scaled_dot_product_attention(q, k, v).transpose(1, 2).reshape(n, d)
        x = self.out_proj(x)
        return torch.roll(x, -self.shift, 0) if self.shift else x


class FeedForward(nn.Module):
    def __init__(self, d):
        super().__init__()
        self.c_fc = nn.Linear(d, 4 * d, bias=False)
        self.c_proj = nn.Linear(4 * d, d, bias=False)

    def forward(self, x):
        return self.c_proj(F.silu(self.c_fc(x)))


class Block(nn.Module):
    def __init__(self, d, window=0, roll=False):
        super().__init__()
        self.layernorm1, self.attn = RMSNorm(d), Attention(d, window, roll)
        self.layernorm2, self.mlp = RMSNorm(d), FeedForward(d)

    def forward(self, x):
        x = x + self.attn(self.layernorm1(x)).to(x.dtype)
        return x + self.mlp(self.layernorm2(x)).to(x.dtype)


class Stack(nn.Module):
    def __init__(self, blocks):
        super().__init__()
        self.resblocks = nn.ModuleList(blocks)


class Encoder(nn.Module):
    """Tokens of the convolution [N, D] → embedding [N, D]."""

    def __init__(self, d, layers, code):
        super().__init__()
        self.register_buffer('position_code', code, persistent=False)
        self.layernorm1, self.layernorm2 = RMSNorm(d), RMSNorm(d)
        self.transformer = Stack([Block(d) for _ in range(layers)])

    def forward(self, x):
        x = self.layernorm1(x + self.position_code)
        for block in self.transformer.resblocks:
            x = block(x)
        return self.layernorm2(x)


class Rearrange(nn.Module):
    """A linear layer, then every token becomes 2×2 tokens: channel c·4 + 2·i + j goes to sub-token (2y + i, 2x + j)."""

    def __init__(self, d, d_out, grid):
        super().__init__()
        self.residual_fc = nn.Linear(d, 4 * d_out)
        self.grid, self.d_out = grid, d_out

    def forward(self, x):
        (h, w), k = self.grid, self.d_out
        x = self.residual_fc(x).reshape(h, w, k, 2, 2)
        return x.permute(0, 3, 1, 4, 2).reshape(4 * h * w, k)


class Upsampler(nn.Module):
    """Embedding [N, D] → tokens [16 N, D']."""

    def __init__(self, d, grid, window):
        super().__init__()
        for stage in range(2):
            d_out = max(d // 2, 64) // 64 * 64
            self.add_module(f'upsampler_{stage}', Rearrange(d, d_out, grid))
            self.add_module(f'attention_{stage}', Stack([Block(d_out, window, roll) for roll in (False, True)]))
            d, grid = d_out, (2 * grid[0], 2 * grid[1])
        self.layernorm2 = RMSNorm(d)

    def forward(self, x):
        for stage in range(2):
            x = getattr(self, f'upsampler_{stage}')(x).to(x.dtype)
            for block in getattr(self, f'attention_{stage}').resblocks:
                x = block(x)
        return self.layernorm2(x)


class PairBlock(nn.Module):
    def __init__(self, d):
        super().__init__()
        self.self_attn, self.self_attn_ln = Attention(d), RMSNorm(d)
        self.cross_attn, self.cross_attn_ln = Attention(d), RMSNorm(d)
        self.mlp, self.mlp_ln = FeedForward(d), RMSNorm(d)

    def forward(self, x, a, b):
        n = x.shape[0] // 2
        x = x + self.self_attn(self.self_attn_ln(x)).to(x.dtype)
        y = self.cross_attn_ln(x)
        x = x + torch.cat([self.cross_attn(y[:n], a), self.cross_attn(y[n:], b)]).to(x.dtype)
        return x + self.mlp(self.mlp_ln(x)).to(x.dtype)


class Decoder(nn.Module):
    """Embeddings of two frames [2N, D] and the condition of each [2, M, D] → [2N, D]."""

    def __init__(self, d, layers, tokens, condition, code):
        super().__init__()
        self.positional_embedding = nn.Parameter(torch.zeros(1, 2 * tokens, d))
        self.cls_embedding = nn.Parameter(torch.zeros(1, 2, d))
        self.condition_proj = nn.Linear(d, d, bias=False)
        self.condition_ln, self.layernorm1, self.layernorm2 = RMSNorm(d), RMSNorm(d), RMSNorm(d)
        self.transformer = Stack([PairBlock(d) for _ in range(layers)])
        self.register_buffer('position_code', code[:condition], persistent=False)

    def forward(self, h, condition):
        n = h.shape[0] // 2
        kind = torch.cat([self.cls_embedding[0, :1].expand(n, -1), self.cls_embedding[0, 1:].expand(n, -1)])
        x = self.layernorm1(h + self.positional_embedding[0] + kind)
        a, b = (self.condition_ln(self.condition_proj(condition[f]).to(h.dtype) + self.position_code) for f in (1, 0))
        for block in self.transformer.resblocks:
            x = block(x, a, b)
        return self.layernorm2(x)


def sinusoid(n, d):
    """pe[i, 2k] = sin(i·ω_k), pe[i, 2k+1] = cos(i·ω_k), ω_k = 10000^(−2k/D): frequency and angle rounded to float32, as published."""
    frequency = torch.exp(torch.arange(0, d, 2, dtype=torch.float32) * (-math.log(10000.0) / d))
    angle = torch.arange(n, dtype=torch.float32)[:, None] * frequency
    return torch.stack([angle.sin(), angle.cos()], -1).reshape(n, d)


def build(config, weights):
    """The three modules with the weights of a checkpoint in the official layout (without its prefix)."""
    d, (h, w) = config['hidden_dim'], config['resolution']
    grid = (h // 8, w // 8)
    n = grid[0] * grid[1]
    condition = 576 if config['use_dino'] else n
    parts = {
        'encoder': (Encoder(d, config['encoder_layers'], sinusoid(n, d)), 'gs_predictor.encoder.transformer_encoder.'),
        'upsampler': (Upsampler(d, grid, config['upsampler_window']), 'gs_predictor.gaussian_upsampler.'),
        'decoder': (Decoder(d, config['decoder_layers'], n, condition, sinusoid(condition, d)), 'decoder.transformer_decoder.'),
    }
    out = {}
    for name, (module, prefix) in parts.items():
        module.load_state_dict({k: torch.from_numpy(weights[prefix + k]) for k in module.state_dict()})
        out[name] = module.eval()
    return out
