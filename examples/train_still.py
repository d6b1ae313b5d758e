"""A still scene from images and cameras, on a CPU: python3 train_still.py FOLDER OUT.ply [STEPS]

FOLDER is a COLMAP project of undistorted images: images/, and sparse/0 as text (`colmap model_converter --output_type TXT`). Gaussians begin as its points
and keep their number. Needs streamsplat-cpu, torch and pillow.
"""
import sys
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from streamsplat_cpu import rasterization

folder, out, steps = Path(sys.argv[1]), sys.argv[2], int((sys.argv + ['2000'])[3])
lines = lambda name: [line.split() for line in (folder / 'sparse/0' / name).read_text().splitlines() if not line.startswith('#')]
lenses = {row[0]: ([int(v) for v in row[2:4]], [float(v) for v in row[4:8]]) for row in lines('cameras.txt') if row}
points = np.array([row[1:7] for row in lines('points3D.txt') if row], np.float32)
views = []
for _, w, x, y, z, *t, lens, name in (row[:10] for row in lines('images.txt')[::2] if row):
    w, x, y, z = np.array([w, x, y, z], float) / np.linalg.norm(np.array([w, x, y, z], float))
    view = np.eye(4)
    view[:3] = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), t[0]], [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), t[1]],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), t[2]]]
    (width, height), (fx, fy, cx, cy) = lenses[lens]
    k = torch.tensor([[[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]])
    views.append((torch.tensor(view, dtype=torch.float32)[None], k, torch.tensor(np.asarray(Image.open(folder / 'images' / name).convert('RGB')) / np.float32(255)), width, height))

means = torch.tensor(points[:, :3])
apart = torch.cdist(means[:4096], means[:4096]).fill_diagonal_(torch.inf).min(-1).values.median().clamp_min(1e-6)
scene = dict(means=means, logs=torch.full_like(means, float(apart.log())), quats=torch.eye(4)[:1].repeat(len(means), 1), logits=torch.full(means.shape[:1], 0.0),
             colors=torch.tensor(points[:, 3:] / 255))
rates = dict(means=0.1 * float(apart), logs=5e-3, quats=1e-3, logits=5e-2, colors=5e-3)
adam = torch.optim.Adam([{'params': [value.requires_grad_(True)], 'lr': rates[name]} for name, value in scene.items()], eps=1e-15)
for step in range(steps):
    view, k, target, width, height = views[step * 7919 % len(views)]
    image, _, _ = rasterization(scene['means'], scene['quats'], scene['logs'].exp(), scene['logits'].sigmoid(), scene['colors'], view, k, width, height)
    loss = (image[0] - target).abs().mean()
    adam.zero_grad()
    loss.backward()
    adam.step()
    if step % 50 == 0 or step == steps - 1:
        print(f'step {step}: {-10 * float(((image[0] - target) ** 2).mean().log10()):.1f} dB')

values = {name: value.detach().numpy() for name, value in scene.items()}
names = ['x', 'y', 'z', 'f_dc_0', 'f_dc_1', 'f_dc_2', 'opacity', 'scale_0', 'scale_1', 'scale_2', 'rot_0', 'rot_1', 'rot_2', 'rot_3']
head = f'ply\nformat binary_little_endian 1.0\nelement vertex {len(means)}\n' + ''.join(f'property float {name}\n' for name in names) + 'end_header\n'
table = [values['means'], (values['colors'] - 0.5) / 0.28209479177387814, values['logits'][:, None], values['logs'], values['quats']]
Path(out).write_bytes(head.encode() + np.concatenate(table, 1).astype('<f4').tobytes())
