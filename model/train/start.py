"""The analytic start: weights that already contain the part of the solution that is known before any training.

The encoder becomes an exact, linear window extractor. The position table leaves about 170 directions of the embedding free. These hold, one orthonormal axis
each, the patch's pixels: 64 luma values and 2 x 16 chroma cells, as cosine coefficients scaled to equal spread. They also hold the two nearest pixel rows or
columns of the four neighbouring patches, which the four heads of the encoder's attention fetch: the table is a sum of rotations, so a query rotated by one step
is a key of the neighbour. The upsampler unpacks them: each 4x4 sub-patch holds its 8x8 luma window, each Gaussian its 6x6 window, both whitened. Training then
learns a local non-linear function of a small window, shared by all Gaussians.
"""
import math

import torch
import torch.nn.functional as F

LUMA = torch.tensor([0.299, 0.587, 0.114])
SIDES = ('left', 'right', 'up', 'down')
N_LUMA, N_CHROMA, N_BORDER = 64, 32, 18               # per patch; a border is 2 x 8 luma pixels and 2 mean chromas
COORDINATES = ('col', 'row', 'p2', 'f2')


def dct(n):
    k, x = torch.arange(n)[:, None].double(), torch.arange(n)[None].double()
    m = torch.cos(math.pi * k * (2 * x + 1) / (2 * n)) * math.sqrt(2 / n)
    m[0] /= math.sqrt(2)
    return m


def colour_axes():
    """rgb -> (luma, two chromas); rows."""
    r, g, b = LUMA.double()
    return torch.stack([torch.stack([r, g, b]), 0.5 * torch.stack([-r, -g, 1 - b]) / (1 - b), 0.5 * torch.stack([1 - r, -g, -b]) / (1 - r)])


def patch_pixels():
    """Linear map from a patch's 192 values (channel, row, column) to 64 luma pixels and 2 x 16 chroma cell means."""
    c = colour_axes()
    luma = torch.einsum('c,pq->pcq', c[0], torch.eye(64, dtype=torch.float64)).reshape(64, 192)
    pool = torch.zeros(4, 4, 8, 8, dtype=torch.float64)
    for i in range(4):
        for j in range(4):
            pool[i, j, 2 * i:2 * i + 2, 2 * j:2 * j + 2] = 0.25
    pool = pool.reshape(16, 64)
    return torch.cat([luma, *[torch.einsum('c,pq->pcq', c[k], pool).reshape(16, 192) for k in (1, 2)]])


def border_of_patch():
    """For each side, the map from a patch's 96 values to the 18 values that its neighbour across that side reads.

    `left` is read by the right-hand neighbour: the patch's two last columns."""
    index = torch.arange(64).view(8, 8)
    strips = dict(left=index[:, 6:].T, right=index[:, :2].T, up=index[6:], down=index[:2])              # [2, 8], near or far line first
    cells = torch.arange(16).view(4, 4)
    edge = dict(left=cells[:, 3], right=cells[:, 0], up=cells[3], down=cells[0])
    out = {}
    for side in SIDES:
        m = torch.zeros(N_BORDER, N_LUMA + N_CHROMA, dtype=torch.float64)
        m[torch.arange(16), strips[side].flatten()] = 1
        for k in range(2):
            m[16 + k, 64 + 16 * k + edge[side]] = 0.25
        out[side] = m
    return out


def whiten(samples, floor):
    """Rows of samples -> (matrix to equal unit spread along principal axes, its inverse); spreads under `floor` are not amplified further."""
    mean = samples.mean(0)
    cov = (samples - mean).T @ (samples - mean) / len(samples)
    s, v = torch.linalg.eigh(cov)
    s, v = s.flip(0).clamp_min(0).sqrt().clamp_min(floor), v.flip(1)
    return mean, v.T / s[:, None], v * s


def window_maps():
    """(8x8 luma windows of the four sub-patches, from own luma + borders), and chroma 3x3 windows, as rows over the 168 raw values."""
    n = N_LUMA + N_CHROMA
    at = {s: n + N_BORDER * i for i, s in enumerate(SIDES)}

    def luma(y, x):
        """Row vector that reads luma pixel (y, x) of the patch, from -2 to 9."""
        v = torch.zeros(n + 4 * N_BORDER, dtype=torch.float64)
        inside = lambda a: 0 <= a < 8
        if inside(y) and inside(x):
            v[8 * y + x] = 1
        elif inside(y):
            v[(at['left'] + 8 * (x + 2) if x < 0 else at['right'] + 8 * (x - 8)) + y] = 1
        elif inside(x):
            v[(at['up'] + 8 * (y + 2) if y < 0 else at['down'] + 8 * (y - 8)) + x] = 1
        else:                                                            # a corner belongs to none of the four neighbours: the mean of its two sides
            v += 0.5 * luma(y, min(max(x, 0), 7)) + 0.5 * luma(min(max(y, 0), 7), x)
        return v

    def chroma(k, i, j):
        """Chroma cell (i, j), from -1 to 4; outside, the neighbour's mean."""
        v = torch.zeros(n + 4 * N_BORDER, dtype=torch.float64)
        if 0 <= i < 4 and 0 <= j < 4:
            v[64 + 16 * k + 4 * i + j] = 1
        elif 0 <= i < 4:
            v[at['left' if j < 0 else 'right'] + 16 + k] = 1
        elif 0 <= j < 4:
            v[at['up' if i < 0 else 'down'] + 16 + k] = 1
        else:
            v += 0.5 * chroma(k, i, min(max(j, 0), 3)) + 0.5 * chroma(k, min(max(i, 0), 3), j)
        return v

    sub_luma = torch.stack([torch.stack([luma(4 * i + a, 4 * j + b) for a in range(-2, 6) for b in range(-2, 6)]) for i in (0, 1) for j in (0, 1)])
    sub_chroma = torch.stack([torch.stack([chroma(k, 2 * i + a, 2 * j + b) for k in (0, 1) for a in range(-1, 3) for b in range(-1, 3)])
                              for i in (0, 1) for j in (0, 1)])
    return sub_luma, sub_chroma                                          # [4, 64, 168], [4, 32, 168]


def cell_maps():
    """From a sub-patch's 8x8 luma and 2 x 4x4 chroma windows to each of its four Gaussians' 6x6 and 2 x 3x3 windows."""
    index, cells = torch.arange(64).view(8, 8), torch.arange(32).view(2, 4, 4)
    luma = torch.stack([F.one_hot(index[2 * i:2 * i + 6, 2 * j:2 * j + 6].flatten(), 64) for i in (0, 1) for j in (0, 1)]).double()
    chroma = torch.stack([F.one_hot(cells[:, i:i + 3, j:j + 3].flatten(), 32) for i in (0, 1) for j in (0, 1)]).double()
    return luma, chroma                                                  # [4, 36, 64], [4, 18, 32]


def free_axes(pe, tolerance=1e-3):
    """(orthonormal directions the table does not touch, projector onto the others)."""
    _, s, vh = torch.linalg.svd(pe.double(), full_matrices=True)
    rank = int((s / s[0] > tolerance).sum())
    return vh[rank:], vh[:rank].T @ vh[:rank]


def raw_values(frames):
    """Frames [S,3,H,W] -> the 168 raw values of every patch [S,N,168] in float64, edges replicated; the target of the extraction."""
    maps, borders = patch_pixels(), border_of_patch()
    s, _, h, w = frames.shape
    own = F.unfold(frames.double(), 8, stride=8).transpose(1, 2) @ maps.T
    grid = own.view(s, h // 8, w // 8, -1)
    shift = dict(left=(0, -1), right=(0, 1), up=(-1, 0), down=(1, 0))
    parts = [own]
    for side in SIDES:
        dy, dx = shift[side]
        rows = (torch.arange(h // 8) + dy).clamp(0, h // 8 - 1)
        cols = (torch.arange(w // 8) + dx).clamp(0, w // 8 - 1)
        parts.append((grid[:, rows][:, :, cols] @ border_of_patch()[side].T).flatten(1, 2))
    return torch.cat(parts, -1)


@torch.no_grad()
def write_encoder(net, frames, amplitude=0.1, seed=1):
    """Fills the encoder; returns the read-outs (rows over the embedding) from which later parts are built."""
    c = net.config
    enc = net.gs_predictor.encoder.transformer_encoder
    d, (gh, gw) = c.hidden_dim, c.grid
    n = gh * gw
    pe = enc.positional_encoding.pe.double()
    axes, on_table = free_axes(pe)
    n_own, n_raw = N_LUMA + N_CHROMA, N_LUMA + N_CHROMA + 4 * N_BORDER
    assert len(axes) >= n_raw + len(COORDINATES), (len(axes), n_raw)
    named = {k: axes[n_raw + i] for i, k in enumerate(COORDINATES)}
    spare = axes[n_raw + len(COORDINATES):]
    raw = raw_values(frames)
    # own pixels: cosine coefficients, each scaled to the same spread
    basis = torch.block_diag(torch.kron(dct(8), dct(8)), *[torch.kron(dct(4), dct(4))] * 2)
    spread = (raw[..., :n_own] @ basis.T).flatten(0, 1).std(0).clamp_min(0.012)
    to_axes = amplitude * basis / spread[:, None]                                          # raw own -> coefficients
    enc.conv.weight.zero_()
    enc.conv.weight[:, :3] = (axes[:n_own].T @ to_axes @ patch_pixels()).view(d, 3, 8, 8).float()
    root = math.sqrt(0.5)                                                                  # rms of the position table
    for norm in (enc.layernorm1, enc.layernorm2):
        norm.weight.fill_(root)
    block = enc.transformer.resblocks[0]
    block.layernorm1.weight.fill_(root)
    block.layernorm2.weight.fill_(root)
    read_own = torch.linalg.inv(to_axes) @ axes[:n_own]                                    # embedding -> raw own
    # four heads, four neighbours
    freq = torch.exp(torch.arange(0, d, 2, dtype=torch.float64) * (-math.log(10000.0) / d))[:32]
    sharp = 5.5
    W, B, O = block.attn.packed_proj.weight, block.attn.packed_proj.bias, block.attn.out_proj.weight
    W.zero_(); B.zero_(); O.zero_(); block.attn.out_proj.bias.zero_()
    scale_border = {}
    for head, (side, step) in enumerate(zip(SIDES, (-1, 1, -gw, gw))):
        rows = slice(64 * head, 64 * head + 64)
        rotate = torch.zeros(64, d, dtype=torch.float64)
        for k in range(32):
            s, co = math.sin(step * freq[k]), math.cos(step * freq[k])
            rotate[2 * k, 2 * k], rotate[2 * k, 2 * k + 1] = co, s                         # sin(a + s) = sin a cos s + cos a sin s
            rotate[2 * k + 1, 2 * k], rotate[2 * k + 1, 2 * k + 1] = -s, co
        W[rows] = (sharp * rotate @ on_table).float()
        W[d + 64 * head:d + 64 * head + 64] = (sharp * torch.eye(64, d, dtype=torch.float64) @ on_table).float()
        pick = border_of_patch()[side]
        at = n_own + N_BORDER * head
        strip = torch.block_diag(torch.kron(torch.tensor([[1.0, 1.0], [1.0, -1.0]]).double() / math.sqrt(2), dct(8)), torch.eye(2, dtype=torch.float64))
        s = (raw[..., at:at + N_BORDER] @ strip.T).flatten(0, 1).std(0).clamp_min(0.012)
        coefficients = amplitude * strip / s[:, None]
        W[2 * d + 64 * head:2 * d + 64 * head + N_BORDER] = (coefficients @ pick @ read_own).float()
        O[:, 64 * head:64 * head + N_BORDER] = axes[at:at + N_BORDER].T.float()
        scale_border[side] = torch.linalg.inv(coefficients) @ axes[at:at + N_BORDER]
    read = torch.cat([read_own, *[scale_border[s] for s in SIDES]])                        # embedding -> 168 raw values, up to gain and offset
    # coordinates from the table, by random features; squared norm of the matching descriptor, from silu(x) + silu(-x) ~ x^2 / 2
    dsc = descriptor_map() @ read[:n_own]
    _fit_coordinates(net, frames, on_table, dsc, named, seed)
    h = net.encode(frames).double()
    flat, target = h.flatten(0, 1), raw.flatten(0, 1)
    inner = torch.zeros(gh, gw, dtype=torch.bool)
    inner[1:-1, 1:-1] = True
    use = inner.flatten().repeat(len(frames))
    # gains and offsets of the read-outs, measured where every neighbour exists; offsets ride on the table's constant direction
    one = torch.linalg.lstsq(pe, torch.ones(n, 1, dtype=torch.float64), driver='gelsd', rcond=1e-4).solution[:, 0]
    one = one / (flat @ one).mean()
    got = flat @ read.T
    g, t = got[use], target[use]
    gain = ((g - g.mean(0)) * (t - t.mean(0))).sum(0) / ((g - g.mean(0)) ** 2).sum(0)
    read = gain[:, None] * read
    read = read + (t.mean(0) - gain * g.mean(0))[:, None] * one
    error = ((flat @ read.T)[use] - t).pow(2).mean(0).sqrt()
    info = dict(free=len(axes), spare=len(spare), luma_rms=float(error[:64].mean()), chroma_rms=float(error[64:96].mean()), border_rms=float(error[96:].mean()))
    readers = dict(raw=read, one=one, spare=spare, named=named)
    cols, rows = torch.arange(n) % gw - (gw - 1) / 2, torch.arange(n) // gw - (gh - 1) / 2
    truth = dict(col=cols, row=rows, p2=cols ** 2 + rows ** 2)
    desc = (raw[..., :n_own] - grey()) @ descriptor_map().T
    for k in COORDINATES:
        v = flat @ named[k]
        t = desc.pow(2).sum(-1).flatten() if k == 'f2' else truth[k].double().repeat(len(frames))
        a = torch.stack([v, flat @ one], 1)
        sol = torch.linalg.lstsq(a, t[:, None]).solution[:, 0]
        readers[k] = sol[0] * named[k] + sol[1] * one
        info[k + '_rms'] = float((flat @ readers[k] - t).pow(2).mean().sqrt())
    readers['dsc'] = descriptor_map() @ read[:n_own] - (descriptor_map() @ grey())[:, None] * one
    return readers, info


def grey():
    return torch.cat([torch.full((64,), 0.5), torch.zeros(32)]).double()


def descriptor_map():
    """Raw own values -> 18 matching values: luma of the 16 cells, two mean chromas."""
    m = torch.zeros(18, N_LUMA + N_CHROMA, dtype=torch.float64)
    for i in range(4):
        for j in range(4):
            for a in (0, 1):
                for b in (0, 1):
                    m[4 * i + j, 8 * (2 * i + a) + 2 * j + b] = 0.25
    m[16, 64:80] = m[17, 80:96] = 1.5 * 4 / 16
    return m


def _fit_coordinates(net, frames, on_table, dsc, named, seed):
    c = net.config
    enc = net.gs_predictor.encoder.transformer_encoder
    block, (gh, gw) = enc.transformer.resblocks[0], c.grid
    n = gh * gw
    fc, proj = block.mlp.c_fc.weight, block.mlp.c_proj.weight
    pe = enc.positional_encoding.pe.double()
    gen = torch.Generator().manual_seed(seed)
    k0 = 2 * len(dsc)
    hidden = torch.randn(fc.shape[0] - k0, fc.shape[1], generator=gen, dtype=torch.float64) * 0.8 @ on_table
    one = torch.linalg.lstsq(pe, torch.ones(n, 1, dtype=torch.float64), driver='gelsd', rcond=1e-4).solution[:, 0]
    # silu(a x) + silu(-a x) ~ (a x)^2 / 2, so the descriptor is taken around mid grey; `a` raises it above the table's rounding
    a = 1.0
    centred = a * (dsc - (descriptor_map() @ grey())[:, None] * one)
    fc.copy_(torch.cat([centred, -centred, hidden]).float())
    cols, rows = torch.arange(n) % gw - (gw - 1) / 2, torch.arange(n) // gw - (gh - 1) / 2
    want = torch.stack([cols / 16, rows / 16, (cols ** 2 + rows ** 2) / 337], 1).double()
    X, Y = [], []
    for gain in (1.01, 1.0, 0.985, 0.97, 0.95):                                            # bright or busy patches shrink the table a little
        X.append(F.silu(gain * pe @ hidden.T)); Y.append(want)
    X, Y = torch.cat(X), torch.cat(Y)
    sol = torch.linalg.solve(X.T @ X + 1e-5 * len(X) * torch.eye(X.shape[1], dtype=torch.float64), X.T @ Y)
    proj.zero_()
    proj[:, k0:] = (sol @ torch.stack([named[k] for k in ('col', 'row', 'p2')])).T.float()
    proj[:, :k0] = 2.0 * named['f2'][:, None].float()


@torch.no_grad()
def write_static(net, readers, frames, spread=0.35, constant=6.0, sigma=0.6, opacity=0.95, seed=2):
    """Fills the static upsampler and head on top of the encoder's read-outs."""
    gen = torch.Generator().manual_seed(seed)
    up, head, c = net.gs_predictor.gaussian_upsampler, net.gs_predictor.predictor, net.config
    quiet(up, gen)
    raw = raw_values(frames)
    raw = raw[:, torch.arange(raw.shape[1]).view(c.grid)[1:-1, 1:-1].flatten()].flatten(0, 1)     # patches with all neighbours
    sub_luma, sub_chroma = window_maps()
    cell_luma, cell_chroma = cell_maps()
    lw = torch.cat([raw @ m.T for m in sub_luma]); cw = torch.cat([raw @ m.T for m in sub_chroma])
    (lm, lf, li), (cm, cf, ci) = whiten(lw, 0.01), whiten(cw, 0.01)
    gl = torch.cat([lw @ m.T for m in cell_luma]); gc = torch.cat([cw @ m.T for m in cell_chroma])
    (glm, glf, gli), (gcm, gcf, gci) = whiten(gl, 0.008), whiten(gc, 0.008)
    k_luma, k_chroma, k_cells = 64, 32, 18                                                        # channels
    fc0, fc1 = up.upsampler_0.residual_fc, up.upsampler_1.residual_fc
    fc0.weight.zero_(); fc0.bias.zero_(); fc1.weight.zero_(); fc1.bias.zero_()
    d0, d1 = fc0.weight.shape[0] // 4, fc1.weight.shape[0] // 4
    w0, b0, w1, b1 = (t.view(-1, 4, *t.shape[1:]) for t in (fc0.weight, fc0.bias, fc1.weight, fc1.bias))
    for s in range(4):
        w0[:k_luma, s] = (spread * lf @ sub_luma[s] @ readers['raw']).float()
        w0[k_luma:k_luma + k_chroma, s] = (spread * cf @ sub_chroma[s] @ readers['raw']).float()
        b0[:k_luma, s], b0[k_luma:k_luma + k_chroma, s] = -(spread * lf @ lm).float(), -(spread * cf @ cm).float()
        b0[d0 - 1, s] = constant * math.sqrt(2)
        to_luma, to_chroma = cell_luma[s] @ li / spread, cell_chroma[s] @ ci / spread               # channels of the sub-patch -> windows, means apart
        w1[:36, s, :k_luma] = (spread * glf @ to_luma).float()
        w1[36:36 + k_cells, s, k_luma:k_luma + k_chroma] = (spread * gcf @ to_chroma).float()
        b1[:36, s] = (spread * glf @ (cell_luma[s] @ lm - glm)).float()
        b1[36:36 + k_cells, s] = (spread * gcf @ (cell_chroma[s] @ cm - gcm)).float()
        b1[d1 - 1, s] = constant
    # norms before attention and MLP: bring whitened channels near one and the constant down to one
    for stage, last, const in ((0, d0 - 1, constant * math.sqrt(2)), (1, d1 - 1, constant)):
        rms = math.sqrt(const ** 2 / (last + 1) + spread ** 2 * 0.85)
        for block in getattr(up, f'attention_{stage}').resblocks:
            for norm in (block.layernorm1, block.layernorm2):
                norm.weight.fill_(rms / spread)
                norm.weight[last] = rms / const
    up.layernorm2.weight.fill_(rms / spread)
    up.layernorm2.weight[last] = rms / const
    # colours: linear from the token to the logit of the cell's mean
    token = up(net.encode(frames)).double()
    want = F.avg_pool2d(frames, 2).flatten(2).transpose(1, 2).double()
    used = torch.cat([token[..., :36 + k_cells], torch.ones_like(token[..., :1])], -1).flatten(0, 1)
    y = torch.logit(want.clamp(0.02, 0.98)).flatten(0, 1)
    sol = torch.linalg.solve(used.T @ used + 1e-4 * len(used) * torch.eye(used.shape[1], dtype=torch.float64), used.T @ y)
    L = head.gs_layer
    for layer in L.values():
        layer.weight.zero_(); layer.bias.zero_()
    L['rgb'].weight[:, :36 + k_cells] = sol[:-1].T.float()
    L['rgb'].bias.copy_(sol[-1].float())
    softplus_inverse = lambda v: math.log(math.expm1(10 * v))
    h2, w2 = c.splat_grid
    L['scale'].bias.copy_(torch.tensor([softplus_inverse(sigma * 2 / w2), softplus_inverse(sigma * 2 / h2)]))
    L['opacity'].bias.fill_(math.log((opacity - 0.05) / (1 - opacity)))
    return dict(rgb_logit_rms=float((used @ sol - y).pow(2).mean().sqrt()), constant_rms=float(token[..., last].std()))


@torch.no_grad()
def quiet(module, gen):
    """Random input weights as usual, output weights of zero: every residual branch starts at zero."""
    for name, p in module.named_parameters():
        if p.dim() < 2:
            p.fill_(1.0 if name.endswith('weight') else 0.0)
        elif 'out_proj' in name or 'c_proj' in name:
            p.zero_()
        else:
            bound = math.sqrt(6 / (p.shape[0] / (4 if 'residual_fc' in name else 3 if 'packed_proj' in name else 1) + p.shape[1]))
            p.copy_((torch.rand(p.shape, generator=gen) * 2 - 1) * bound)


N_MATCH = 33                                                             # fetched content: 27 luma and 2 x 3 chroma cosine coefficients
UNIT, SMOOTH_UNIT = 16.0, 2.0                                             # tokens per unit on the raw and the smoothed motion axes
MOTION = ('mx', 'my', 'nx', 'ny', 'sx', 'sy')
DIFFERENCE = 6.0                                                          # per unit of luma, on the deformation token
FADE = ((5.0, 0.2), (8.0, 0.98))                                          # of the first frame, which is in front, and of the second


def content_rows(readers, frames, net):
    """(rows that read 33 whitened low coefficients of a patch from h, their spreads), free of the table's constant direction."""
    order = sorted(((u, v) for u in range(8) for v in range(8)), key=lambda q: (q[0] + q[1], q[0]))[:27]
    low = [8 * u + v for u, v in order]
    basis = torch.block_diag(torch.kron(dct(8), dct(8)), *[torch.kron(dct(4), dct(4))] * 2)
    pick = low + [64, 65, 68] + [80, 81, 84]
    rows = basis[pick] @ readers['raw'][:96]
    spread = (net.encode(frames).double().flatten(0, 1) @ rows.T).std(0)
    return rows / spread[:, None], spread


def cell_differences(spread):
    """From the difference of two patches' 33 whitened coefficients to that of their 16 luma cells (2x2 pixels, rows first) and two mean chromas [18, 33]."""
    order = sorted(((u, v) for u in range(8) for v in range(8)), key=lambda q: (q[0] + q[1], q[0]))[:27]
    mean = dct(8).view(8, 4, 2).mean(-1)                                 # cosine u averaged over cell i
    m = torch.zeros(18, N_MATCH, dtype=torch.float64)
    for k, (u, v) in enumerate(order):
        m[:16, k] = torch.outer(mean[u], mean[v]).flatten()
    m[16, 27] = m[17, 30] = 0.25                                          # 4x4 cells: the constant cosine's coefficient is four times the mean
    return m * spread


@torch.no_grad()
def write_decoder(net, readers, frames, beta=(12.0, 40.0), gamma=(0.15, 0.25), smooth=(3.0, 0.08), amplitude=0.3, seed=3):
    """A soft-argmax matcher in the first block, a bilateral mean of its motion in the second.

    Cross-attention heads 0 and 1 score -beta |f_q - f_k|^2 - gamma |p_q - p_k|^2 over the other frame and return the position of the match. Self-attention does
    the same inside its own frame and is subtracted, so that no change means exactly no motion. Heads 2 and 3 fetch the other frame's content at the same place
    and at the match, from which the MLP refines the motion."""
    c, gen = net.config, torch.Generator().manual_seed(seed)
    dec, d = net.decoder.transformer_decoder, c.hidden_dim
    n = c.grid[0] * c.grid[1]
    for block in dec.transformer.resblocks:
        quiet(block, gen)
    pe = net.gs_predictor.encoder.transformer_encoder.positional_encoding.pe.double()
    _, s, vh = torch.linalg.svd(pe, full_matrices=True)
    axes, _ = free_axes(pe)
    rank = d - len(axes)
    flag = vh[rank - 1]                                                  # the faintest direction the table uses
    on_table = vh[:rank - 1].T @ vh[:rank - 1]
    on_free = axes.T @ axes
    n_own = N_LUMA + N_CHROMA
    border = axes[n_own:n_own + 4 * N_BORDER]
    motion = {k: border[i] for i, k in enumerate(MOTION)}
    other, matched = border[6:6 + N_MATCH], border[6 + N_MATCH:6 + 2 * N_MATCH]
    clean = lambda u: u - (u @ flag)[..., None] * flag if u.dim() > 1 else u - (u @ flag) * flag
    U = {k: clean(readers[k]) for k in ('col', 'row', 'p2', 'f2', 'dsc', 'one')}
    content, spread = content_rows(readers, frames, net)
    content = clean(content)
    # streams: the condition carries the table twice and the content `louder` times
    louder = 4.0
    dec.condition_proj.weight.copy_((torch.eye(d, dtype=torch.float64) + (louder - 1) * on_free).float())
    dec.cls_embedding.zero_(); dec.positional_embedding.zero_()
    dec.cls_embedding[0, 0], dec.cls_embedding[0, 1] = flag.float(), -flag.float()
    root = math.sqrt(0.5)
    for norm in (dec.condition_ln, dec.layernorm1, dec.layernorm2):
        norm.weight.fill_(root)
    h = net.encode(frames)
    condition = dec.condition_ln(dec.condition_proj(h) + dec.positional_encoding.pe[:n]).double()
    query = dec.layernorm1(h + flag.float()).double()
    cols = (torch.arange(n) % c.grid[1] - (c.grid[1] - 1) / 2).double().expand(len(frames), n)
    regress = lambda a: float((a * cols).sum() / (a * a).sum())
    split = lambda u: (u @ on_free, u - u @ on_free)
    in_condition = lambda u: (lambda f, t: f / louder + t / 2)(*split(u))
    kc = regress(condition @ in_condition(U['col']))
    C = {k: kc * in_condition(u) for k, u in U.items()}
    Cc = kc * in_condition(content)
    b0, b1 = dec.transformer.resblocks[:2]
    for b in (b0, b1):
        for norm in (b.self_attn_ln, b.cross_attn_ln):
            norm.weight.fill_(root)
        b.mlp_ln.weight.fill_(1.0)
    kx = regress(b0.self_attn_ln(query.float()).double() @ U['col'])
    X = {k: kx * u for k, u in U.items()}
    Xc = kx * content
    sc = math.sqrt(8.0)

    def match(W, B, at_q, at_k, Q, K, be, ga, f=0.0):
        """Rows so that q.k/8 = -be |f_q - f_k|^2 - ga |p_q - p_k|^2 up to a constant of the query; `f` prefers the own frame."""
        i = 0
        for j in range(len(Q['dsc'])):
            W[at_q + i], W[at_k + i] = (sc * math.sqrt(2 * be) * Q['dsc'][j]).float(), (sc * math.sqrt(2 * be) * K['dsc'][j]).float(); i += 1
        B[at_q + i] = sc; W[at_k + i] = (-sc * be * K['f2']).float(); i += 1
        for k in ('col', 'row'):
            W[at_q + i], W[at_k + i] = (sc * math.sqrt(2 * ga) * Q[k]).float(), (sc * math.sqrt(2 * ga) * K[k]).float(); i += 1
        B[at_q + i] = sc; W[at_k + i] = (-sc * ga * K['p2']).float(); i += 1
        if f:
            W[at_q + i] = W[at_k + i] = (sc * f * flag).float(); i += 1
        return i

    def same_place(W, at_q, at_k, double, own_frame):
        """The table against itself: the token of the same index."""
        top = 31 if own_frame else 32
        rows = 5.5 * torch.eye(64, d, dtype=torch.float64)[:2 * top] @ on_table
        W[at_q:at_q + 2 * top] = rows.float()
        W[at_k:at_k + 2 * top] = (rows / (2 if double else 1)).float()
        if own_frame:
            W[at_q + 62] = W[at_k + 62] = (sc * 5.0 * flag).float()
            W[at_q + 63] = W[at_k + 63] = 0

    # --- block 0 ---------------------------------------------------------------------------------------------------
    W, B, O = b0.cross_attn.packed_proj.weight, b0.cross_attn.packed_proj.bias, b0.cross_attn.out_proj.weight
    Ws, Bs, Os = b0.self_attn.packed_proj.weight, b0.self_attn.packed_proj.bias, b0.self_attn.out_proj.weight
    for t in (W, B, O, Ws, Bs, Os):
        t.zero_()
    for head in (0, 1):
        q, k, v = 64 * head, d + 64 * head, 2 * d + 64 * head
        match(W, B, q, k, X, C, beta[head], gamma[head])
        match(Ws, Bs, q, k, X, X, beta[head], gamma[head], 3.0)
        for j, name in enumerate(('col', 'row')):
            W[v + j], Ws[v + j] = C[name].float(), X[name].float()
            a = motion[MOTION[2 * head + j]] / UNIT
            O[:, 64 * head + j], Os[:, 64 * head + j] = a.float(), -a.float()
    for head, onto in ((2, other), (3, matched)):
        q, k, v = 64 * head, d + 64 * head, 2 * d + 64 * head
        if head == 2:
            same_place(W, q, k, True, False)
        else:
            match(W, B, q, k, X, C, 3 * beta[1], gamma[1])
        W[v:v + N_MATCH] = Cc.float()
        O[:, 64 * head:64 * head + N_MATCH] = (amplitude * onto).T.float()
    for head in (2, 3):
        same_place(Ws, 64 * head, d + 64 * head, False, True)
    v = 2 * d + 128
    Ws[v:v + 64], Os[:, 128:192] = (kx * border[:64]).float(), -border[:64].T.float()              # replaces the content of the borders
    v = 2 * d + 192
    Ws[v:v + 8], Os[:, 192:200] = (kx * border[64:]).float(), -border[64:].T.float()
    # MLP: random features of the three contents and the motion
    rows = torch.cat([content, other / amplitude, matched / amplitude])
    gains = torch.randn(b0.mlp.c_fc.weight.shape[0], len(rows), generator=gen, dtype=torch.float64) * 0.16
    tie = torch.randn(gains.shape[0], N_MATCH, generator=gen, dtype=torch.float64) * 0.2                    # most units look at a difference
    half = gains.shape[0] // 2
    gains[:half, :N_MATCH] += tie[:half]; gains[:half, N_MATCH:2 * N_MATCH] -= tie[:half]
    gains[half:, :N_MATCH] += tie[half:]; gains[half:, 2 * N_MATCH:] -= tie[half:]
    m = torch.stack([motion[k] for k in MOTION[:4]])
    first = gains @ rows + torch.randn(gains.shape[0], 4, generator=gen, dtype=torch.float64) * 4 @ m
    first += torch.randn(gains.shape[0], 1, generator=gen, dtype=torch.float64) * 0.5 * U['one'] + torch.randn(gains.shape[0], 1, generator=gen, dtype=torch.float64) * 0.3 * flag
    b0.mlp.c_fc.weight.copy_((kx * first).float())
    # --- block 1: a bilateral mean of the motion of both frames ------------------------------------------------------
    W1, B1, O1 = b1.self_attn.packed_proj.weight, b1.self_attn.packed_proj.bias, b1.self_attn.out_proj.weight
    W1[:128], W1[d:d + 128], W1[2 * d:2 * d + 128] = 0, 0, 0
    mean = lambda a, b: UNIT * kx * 0.5 * (motion[a] + motion[b])
    for head, sign in ((0, 1.0), (1, -1.0)):
        q, k, v = 64 * head, d + 64 * head, 2 * d + 64 * head
        used = match(W1, B1, q, k, X, X, *smooth)
        B1[q + used] = 8 * sc; W1[k + used] = (sc * sign * flag).float()
        W1[v], W1[v + 1] = mean('mx', 'nx').float(), mean('my', 'ny').float()
        O1[:, 64 * head], O1[:, 64 * head + 1] = (sign * 0.5 * motion['sx'] / SMOOTH_UNIT).float(), (sign * 0.5 * motion['sy'] / SMOOTH_UNIT).float()
    out = net.decoder.transformer_decoder(h.repeat_interleave(2, 0))
    ko = float((out.double() @ U['col'] * cols.repeat_interleave(2, 0)).sum() / (out.double() @ U['col']).pow(2).sum())
    readers.update(flag=flag, motion=motion, content=content, content_spread=spread, other=other, matched=matched, amplitude=amplitude, decoder_gain=ko)
    return dict(condition_gain=kc, query_gain=kx, decoder_gain=ko)


def block0_stream(net, h):
    """The decoder's stream just before the MLP of its first block, for the layer-wise pretraining of that MLP."""
    dec = net.decoder.transformer_decoder
    b2, n, d = h.shape
    other = h.unflatten(0, (-1, 2)).flip(1).flatten(0, 1)
    condition = dec.condition_ln(dec.condition_proj(other) + dec.positional_encoding.pe[:n])
    x = dec.layernorm1(h.reshape(b2 // 2, 2 * n, d) + dec.positional_embedding + dec.cls_embedding.repeat_interleave(n, 1))
    block = dec.transformer.resblocks[0]
    x = (x + block.self_attn(block.self_attn_ln(x))).reshape(b2, n, d)
    return x + block.cross_attn(block.cross_attn_ln(x), condition)


@torch.no_grad()
def write_motion(net, readers, frames, seed=4):
    """Deformation upsampler and heads: the smoothed motion becomes the velocity; the first frame is in front (equal depths, order of storage) and fades."""
    gen = torch.Generator().manual_seed(seed)
    c, up = net.config, net.gaussian_upsampler
    quiet(up, gen)
    d_out = up.d_out
    fc0, fc1 = up.upsampler_0.residual_fc, up.upsampler_1.residual_fc
    w0, b0, w1, b1 = (t.view(-1, 4, *t.shape[1:]) for t in (fc0.weight, fc0.bias, fc1.weight, fc1.bias))
    d0, d1 = b0.shape[0], b1.shape[0]
    ko, flag, motion = readers['decoder_gain'], readers['flag'], readers['motion']
    A = readers['amplitude']
    base = [ko * SMOOTH_UNIT * motion['sx'] / 2, ko * SMOOTH_UNIT * motion['sy'] / 2, ko * flag]
    base += [ko * UNIT * motion[k] / 2 for k in MOTION[:4]]
    to_cells = cell_differences(readers['content_spread'])
    same, match = (DIFFERENCE * ko * to_cells @ (readers['content'] - readers[k] / A) for k in ('other', 'matched'))
    base += [same[16], same[17], match[16], match[17]]
    k = len(base)
    w0[:] *= 0.1; b0.zero_(); w1[:] *= 0.3; b1.zero_()
    w0[:k] = torch.stack(base).float()[:, None]
    w1[:k + 18] = 0
    for j in range(k):
        w1[j, :, j] = 1
    # differences to the other frame, at the same place and at the match: 4x4 cells around each sub-patch, then 3x3 around each Gaussian
    for s in range(4):
        for a in range(4):
            for b in range(4):
                cell = 4 * min(max(2 * (s // 2) + a - 1, 0), 3) + min(max(2 * (s % 2) + b - 1, 0), 3)
                w0[k + 4 * a + b, s], w0[k + 16 + 4 * a + b, s] = same[cell].float(), match[cell].float()
        for a in range(3):
            for b in range(3):
                for half in (0, 1):
                    w1[k + 9 * half + 3 * a + b, s, k + 16 * half + 4 * (s // 2 + a) + s % 2 + b] = 1
    w0[d0 - 1] = 0; b0[d0 - 1] = 6 * math.sqrt(2)
    w1[d1 - 1] = 0; b1[d1 - 1] = 6
    for s in range(4):                                                     # index of the sub-cell, in spare channels
        b1[k + 18:k + 20, s] = torch.tensor([0.3 if s & 1 else -0.3, 0.3 if s & 2 else -0.3])
    for stage, n, const in ((0, d0, 6 * math.sqrt(2)), (1, d1, 6.0)):
        rms = math.sqrt(const ** 2 / n + 0.1)
        for block in getattr(up, f'attention_{stage}').resblocks:
            for norm in (block.layernorm1, block.layernorm2):
                norm.weight.fill_(2 * rms); norm.weight[n - 1] = rms / const
    up.layernorm2.weight.fill_(rms); up.layernorm2.weight[d1 - 1] = rms / const
    net.encoder_proj.weight.copy_(0.5 * torch.eye(d_out))
    head = net.gs_dynamic_predictor
    head.gs_layer['xyz_dynamic_scale'].weight.fill_(0)
    h = net.encode(frames[:8])
    token = up(net.decoder.transformer_decoder(h))
    signs = torch.tensor([1.0, -1.0]).repeat(len(h) // 2)[:, None]
    kf = 1 / float((token[..., 2] * signs).mean())
    km = float((token[..., d1 - 1]).mean())
    for layers in (head.gs_layer['xyz_dynamic'].layers, head.gs_layer['opacity_dynamic'].layers):
        for i in ('1', '4'):
            bound = math.sqrt(3 / layers[i].weight.shape[1])
            layers[i].weight.copy_((torch.rand(layers[i].weight.shape, generator=gen) * 2 - 1) * bound); layers[i].bias.zero_()
        layers['7'].weight.zero_(); layers['7'].bias.zero_()
    L = head.gs_layer['xyz_dynamic'].layers
    E = torch.eye(2 * d_out)
    G = head.gs_layer['opacity_dynamic'].layers

    def pass_through(layers, unit, channel, gain):
        """silu(a) - silu(-a) = a: hidden units `unit` and `unit` + 1 of both layers carry a channel of the deformation token."""
        layers['1'].weight[unit], layers['1'].weight[unit + 1] = gain * E[d_out + channel], -gain * E[d_out + channel]
        layers['4'].weight[unit:unit + 2] = 0
        layers['4'].weight[unit, unit], layers['4'].weight[unit, unit + 1] = 1, -1
        layers['4'].weight[unit + 1, unit], layers['4'].weight[unit + 1, unit + 1] = -1, 1

    for j in (0, 1):
        pass_through(L, 2 * j, j, 2.0)
    pass_through(G, 0, 2, kf)
    p = c.patch_size
    gx, gz = 2 * p / c.resolution[1] / 0.5, -2 * p / c.resolution[0] / 0.5
    L['7'].weight[0, 0], L['7'].weight[0, 1] = gx, -gx
    L['7'].weight[2, 2], L['7'].weight[2, 3] = gz, -gz
    fades = torch.tensor([[sharpness, math.log(half / (1 - half))] for sharpness, half in FADE])          # by the frame's flag, +1 and -1
    G['7'].bias.copy_(fades.mean(0))
    G['7'].weight[:, 0], G['7'].weight[:, 1] = (fades[0] - fades[1]) / 2, (fades[1] - fades[0]) / 2
    return dict(flag_gain=kf, constant=km)
