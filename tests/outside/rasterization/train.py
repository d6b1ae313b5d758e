"""examples/train_still.py on a small generated COLMAP project: train.py EXAMPLE. Its last image is nearer than its first, and its scene opens."""
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import streamsplat_cpu
from PIL import Image

example = sys.argv[1]
random = np.random.default_rng(7)
N, WIDTH, HEIGHT, FOCAL = 150, 80, 60, 70.0
means = random.normal(0, 0.6, (N, 3)).astype(np.float32)
colors = random.uniform(0, 1, (N, 3)).astype(np.float32)
truth = dict(means=means, quats=random.normal(size=(N, 4)).astype(np.float32), scales=np.exp(random.uniform(-3, -1.5, (N, 3))).astype(np.float32),
             opacities=random.uniform(0.4, 0.95, N).astype(np.float32), colors=colors)
K = np.array([[[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]]], np.float32)
with tempfile.TemporaryDirectory(prefix='streamsplat-train-') as folder:
    folder = Path(folder)
    (folder / 'images').mkdir()
    model = folder / 'sparse/0'
    model.mkdir(parents=True)
    poses = ['# a comment']
    for i in range(6):
        a = 0.15 * (i - 2.5)
        view = np.eye(4, dtype=np.float32)
        view[:3, :3] = [[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]]
        view[2, 3] = 3.5
        image = streamsplat_cpu.rasterization(**truth, viewmats=view[None], Ks=K, width=WIDTH, height=HEIGHT)[0][0]
        Image.fromarray((255 * image.clip(0, 1)).round().astype(np.uint8)).save(folder / f'images/{i}.png')
        poses += [f'{i + 1} {np.cos(a / 2)} 0 {np.sin(a / 2)} 0 0 0 3.5 1 {i}.png', '']
    (model / 'images.txt').write_text('\n'.join(poses) + '\n')
    (model / 'cameras.txt').write_text(f'# cameras\n1 PINHOLE {WIDTH} {HEIGHT} {FOCAL} {FOCAL} {WIDTH / 2} {HEIGHT / 2}\n')
    start = means + random.normal(0, 0.03, means.shape)
    rows = [f'{i} {x} {y} {z} {r} {g} {b} 0.5' for i, ((x, y, z), (r, g, b)) in enumerate(zip(start, (255 * (0.5 * colors + 0.25)).astype(int)))]
    (model / 'points3D.txt').write_text('# points\n' + '\n'.join(rows) + '\n')
    out = folder / 'scene.ply'
    text = subprocess.run([sys.executable, example, folder, out, '400'], check=True, capture_output=True, text=True).stdout
    first, last = (float(line.split()[-2]) for line in (text.splitlines()[0], text.splitlines()[-1]))
    print(f'train_still.py: {first:.1f} dB at first, {last:.1f} dB after 400 steps')
    assert last > first + 8 and last > 25, text
    assert streamsplat_cpu.Scene(str(out)) is not None
