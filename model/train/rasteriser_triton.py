"""The rasteriser of rasteriser.py as Triton kernels: the engine's rules, a list of splats per tile, the same sums in the same order in every run.

Runs on CUDA; with TRITON_INTERPRET=1 in the environment also on CPU tensors, slowly. This is for tests without a GPU.
"""
import torch
import triton
import triton.language as tl

TILE = 16
SPLATS = 64                                # per program of the last kernel
WARPS = 1                                  # per program of the others
SUMS = 9                                   # per splat and tile: u, v, var_x, var_y, opacity, r, g, b, depth


def tile_lists(P, key, H, W):
    """Splats of each tile, in depth order.

    Returns (entries, slots, starts, first, count): `entries[starts[k] : starts[k + 1]]` are the splats (row of the flattened [M N])
    of tile k = (m · tile rows + row) · tile columns + column, front to back; `slots` numbers the same pairs by splat, those of splat s
    being `first[s] … first[s] + count[s] - 1`."""
    M, N = key.shape
    columns, rows = -(-W // TILE), -(-H // TILE)
    u, v, var_x, var_y, opacity = P.unbind(-1)
    reach = 2 * torch.log(opacity.clamp_min(1 / 255) * 255) + 1e-4
    bounds = []
    for centre, var, size in ((u, var_x, W), (v, var_y, H)):
        r = torch.sqrt(reach * var)
        bounds.append((torch.floor(centre - r).clamp(0, size), torch.ceil(centre + r).clamp(-1, size - 1)))
    (x0, x1), (y0, y1) = [(a.long(), b.long()) for a, b in bounds]
    seen = (opacity >= 1 / 255) & (x0 <= x1) & (y0 <= y1)
    x0, x1, y0, y1 = x0 // TILE, x1 // TILE, y0 // TILE, y1 // TILE
    wide = torch.where(seen, x1 - x0 + 1, torch.zeros_like(x0))
    count = wide * torch.where(seen, y1 - y0 + 1, torch.zeros_like(y0))
    order = torch.argsort(key, dim=1, stable=True) + torch.arange(M, device=key.device)[:, None] * N
    order = order.flatten()
    ranked = count.flatten()[order]
    before = torch.cumsum(ranked, 0) - ranked
    splat = torch.repeat_interleave(order, ranked)
    step = torch.arange(len(splat), device=key.device) - torch.repeat_interleave(before, ranked)
    flat = lambda t: t.flatten()[splat]
    tile = (splat // N * rows + flat(y0) + step // flat(wide)) * columns + flat(x0) + step % flat(wide)
    slots = torch.argsort(tile, stable=True)
    starts = torch.zeros(M * rows * columns + 1, dtype=torch.long, device=key.device)
    starts[1:] = torch.cumsum(torch.bincount(tile, minlength=M * rows * columns), 0)
    first = torch.empty_like(before)
    first[order] = before
    return splat[slots].int(), slots.int(), starts.int(), first.int(), count.flatten().int()


@triton.jit
def _alpha(P, s, x, y):
    u, v = tl.load(P + 5 * s), tl.load(P + 5 * s + 1)
    var_x, var_y, opacity = tl.load(P + 5 * s + 2), tl.load(P + 5 * s + 3), tl.load(P + 5 * s + 4)
    dx, dy = u - x, v - y
    raw = (opacity * tl.exp(-0.5 * dy * dy / var_y)) * tl.exp(-0.5 * dx * dx / var_x)
    return raw, tl.minimum(raw, 0.99), dx, dy


@triton.jit
def _place(H, W, columns, rows, TILE: tl.constexpr):
    k = tl.program_id(0)
    m, row, column = k // (rows * columns), k // columns % rows, k % columns
    y = row * TILE + tl.arange(0, TILE)[:, None]
    x = column * TILE + tl.arange(0, TILE)[None, :]
    return k, m, x, y, (y < H) & (x < W)


@triton.jit
def _forward(P, V, background, entries, starts, image, T_end, last, H, W, columns, rows, TILE: tl.constexpr):
    k, m, x, y, inside = _place(H, W, columns, rows, TILE)
    T = tl.full([TILE, TILE], 1.0, tl.float32)
    c0, c1, c2, c3 = T * 0, T * 0, T * 0, T * 0
    end = tl.full([TILE, TILE], 2147483647, tl.int32)
    for e in range(tl.load(starts + k), tl.load(starts + k + 1)):
        s = tl.load(entries + e)
        raw, a, dx, dy = _alpha(P, s, x, y)
        after = T * (1 - a)
        hit = (a >= 1 / 255) & (end == 2147483647)
        stop = hit & (after < 1e-4)
        use = hit & (after >= 1e-4)
        w = tl.where(use, a * T, 0.0)
        c0 += w * tl.load(V + 4 * s)
        c1 += w * tl.load(V + 4 * s + 1)
        c2 += w * tl.load(V + 4 * s + 2)
        c3 += w * tl.load(V + 4 * s + 3)
        T = tl.where(use, after, T)
        end = tl.where(stop, e, end)
    at = m * H * W + y * W + x
    tl.store(T_end + at, T, inside)
    tl.store(last + at, end, inside)
    at = m * 4 * H * W + y * W + x
    tl.store(image + at, c0 + T * tl.load(background + 4 * m), inside)
    tl.store(image + at + H * W, c1 + T * tl.load(background + 4 * m + 1), inside)
    tl.store(image + at + 2 * H * W, c2 + T * tl.load(background + 4 * m + 2), inside)
    tl.store(image + at + 3 * H * W, c3 + T * tl.load(background + 4 * m + 3), inside)


@triton.jit
def _backward(P, V, background, entries, slots, starts, T_end, last, G, sums, H, W, columns, rows, TILE: tl.constexpr, GEOMETRY: tl.constexpr):
    k, m, x, y, inside = _place(H, W, columns, rows, TILE)
    at = m * H * W + y * W + x
    T = tl.load(T_end + at, inside, 1.0)
    end = tl.load(last + at, inside, 0)
    at = m * 4 * H * W + y * W + x
    g0, g1 = tl.load(G + at, inside, 0.0), tl.load(G + at + H * W, inside, 0.0)
    g2, g3 = tl.load(G + at + 2 * H * W, inside, 0.0), tl.load(G + at + 3 * H * W, inside, 0.0)
    b0, b1 = T * 0 + tl.load(background + 4 * m), T * 0 + tl.load(background + 4 * m + 1)
    b2, b3 = T * 0 + tl.load(background + 4 * m + 2), T * 0 + tl.load(background + 4 * m + 3)
    first, stop = tl.load(starts + k), tl.load(starts + k + 1)
    for i in range(0, stop - first):
        e = stop - 1 - i
        s = tl.load(entries + e)
        raw, a, dx, dy = _alpha(P, s, x, y)
        use = (a >= 1 / 255) & (e < end) & inside
        T = tl.where(use, T / (1 - a), T)
        w = tl.where(use, a * T, 0.0)
        out = sums + 9 * tl.load(slots + e)
        tl.store(out + 5, tl.sum(w * g0))
        tl.store(out + 6, tl.sum(w * g1))
        tl.store(out + 7, tl.sum(w * g2))
        tl.store(out + 8, tl.sum(w * g3))
        if GEOMETRY:
            f0, f1, f2, f3 = tl.load(V + 4 * s), tl.load(V + 4 * s + 1), tl.load(V + 4 * s + 2), tl.load(V + 4 * s + 3)
            behind = (f0 - b0) * g0 + (f1 - b1) * g1 + (f2 - b2) * g2 + (f3 - b3) * g3
            q = tl.where(use & (raw <= 0.99), T * behind * raw, 0.0)
            tl.store(out, tl.sum(q * dx))
            tl.store(out + 1, tl.sum(q * dy))
            tl.store(out + 2, tl.sum(q * dx * dx))
            tl.store(out + 3, tl.sum(q * dy * dy))
            tl.store(out + 4, tl.sum(q))
            b0 = tl.where(use, a * f0 + (1 - a) * b0, b0)
            b1 = tl.where(use, a * f1 + (1 - a) * b1, b1)
            b2 = tl.where(use, a * f2 + (1 - a) * b2, b2)
            b3 = tl.where(use, a * f3 + (1 - a) * b3, b3)


@triton.jit
def _gather(P, first, count, sums, gP, gV, total, most, SPLATS: tl.constexpr, GEOMETRY: tl.constexpr):
    """Adds up the tiles' sums of each splat, always in the same order."""
    s = tl.program_id(0) * SPLATS + tl.arange(0, SPLATS)
    real = s < total
    at, n = tl.load(first + s, real, 0), tl.load(count + s, real, 0)
    zero = tl.zeros([SPLATS], tl.float32)
    x, y, xx, yy, o = zero, zero, zero, zero, zero
    h0, h1, h2, h3 = zero, zero, zero, zero
    for i in range(0, most):
        more = i < n
        p = sums + 9 * (at + i)
        if GEOMETRY:
            x += tl.load(p, more, 0.0)
            y += tl.load(p + 1, more, 0.0)
            xx += tl.load(p + 2, more, 0.0)
            yy += tl.load(p + 3, more, 0.0)
            o += tl.load(p + 4, more, 0.0)
        h0 += tl.load(p + 5, more, 0.0)
        h1 += tl.load(p + 6, more, 0.0)
        h2 += tl.load(p + 7, more, 0.0)
        h3 += tl.load(p + 8, more, 0.0)
    if GEOMETRY:
        var_x, var_y = tl.load(P + 5 * s + 2, real, 1.0), tl.load(P + 5 * s + 3, real, 1.0)
        opacity = tl.load(P + 5 * s + 4, real, 1.0)
        tl.store(gP + 5 * s, -x / var_x, real)
        tl.store(gP + 5 * s + 1, -y / var_y, real)
        tl.store(gP + 5 * s + 2, 0.5 * xx / (var_x * var_x), real)
        tl.store(gP + 5 * s + 3, 0.5 * yy / (var_y * var_y), real)
        tl.store(gP + 5 * s + 4, tl.where(n > 0, o / tl.where(n > 0, opacity, 1.0), 0.0), real)
    tl.store(gV + 4 * s, h0, real)
    tl.store(gV + 4 * s + 1, h1, real)
    tl.store(gV + 4 * s + 2, h2, real)
    tl.store(gV + 4 * s + 3, h3, real)


class SplatTriton(torch.autograd.Function):
    """As rasteriser.Splat."""

    @staticmethod
    def paint(P, values, key, background, H, W, lists=None):
        """(image, T, last, lists), without gradients; `lists` of an earlier call with the same P and key are reused."""
        M, columns, rows = len(key), -(-W // TILE), -(-H // TILE)
        if lists is None:
            lists = tile_lists(P, key, H, W)
            lists = (*lists, int(lists[-1].max()) if lists[-1].numel() else 0)
        image, T = P.new_empty(M, 4, H, W), P.new_empty(M, H, W)
        last = torch.empty(M, H, W, dtype=torch.int32, device=P.device)
        _forward[(M * rows * columns,)](P, values, background, lists[0], lists[2], image, T, last, H, W, columns, rows, TILE, num_warps=WARPS)
        return image, T, last, lists

    @staticmethod
    def pull(P, values, background, T, last, lists, G, geometry=True):
        """The gradients (of P, of values) under G [M,4,H,W]; without `geometry` the first is not computed."""
        entries, slots, starts, first, count, most = lists
        (M, N), (H, W) = P.shape[:2], T.shape[1:]
        columns, rows = -(-W // TILE), -(-H // TILE)
        sums = P.new_empty(len(entries), SUMS)
        gP, gV = torch.empty_like(P), torch.empty_like(values)
        _backward[(M * rows * columns,)](P, values, background, entries, slots, starts, T, last, G.contiguous().float(), sums, H, W, columns, rows, TILE, geometry,
                                         num_warps=WARPS)
        _gather[(-(-M * N // SPLATS),)](P, first, count, sums, gP, gV, M * N, most, SPLATS, geometry)
        return gP, gV

    @staticmethod
    def forward(ctx, P, values, key, background, H, W):
        P, values, key, background = (t.detach().contiguous().float() for t in (P, values, key, background))
        image, T, last, (*lists, ctx.most) = SplatTriton.paint(P, values, key, background, H, W)
        ctx.save_for_backward(P, values, background, T, last, *lists)
        ctx.mark_non_differentiable(T)
        return image, T

    @staticmethod
    def backward(ctx, G, _):
        P, values, background, T, last, *lists = ctx.saved_tensors
        return *SplatTriton.pull(P, values, background, T, last, (*lists, ctx.most), G), None, None, None, None
