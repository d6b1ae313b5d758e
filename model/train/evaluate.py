"""Held-out figures of a checkpoint: PSNR and SSIM of key and middle frames, against three interpolations without a scene.

Truth is the clip at the model's resolution (area averaging); both are then resized bilinearly to 256x256. `streamsplat eval` is the program's own measurement.
This one serves training, and adds the optical-flow baseline.
"""
import json

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from skimage.metrics import structural_similarity

from . import data
from .rasteriser import render_pair

METHODS = ('ours', 'crossfade', 'nearest', 'dis')


def figures(image, truth):
    mse = float((image - truth).pow(2).mean())
    s = structural_similarity(image.permute(1, 2, 0).numpy(), truth.permute(1, 2, 0).numpy(), win_size=11, gaussian_weights=True, sigma=1.5,
                              use_sample_covariance=False, channel_axis=2, data_range=1.0)
    return -10 * np.log10(max(mse, 1e-10)), float(s)


def flow_blend(a, b, forward, backward, t):
    """Both flows brought to time t, backward warps, linear blend."""
    to_a, to_b = -(1 - t) * t * forward + t * t * backward, (1 - t) ** 2 * forward - t * (1 - t) * backward
    return (1 - t) * data.warp(a, to_a) + t * data.warp(b, to_b)


def square(x):
    return F.interpolate(x[None], (256, 256), mode='bilinear', align_corners=False)[0]


@torch.no_grad()
def interval(net, clip, i, gap, one_way=False):
    """Rows (kind, method, psnr, ssim) of the interval that starts at frame i, and the widest Gaussian in cells of the splat grid."""
    h, w = net.config.resolution
    frames = torch.from_numpy(clip[i:i + gap + 1]).permute(0, 3, 1, 2).float() / 255
    times = torch.linspace(0, 1, gap + 1)
    g = {k: t[:, :1 if one_way else 2] for k, t in net(frames[[0, -1]]).items()}
    image, _ = render_pair(g, times[None], h, w, torch.full((1, gap + 1, 3), 0.5))
    ours = image[0, :, :3].clamp(0, 1)
    forward, backward = data.dis_flow(clip[i], clip[i + gap]), data.dis_flow(clip[i + gap], clip[i])
    a, b = (frames[k].permute(1, 2, 0).contiguous().numpy() for k in (0, -1))
    rows = []
    for k, t in enumerate(times.tolist()):
        inner = 0 < k < gap
        candidates = dict(ours=ours[k])
        if inner:
            candidates.update(crossfade=frames[0] * (1 - t) + frames[-1] * t, nearest=frames[0] if t <= 0.5 else frames[-1],
                              dis=torch.from_numpy(flow_blend(a, b, forward, backward, t)).permute(2, 0, 1).clamp(0, 1))
        for method, x in candidates.items():
            rows.append(('middle' if inner else 'key', method, *figures(square(x), square(frames[k]))))
    return rows, float(g['scale'].max()) * net.config.splat_grid[1] / 2


def summary(rows):
    """Means by kind and method, of rows (clip, kind, method, psnr, ssim)."""
    out = {}
    for kind in ('key', 'middle'):
        for method in METHODS:
            v = np.array([r[3:] for r in rows if r[1] == kind and r[2] == method])
            if len(v):
                out[f'{kind}.{method}'] = dict(psnr=round(float(v[:, 0].mean()), 3), ssim=round(float(v[:, 1].mean()), 4), frames=len(v))
    return out


def judge(rows):
    """The bars: moving clips (cross-fade under 26 dB) against the cross-fade, the others against their own key frames."""
    moving, still = [], []
    for name in dict.fromkeys(r[0] for r in rows):
        s = summary([r for r in rows if r[0] == name])
        if s['middle.crossfade']['psnr'] < 26:
            moving.append(s['middle.ours']['psnr'] - s['middle.crossfade']['psnr'])
        else:
            still.append(s['middle.ours']['psnr'] - s['key.ours']['psnr'])
    mean = lambda v: round(float(np.mean(v)), 3) if v else None
    return dict(moving_clips=len(moving), moving_middle_above_crossfade=mean(moving), still_clips=len(still), still_middle_above_own_key=mean(still))


def evaluate(net, root, gaps=(5, 8), stride=10, limit=0, cache=None, report=None, one_way=False, say=print):
    """`limit`: intervals per clip (0: all); `one_way`: the first frame's Gaussians alone. Writes `report` (JSON) after each gap."""
    net.eval()
    result = {}
    for gap in gaps:
        rows, widest = [], 0.0
        for folder in data.clip_folders(root):
            clip = data.load_clip(folder, net.config.resolution, cache)
            starts = list(range(0, len(clip) - gap, stride))
            for i in starts[:limit or None]:
                measured, wide = interval(net, clip, i, gap, one_way)
                rows, widest = rows + [(folder.name, *r) for r in measured], max(widest, wide)
            say(gap, folder.name, {k: v['psnr'] for k, v in summary([r for r in rows if r[0] == folder.name]).items()})
        result[f'gap{gap}'] = dict(mean=summary(rows), bars=judge(rows), widest_cells=round(widest, 3), clips={n: summary([r for r in rows if r[0] == n]) for n in dict.fromkeys(r[0] for r in rows)})
        say(gap, result[f'gap{gap}']['mean'], result[f'gap{gap}']['bars'], f'widest Gaussian {widest:.2f} cells')
        if report:
            with open(report, 'w') as f:
                json.dump(result, f, indent=1)
    return result


@torch.no_grad()
def sheet(net, root, names, path, gap=5):
    """Rows: clips; columns: key, key, true middle, ours, cross-fade."""
    h, w = net.config.resolution
    rows = []
    for name in names:
        clip = data.load_clip(f'{root}/{name}', (h, w))
        i, k = (len(clip) - gap) // 3, gap // 2
        f = torch.from_numpy(clip[i:i + gap + 1]).permute(0, 3, 1, 2).float() / 255
        image, _ = render_pair(net(f[[0, -1]]), torch.tensor([[k / gap]]), h, w, torch.full((1, 1, 3), 0.5))
        columns = [f[0], f[-1], f[k], image[0, 0, :3].clamp(0, 1), f[0] * (1 - k / gap) + f[-1] * k / gap]
        rows.append(np.concatenate([np.pad((x.permute(1, 2, 0).numpy() * 255).round().astype(np.uint8), ((2, 2), (2, 2), (0, 0))) for x in columns], 1))
    cv2.imwrite(str(path), np.concatenate(rows)[:, :, ::-1])
