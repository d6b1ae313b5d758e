"""Training data: real clips (a folder per clip, holding numbered images) and procedural scenes with true motion and depth.

Every sample is a function of (seed, step, index in the batch) alone, so a resumed run gets the same samples as an uninterrupted one.
"""
import os
import pathlib
import threading

import cv2
import numpy as np

cv2.setNumThreads(1)
AROUND = np.ones((7, 7), np.uint8)     # pixels around one that `inner` of a scene from the side requires
_local = threading.local()


def clip_folders(root):
    return sorted(p for p in pathlib.Path(root).iterdir() if p.is_dir())


def load_clip(folder, size, cache=None):
    """All frames of a clip at `size` (rows, columns) as uint8 RGB [F,H,W,3]; area averaging when it shrinks."""
    h, w = size
    folder = pathlib.Path(folder)
    kept = pathlib.Path(cache) / f'{folder.parent.name}-{folder.name}-{h}x{w}.npy' if cache else None
    if kept and kept.exists():
        return np.load(kept)
    files = sorted(f for f in folder.iterdir() if f.suffix.lower() in ('.jpg', '.jpeg', '.png'))
    frames = []
    for f in files:
        image = cv2.imread(str(f))[:, :, ::-1]
        frames.append(image if image.shape[:2] == (h, w) else cv2.resize(image, (w, h), interpolation=cv2.INTER_AREA))
    frames = np.stack(frames)
    if kept:
        kept.parent.mkdir(parents=True, exist_ok=True)
        np.save(kept, frames)
    return frames


def coded_frame(frame, quality):
    settings = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    return cv2.imencode('.jpg', frame[:, :, ::-1], settings)[1]


def pack(source, target, size, limit):
    """Writes the clips of source/train and source/val at `size` to `target`, in the layout that `load_clip` reads, in at most `limit` bytes.

    JPEG without chroma subsampling, at the highest quality of 95, 90, ... that fits. Returns the number of clips, frames and bytes, and the quality."""
    clips = [(p.relative_to(source), load_clip(p, size)) for split in ('train', 'val') for p in clip_folders(source / split)]
    for quality in range(95, 45, -5):
        coded = [[coded_frame(f, quality) for f in clip] for _, clip in clips]
        used = sum(len(f) for clip in coded for f in clip)
        if used <= limit:
            break
    else:
        raise ValueError(f'{used} bytes at quality {quality}, {limit} allowed: fewer clips or a smaller size')
    for (name, _), clip in zip(clips, coded):
        (target / name).mkdir(parents=True, exist_ok=True)
        for k, f in enumerate(clip):
            (target / name / f'{k:05}.jpg').write_bytes(f.tobytes())
    return dict(clips=len(clips), frames=sum(map(len, coded)), bytes=used, quality=quality)


def dis_flow(a, b):
    """Dense optical flow from a to b (uint8 RGB), pixels."""
    if not hasattr(_local, 'dis'):
        _local.dis = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    grey = [cv2.cvtColor(np.ascontiguousarray(x), cv2.COLOR_RGB2GRAY) for x in (a, b)]
    return _local.dis.calc(grey[0], grey[1], None)


def warp(image, flow):
    """image sampled at x + flow(x)."""
    y, x = np.mgrid[0:image.shape[0], 0:image.shape[1]].astype(np.float32)
    return cv2.remap(image, x + flow[..., 0], y + flow[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def consistent(f, g):
    """1 where flow f followed by flow g returns to where it started."""
    error = np.linalg.norm(f + warp(g, f), axis=-1)
    return (error < 1.0 + 0.05 * np.linalg.norm(f, axis=-1)).astype(np.float32)


def colour_jitter(r, x):
    """One photometric change for all frames of a sample."""
    if r.random() < 0.7:
        x = np.clip((x - 0.5) * r.uniform(0.75, 1.2) + 0.5 + r.uniform(-0.08, 0.08), 0, 1)
        if r.random() < 0.3:
            x = x[..., r.permutation(3)]
    return x


def magnify(r, frame):
    """A part of `frame`, enlarged 1.1 to 1.9 times to the frame's size, like a tile of a larger frame.

    (Sharpness, as the amplitude of the finest octave of luma over that of the next, in medians: tiles of 512x288 frames of `val/` 0.86, frames of `train/`
    1.10, their parts 0.92 at 1.25 times and 0.83 at 1.5.)"""
    h, w = frame.shape[:2]
    factor = r.uniform(1.1, 1.9)
    rows, columns = round(h / factor), round(w / factor)
    y, x = int(r.integers(h - rows + 1)), int(r.integers(w - columns + 1))
    return cv2.resize(np.ascontiguousarray(frame[y:y + rows, x:x + columns]), (w, h), interpolation=cv2.INTER_CUBIC)


class Frames:
    """Single frames for the static stage: batch(step) -> (float32 [B,3,H,W], place).

    `magnified`: share of the frames of which a magnified part is used. With `crop` (rows, columns in patches of 8) every step uses crops of one size of several
    frames. A crop is treated as if it were at the token `place` of the full grid. The place is random for the position code, and independent of the pixels'
    place."""

    def __init__(self, clips, seed, batch, crop=None, magnified=0.0):
        self.clips, self.seed, self.size, self.crop, self.magnified = clips, seed, batch, crop, magnified

    def frame(self, r):
        clip = self.clips[r.integers(len(self.clips))]
        frame = clip[r.integers(len(clip))]
        return frame[:, ::-1] if r.random() < 0.5 else frame

    def batch(self, step):
        out, place = [], (0, 0)
        if self.crop:
            rows, columns = (n // 8 - c for n, c in zip(self.clips[0].shape[1:3], self.crop))
            r = np.random.default_rng([self.seed, step, 1 << 20])
            place = int(r.integers(rows + 1)), int(r.integers(columns + 1))
        for i in range(self.size):
            r = np.random.default_rng([self.seed, step, i])
            frame = self.frame(r)
            if self.magnified and r.random() < self.magnified:
                frame = magnify(r, frame)
            if self.crop:
                y, x = 8 * int(r.integers(rows + 1)), 8 * int(r.integers(columns + 1))
                frame = frame[y:y + 8 * self.crop[0], x:x + 8 * self.crop[1]]
            out.append(colour_jitter(r, frame.astype(np.float32) / 255).transpose(2, 0, 1))
        return np.ascontiguousarray(np.stack(out), dtype=np.float32), place


class Pairs:
    """Key frames, middle frames and teacher motion: batch(step) -> dict of float32 arrays.

    rgb [B,2+K,H,W,3]->[B,2+K,3,H,W] (key 0, key 1, K middle ones), time [B,2+K], flow [B,2,2,H,W] in pixels (0 to 1 and 1 to 0),
    sure [B,2,H,W] where the flow is reliable, inverse depth [B,2,H,W], has_depth [B], foreground [B,2+K,H,W]."""

    def __init__(self, clips, seed, batch, middle=2, procedural=0.4, gaps=(2, 8)):
        self.frames = Frames(clips, seed, 1)
        self.clips = [c for c in clips if len(c) > gaps[1] + 1]
        self.seed, self.size, self.middle, self.procedural, self.gaps = seed, batch, middle, procedural, gaps

    def real(self, r):
        clip = self.clips[r.integers(len(self.clips))]
        gap = int(r.integers(self.gaps[0], self.gaps[1] + 1))
        i = int(r.integers(0, len(clip) - gap))
        first, step = (i, 1) if r.random() < 0.5 else (i + gap, -1)                           # both time directions
        inner = r.choice(np.arange(1, gap), size=self.middle, replace=gap - 1 < self.middle)
        frames = [clip[first], clip[first + step * gap]] + [clip[first + step * int(j)] for j in inner]
        if r.random() < 0.5:
            frames = [np.ascontiguousarray(f[:, ::-1]) for f in frames]
        forward, backward = dis_flow(frames[0], frames[1]), dis_flow(frames[1], frames[0])
        h, w = frames[0].shape[:2]
        return dict(rgb=np.stack(frames).astype(np.float32) / 255, time=np.array([0, 1] + [j / gap for j in inner], np.float32),
                    flow=np.stack([forward, backward]), sure=np.stack([consistent(forward, backward), consistent(backward, forward)]),
                    depth=np.zeros((2, h, w), np.float32), has_depth=np.float32(0), foreground=np.zeros((len(frames), h, w), np.float32))

    def scene(self, r, turns=()):
        """Textured layers at different depths under affine motion: a background wider than the picture and blobs in front of it.

        Motion is a camera's (in proportion to inverse depth) plus each layer's own; nearer layers hide farther ones. `turned` are the key frames [2,
        len(turns), H, W, 3] from a camera turned by `turns` degrees around the mean distance of the visible surfaces. `both` is 1 where a turned picture shows
        surfaces that the key frame also shows. `inner` is 1 where this holds around a pixel, all on one layer."""
        h, w = self.clips[0].shape[1:3]
        times = np.concatenate([[0, 1], np.sort(r.uniform(0.1, 0.9, self.middle))]).astype(np.float32)
        large = r.random() < 0.35
        gx, gy = np.meshgrid(np.arange(w, dtype=np.float32), np.arange(h, dtype=np.float32))
        n = int(r.integers(0, 5))
        angle, reach = r.uniform(0, 2 * np.pi), r.gamma(1.5, 5.0 if large else 2.5)
        camera = np.array([np.cos(angle), 0.6 * np.sin(angle)]) * reach * w / 256                 # px over the interval
        depth = np.sort(r.uniform(0.15, 1.0, n + 1))
        layers = []
        for k in range(n + 1):
            texture = np.ascontiguousarray(self.frames.frame(r).astype(np.float32) / 255)
            mask = np.ones((h, w), np.float32)
            if k:
                th = np.linspace(0, 2 * np.pi, 40, endpoint=False)
                rad = w / 256 * r.uniform(10, 40) * (1 + sum(r.normal(0, 0.25 / j) * np.cos(j * th + r.uniform(0, 6.28)) for j in (1, 2, 3, 4)))
                points = np.stack([w / 2 + rad * np.cos(th) * r.uniform(0.6, 1.8), h / 2 + rad * np.sin(th)], 1)
                mask = cv2.fillPoly(np.zeros((h, w), np.uint8), [np.round(points * 16).astype(np.int32)], 255, cv2.LINE_AA, 4).astype(np.float32) / 255
            layers.append(dict(texture=texture, mask=mask, depth=depth[k], zoom=r.uniform(0.8, 1.4) if k else r.uniform(1.15, 1.6),
                               centre=np.array([r.uniform(0.1, 0.9) * w, r.uniform(0.1, 0.9) * h]) if k else np.array([w / 2, h / 2]),
                               move=camera * depth[k] / depth.mean() + (r.normal(0, 8.0 if large else 4.0, 2) * [1, 0.6] * w / 256 if k else 0),
                               turn=r.normal(0, 0.08 if k else 0.03), grow=r.normal(0, 0.06 if k else 0.03)))

        def placed(layer, t):
            s, a = layer['zoom'] * (1 + layer['grow'] * (t - 0.5)), layer['turn'] * (t - 0.5)
            m = s * np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
            return np.concatenate([m, (layer['centre'] + layer['move'] * (t - 0.5) - m @ [w / 2, h / 2])[:, None]], 1)

        def drawn(t, views):
            """Picture, foreground and nearest layer [H, W] at time t, each layer k moved by the affine map views[k] after its own."""
            image, front, nearest = np.zeros((h, w, 3), np.float32), np.zeros((h, w), np.float32), np.zeros((h, w), np.int64)
            for j, layer in enumerate(layers):
                A = (views[j] @ np.vstack([placed(layer, t), [0, 0, 1]]))[:2]
                texture = cv2.warpAffine(layer['texture'], A, (w, h), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
                m = cv2.warpAffine(layer['mask'], A, (w, h), flags=cv2.INTER_LINEAR) if j else np.ones((h, w), np.float32)
                image += m[..., None] * (texture - image)
                front = np.maximum(front, m) if j else front
                nearest = np.where(m > 0.5, j, nearest)
            return np.clip(image, 0, 1), front, nearest

        straight = [np.eye(3)] * len(layers)
        frames, flows, depths, foregrounds, turned, both, inner = [], [], [], [], [], [], []
        for k, t in enumerate(times):
            image, front, nearest = drawn(t, straight)
            frames.append(image); foregrounds.append(front)
            if k < 2:
                flow = np.zeros((h, w, 2), np.float32)
                for j, layer in enumerate(layers):
                    A, B = (np.vstack([placed(layer, s), [0, 0, 1]]) for s in (t, 1 - t))
                    M = B @ np.linalg.inv(A)
                    f = np.stack([M[0, 0] * gx + M[0, 1] * gy + M[0, 2] - gx, M[1, 0] * gx + M[1, 1] * gy + M[1, 2] - gy], -1)
                    flow = np.where((nearest == j)[..., None], f, flow)
                flows.append(flow); depths.append(depth[nearest])
                distance = 1 / (9.8 * depth + 0.2)
                pivot = distance[nearest].mean()
                for degrees in turns:
                    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
                    views = [np.array([[c, 0, (1 - c) * (w - 1) / 2 - s * (z - pivot) * w / 2], [0, 1, 0], [0, 0, 1]]) for z in distance]
                    image, _, seen = drawn(t, views)
                    x = np.round(np.stack([(gx - v[0, 2]) / c for v in views])[seen, np.arange(h)[:, None], np.arange(w)]).astype(np.int64)
                    before = nearest[np.arange(h)[:, None], np.clip(x, 0, w - 1)]
                    turned.append(image); both.append(((x >= 0) & (x < w) & (before == seen)).astype(np.float32))
                    same = both[-1] * (cv2.erode(seen.astype(np.uint8), AROUND) == cv2.dilate(seen.astype(np.uint8), AROUND))
                    inner.append(cv2.erode(same, AROUND))
        each = lambda images: np.stack(images).reshape(2, len(turns), *images[0].shape)
        views = dict(turned=each(turned), both=each(both), inner=each(inner)) if turns else {}
        return dict(rgb=np.stack(frames), time=times, flow=np.stack(flows).astype(np.float32), sure=np.ones((2, h, w), np.float32),
                    depth=np.stack(depths).astype(np.float32), has_depth=np.float32(1), foreground=np.stack(foregrounds), **views)

    def still(self, step, k=0):
        """One key frame of a procedural scene and its foreground mask: float32 [1,3,H,W], [1,H,W]. `k`: which of the step's scenes."""
        r = np.random.default_rng([self.seed, step, (1 << 23) + k])
        s, key = self.scene(r), int(r.integers(2))
        rgb = colour_jitter(r, s['rgb'][key]).transpose(2, 0, 1)
        return np.ascontiguousarray(rgb[None], dtype=np.float32), s['foreground'][None, key]

    def turned(self, step, k, degrees):
        """As `still`, with inverse depth [1,H,W], the frame from a camera turned around it by `degrees`, and `inner` of `scene` there."""
        r = np.random.default_rng([self.seed, step, (1 << 23) + k])
        s, key = self.scene(r, (degrees,)), int(r.integers(2))
        rgb = np.ascontiguousarray(colour_jitter(r, np.stack([s['rgb'][key], s['turned'][key, 0]])).transpose(0, 3, 1, 2), dtype=np.float32)
        return rgb[:1], s['foreground'][None, key], s['depth'][None, key], rgb[1:], s['inner'][key]

    def sample(self, r):
        s = self.scene(r) if r.random() < self.procedural else self.real(r)
        s['rgb'] = np.ascontiguousarray(colour_jitter(r, s['rgb']).transpose(0, 3, 1, 2), dtype=np.float32)
        s['flow'] = np.ascontiguousarray(s['flow'].transpose(0, 3, 1, 2), dtype=np.float32)
        return s

    def batch(self, step):
        samples = [self.sample(np.random.default_rng([self.seed, step, i])) for i in range(self.size)]
        return {k: np.stack([s[k] for s in samples]).astype(np.float32) for k in samples[0]}
