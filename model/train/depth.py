"""Depth: measurements on procedural scenes, and changes to checkpoints whose depths are not all equal.

`y` is normalised inverse depth, larger is nearer. A rendering returns the mean distance at a pixel; one over it is the pixel's nearness. Where only one depth
is visible, nearness is an increasing affine function of `y`.
"""
import cv2
import numpy as np
import torch
import torch.nn.functional as F

from . import data
from .losses import psnr
from .rasteriser import at_times, render, render_pair, render_static, render_turned

VALIDATION = 1 << 30       # seed of the measured scenes; training draws its samples from (seed, step, place in the batch)
EQUAL = 1e-3               # two pixels are equally near when their nearness differs by less than this share
STEP = 0.05                # of the argument of y's tanh in training: from one Gaussian of a patch to the next
UNEVEN = 0.3               # weight of `uneven` against `misplaced` in `lean_loss`
STANDS = 0.5               # of the same argument: target of foreground and background in front of and behind the middle
RELIEF = 0.3               # factor on all of this when the stage ends: order is the same at any scale
APART = 0.15               # of the inverse-depth range: distance of the second frame behind the first, 20 of the remaining steps
MARGIN = 0.1               # least margin of a token's frame flag, -1 or 1: below it the gate of `come_forward` would not close


def nearness(image, transmittance):
    """[.., H, W] of a rendering [.., 4, H, W]: one over the mean distance of the visible surfaces; 0 where there are none."""
    return (1 - transmittance) / image[..., 3, :, :].clamp_min(1e-6)


def ordered(near, foreground, background, r, pairs=2000):
    """Share of random pixel pairs (one of each mask [H,W]) whose foreground pixel is nearer; equal ones count half."""
    front, behind = (near[mask][r.integers(int(mask.sum()), size=pairs)] for mask in (foreground, background))
    equal = np.abs(front - behind) <= EQUAL * np.maximum(front, behind)
    return float(np.where(equal, 0.5, front > behind).mean())


def order_of_scenes(near_of, clips, scenes):
    """Measures how well `near_of` (frames [2,3,H,W] of a pair -> nearness [2,H,W]) orders foreground in front of background.

    -> dict: `pixels`, the mean share of pixel pairs in order; `frames`, the share of key frames with more than half in order; `count` of them.
    Scenes are textured from `clips` and depend on nothing else; those without a foreground are left out."""
    source = data.Pairs(clips, VALIDATION, 1, middle=1)
    shares = []
    for k in range(scenes):
        r = np.random.default_rng([VALIDATION, k])
        scene = source.scene(r)
        near = near_of(torch.from_numpy(np.ascontiguousarray(scene['rgb'][:2].transpose(0, 3, 1, 2), dtype=np.float32)))
        for key in (0, 1):
            front, behind = scene['foreground'][key] > 0.99, scene['foreground'][key] < 0.01
            if min(front.sum(), behind.sum()) >= 50:
                shares.append(ordered(near[key], front, behind, r))
    return dict(pixels=round(float(np.mean(shares)), 4), frames=round(float(np.mean([s > 0.5 for s in shares])), 4), count=len(shares))


@torch.no_grad()
def rendered_nearness(net, frames):
    """Nearness of both key frames of a pair, rendered at the pair's two ends."""
    h, w = net.config.resolution
    image, transmittance = render_pair(net(frames), torch.tensor([[0.0, 1.0]]), h, w, torch.full((1, 2, 3), 0.5))
    return nearness(image, transmittance)[0].numpy()


def lower_is_nearer(frames):
    """Nearness from the position in the picture alone: the baseline that ignores the pixels."""
    h, w = frames.shape[-2:]
    return np.broadcast_to(np.arange(1.0, h + 1)[:, None], (len(frames), h, w))


def turned_on_its_plane(image, degrees):
    """[H, W, 3] from a camera turned around its middle: the view at flat depth."""
    h, w = image.shape[:2]
    c = np.cos(np.radians(degrees))
    return cv2.warpAffine(image, np.array([[c, 0, (1 - c) * (w - 1) / 2], [0, 1, 0]]), (w, h), flags=cv2.INTER_LINEAR)


@torch.no_grad()
def turned_scenes(net, clips, scenes, degrees=10.0):
    """PSNR (dB) against true views of procedural scenes from a camera turned around them by `degrees` to both sides, where these show surfaces of the key
    frame.

    -> dict: `views`, the network's Gaussians from there; `flat`, its picture of the key frame turned on its plane; `true_flat`, the key frame turned on its
    plane; `untouched`, the key frame itself; `count` of views. The pivot is the mean distance of the visible surfaces, in the scene and in the network's
    Gaussians."""
    h, w = net.config.resolution
    source = data.Pairs(clips, VALIDATION, 1, middle=1)
    sums, count = {}, 0
    grey = torch.full((2, 3), 0.5)
    for k in range(scenes):
        scene = source.scene(np.random.default_rng([VALIDATION, k]), (degrees, -degrees))
        gaussians = at_times(net(torch.from_numpy(np.ascontiguousarray(scene['rgb'][:2].transpose(0, 3, 1, 2), dtype=np.float32))), torch.tensor([[0.0, 1.0]]))
        straight, T = render(*gaussians, h, w, grey)
        pivot = (straight[:, 3] / (1 - T).clamp_min(1e-6)).mean((1, 2))
        shown = lambda image: np.ascontiguousarray(image[:, :3].clamp(0, 1).permute(0, 2, 3, 1).numpy())
        for side, angle in enumerate((degrees, -degrees)):
            views = shown(render_turned(*gaussians, h, w, grey, angle, pivot)[0])
            for key in (0, 1):
                front, behind = scene['foreground'][key] > 0.99, scene['foreground'][key] < 0.01
                if min(front.sum(), behind.sum()) < 50:
                    continue
                count += 1
                both = scene['both'][key, side] > 0
                rgb = scene['rgb'][key]
                flat = dict(views=views[key], flat=turned_on_its_plane(shown(straight)[key], angle), true_flat=turned_on_its_plane(rgb, angle), untouched=rgb)
                for name, image in flat.items():
                    error = np.square(image[both] - scene['turned'][key, side][both]).mean()
                    sums[name] = sums.get(name, 0.0) - 10 * np.log10(error + 1e-10)
    return dict({name: round(float(v / count), 2) for name, v in sums.items()}, count=count)


@torch.no_grad()
def keep_frames_apart(net, step=APART):
    """Sets one depth velocity for all Gaussians: the second frame is `step` behind the first at every time of the interval.

    At time t the first frame has moved by step * t and the second by step * (t - 1). The order inside a frame does not change. Where depths differ by less than
    `step` the pair is composited as with equal depths: the first frame in front. Changes by `come_forward` are removed."""
    one, two, out = (net.gs_dynamic_predictor.gs_layer['xyz_dynamic'].layers[k] for k in '147')
    v = int(out.weight[1].abs().argmax())
    if out.weight[1].count_nonzero() == 1 and two.weight[v].count_nonzero() == 1:
        u = int(two.weight[v].abs().argmax())
        for p in (one.weight[u], one.bias[u:u + 1], two.weight[v], two.bias[v:v + 1], two.weight[:, u], out.weight[:, v]):
            p.zero_()
    last = net.gs_dynamic_predictor.gs_layer['xyz_dynamic'].layers['7']
    last.weight[1] = 0
    last.bias[1] = 20                              # tanh is 1 to the last bit
    net.gs_dynamic_predictor.dynamic_scalar[1] = step


@torch.no_grad()
def come_forward(net, frames, step=APART, margin=MARGIN):
    """Sets depth velocity 0 for the first frame and `step` for the second, which comes forward from behind: so followed points keep their depth.

    One hidden unit of each layer of the motion head opens only for the second frame (the units that matter least on `frames`, pairs next to each other). The
    first unit reads the frame's flag from the tokens by least squares, with a gain at which a closed unit is 0 to the bit. Returns the least distance of a
    token from the wrong side; under `margin` nothing is written. This must be the last step: training would change it."""
    e = net.encode(frames)
    _, token = net.static(e)
    x = torch.cat([net.encoder_proj(token), net.gaussian_upsampler(net.decoder.transformer_decoder(e))], -1)
    flag = torch.tensor([-1.0, 1.0], dtype=torch.float64).repeat(len(frames) // 2)[:, None].expand(x.shape[:2])
    a = torch.cat([x, torch.ones_like(x[..., :1])], -1).flatten(0, 1).double()
    w = torch.linalg.solve(a.T @ a + 1e-7 * len(a) * torch.eye(a.shape[1], dtype=torch.float64), a.T @ flag.flatten())
    least = float((a @ w * flag.flatten()).min())
    if least < margin:
        return least
    one, two, out = (net.gs_dynamic_predictor.gs_layer['xyz_dynamic'].layers[k] for k in '147')
    h1 = F.silu(one(x))
    h2 = F.silu(two(h1))
    size = lambda h: h.pow(2).mean((0, 1)).sqrt()
    u, v = int((two.weight.norm(dim=0) * size(h1)).argmin()), int((out.weight[[0, 2]].norm(dim=0) * size(h2)).argmin())
    gain = 150 / margin
    one.weight[u], one.bias[u] = gain * w[:-1].float(), gain * w[-1].float()
    two.weight[:, u], two.weight[v], two.bias[v] = 0, 0, 0
    two.weight[v, u] = 1
    out.weight[:, v], out.weight[1], out.bias[1] = 0, 0, 0
    out.weight[1, v] = 1
    net.gs_dynamic_predictor.dynamic_scalar[1] = step
    return least


def position_layer(net):
    """The linear layer whose row 1 is y."""
    head = net.gs_predictor.predictor
    return head.mix_layer['xyz_static_mean'] if head.sampled else head.gs_layer['xyz_static']


def lean():
    """[4, 4]: nearness of each Gaussian of a patch relative to its patch, in the order of storage."""
    return STEP * (7.5 - torch.arange(16.0).view(4, 4))


@torch.no_grad()
def least_missed(net, frames):
    """Channels of the first and the second stage of the static upsampler whose loss changes the pictures of `frames` least."""
    up, (h, w) = net.gs_predictor.gaussian_upsampler, net.config.resolution
    e = net.encode(frames)

    def psnr_without(*missing):
        x, grid = e, net.config.grid
        for i, channel in enumerate(missing):
            x = getattr(up, f'attention_{i}')(getattr(up, f'upsampler_{i}')(x, tuple(n << i for n in grid)))
            x[..., channel] = 0
        image, _ = render_static(net.gs_predictor.predictor(up.layernorm2(x)), h, w, frames.new_full((len(frames), 3), 0.5))
        return float(psnr(image[:, :3], frames).mean())

    n0, n1 = up.upsampler_0.d_out, up.upsampler_1.d_out
    return max(range(n0), key=lambda k: psnr_without(k, [])), max(range(n1), key=lambda k: psnr_without([], k))


@torch.no_grad()
def write_lean(net, frames):
    """Prepares y for training: makes patches lean, so that neighbours keep their order while pictures are learnt.

    One channel of each stage of the static upsampler (`least_missed`) holds the place in the patch, and y reads only the last one. Training adds depth to the
    first stage's channel; the path from there to y is fixed (`kept_lean`). A network that already has depth is scaled back to the training scale."""
    layer = position_layer(net)
    if layer.weight[1].any():
        layer.weight[1] /= RELIEF
        layer.bias[1] /= RELIEF
        return
    up = net.gs_predictor.gaussian_upsampler
    c0, c1 = least_missed(net, frames)
    place = torch.arange(2.0)[:, None] * 4 + torch.arange(2.0)                     # the order of storage: rows of four
    unit = 0.2
    for i, c, p in ((0, c0, 2 * place), (1, c1, place)):
        fc, stack = getattr(up, f'upsampler_{i}').residual_fc, getattr(up, f'attention_{i}')
        fc.weight.view(-1, 4, fc.in_features)[c] = 0
        fc.bias.view(-1, 4)[c] = unit * (p.mean() - p).flatten()
        for block in stack.resblocks:
            block.mlp.c_fc.weight[:, c] = 0
            block.mlp.c_proj.weight[c] = 0
            block.attn.out_proj.weight[c], block.attn.out_proj.bias[c] = 0, 0
    up.upsampler_1.residual_fc.weight.view(-1, 4, up.upsampler_0.d_out)[c1, :, c0] = 1
    net.encoder_proj.weight[:, c1] = 0
    for name in ('scale', 'opacity', 'rgb'):
        net.gs_predictor.predictor.gs_layer[name].weight[:, c1] = 0
    layer.weight[:, c1] = 0
    token = up(net.encode(frames))[..., c1].unflatten(1, (net.config.splat_grid[0] // 4, 4, -1, 4))
    want = lean().to(token)[:, None, :].expand_as(token)
    layer.weight[1, c1] = (want * token).sum() / token.pow(2).sum()


def kept_lean(net):
    """Hooks that keep the path from the first stage's channel to y as `write_lean` wrote it."""
    layer, up = position_layer(net), net.gs_predictor.gaussian_upsampler
    c = int(layer.weight[1].abs().argmax())

    def without(rows):
        def hook(g):
            g = g.clone()
            g[rows] = 0
            return g
        return hook

    four = slice(4 * c, 4 * c + 4)
    fixed = [(up.upsampler_1.residual_fc.weight, four), (up.upsampler_1.residual_fc.bias, four), (up.layernorm2.weight, c), (layer.weight, 1)]
    fixed += [(block.mlp.c_proj.weight, c) for block in up.attention_1.resblocks]
    return [p.register_hook(without(rows)) for p, rows in fixed if p.requires_grad]


@torch.no_grad()
def settle(net):
    """Scales trained depth to the final scale."""
    layer = position_layer(net)
    layer.weight[1] *= RELIEF
    layer.bias[1] *= RELIEF


def lean_loss(y, splat_grid, front):
    """Distance of y [B, N] from the target lean and the target depth of patches: (uneven, misplaced).

    `uneven`: mean squared error of Gaussians against their place in their patch, in steps. `misplaced`: mean squared error of the patches of the last
    len(front) frames against STANDS where `front` [.., H, W] is 1 and -STANDS where it is 0, relative to STANDS. Foreground and background of a frame have
    equal weight, so uncertain patches end up in between; frames with only one of both do not count."""
    o = torch.atanh((2 * y - 1).clamp(-0.999, 0.999)).unflatten(1, (splat_grid[0] // 4, 4, splat_grid[1] // 4, 4))
    rest = o - lean()[:, None, :].to(o)
    patch = rest.mean((2, 4))
    uneven = ((rest - patch[:, :, None, :, None]) / STEP).pow(2).mean()
    f = F.avg_pool2d(front[:, None], front.shape[1] // patch.shape[1]).flatten(1)
    p = patch[-len(f):].flatten(1) / STANDS
    sides = torch.stack([f.sum(1), (1 - f).sum(1)])
    error = 0.5 * (f * (p - 1).pow(2)).sum(1) / (sides[0] + 1) + 0.5 * ((1 - f) * (p + 1).pow(2)).sum(1) / (sides[1] + 1)
    return uneven, (error * (sides.amin(0) >= 1)).mean()


ORDERS = ('storage', 'lowest row first', 'rightmost first in each row', 'patches at random', 'at random')


def keys_of(order, grid, generator):
    """Sorting keys [N] of a frame's Gaussians on the splat grid `grid`: the smaller is in front."""
    rows, columns = torch.meshgrid(torch.arange(float(grid[0])), torch.arange(float(grid[1])), indexing='ij')
    inside = (rows % 4) * 4 + columns % 4
    chance = torch.rand(grid, generator=generator)
    return dict(zip(ORDERS, (rows * grid[1] + columns, -rows * grid[1] + columns, rows * grid[1] - columns,
                             100 * chance[::4, ::4].repeat_interleave(4, 0).repeat_interleave(4, 1) + inside, chance)))[order].flatten()


@torch.no_grad()
def fragility(net, frames, seed=0):
    """PSNR (dB) of single frames [B,3,H,W] at 0.5 grey by the order in which their Gaussians are composited, nothing else changed."""
    h, w = net.config.resolution
    g, _ = net.static(net.encode(frames))
    out = {}
    for order in ('depth', *ORDERS):
        key = None if order == 'depth' else keys_of(order, net.config.splat_grid, torch.Generator().manual_seed(seed)).expand(len(frames), -1)
        image, _ = render(g['xyz'], g['scale'], g['opacity'][..., 0], g['rgb'], h, w, torch.full((len(frames), 3), 0.5), order=key)
        out[order] = round(float(psnr(image[:, :3], frames).mean()), 2)
    return out
