"""streamsplat_cpu.rasterization compared with litesplat 0.1.1, the one package of PyPI that draws Gaussians on a CPU: every_pixel.py [ROUNDS]

litesplat evaluates every Gaussian at every pixel, through Keras; it draws 1,000 Gaussians at 96×54 in seconds. It adds no low-pass, so ours adds none
(eps2d=0), and its rows run from the bottom. The images are compared first. litesplat and Keras are installed in a temporary folder; PyTorch and streamsplat_cpu
come from the environment of tests/outside/rasterization/run.
"""
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault('RAYON_NUM_THREADS', '2')
os.environ.setdefault('OMP_WAIT_POLICY', 'passive')
os.environ['KERAS_BACKEND'] = 'torch'
sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np
import torch
from rasterization import scene
from streamsplat_cpu import rasterization

COUNT, WIDTH, HEIGHT = 1000, 96, 54
PACKAGES = ['litesplat==0.1.1', 'keras==3.15.1']


def theirs(folder, arrays):
    """litesplat's camera with these Gaussians."""
    from litesplat.core.camera_model import CameraLayer
    from litesplat.core.gaussian_model import GaussianParameterLayer
    columns = zip(*(arrays[name].tolist() for name in ('means', 'colors', 'quats', 'scales', 'opacities')))
    named = [dict(position=m, color=c, rotation=q, translation=m, scale=s, opacity=o) for m, c, q, s, o in columns]
    (folder / 'gaussians.json').write_text(json.dumps(named))
    (fx, _, cx), (_, fy, cy), _ = arrays['Ks'][0].tolist()
    # litesplat's pixel centres are whole numbers.
    camera = dict(camera_id=0, model='PINHOLE', image_name='', width=WIDTH, height=HEIGHT, fx=fx, fy=fy, cx=cx - 0.5, cy=cy + 0.5,
                  rotation=np.eye(3).tolist(), translation=[0.0, 0.0, 0.0])
    (folder / 'camera.json').write_text(json.dumps([camera]))
    layer = CameraLayer(str(folder), GaussianParameterLayer(str(folder)))
    return lambda: layer(inputs=(HEIGHT, WIDTH), render=False).detach().flip(0)


def main():
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    torch.set_num_threads(2)
    arrays = scene(COUNT, WIDTH, HEIGHT)
    # litesplat draws rotated Gaussians wrongly (findings/litesplat-turned.sh), so these are round and not rotated.
    arrays['quats'][:] = torch.tensor([1.0, 0, 0, 0])
    arrays['scales'][:] = arrays['scales'].mean(dim=-1, keepdim=True)
    with tempfile.TemporaryDirectory() as folder, torch.no_grad():
        subprocess.check_call([sys.executable, '-m', 'pip', 'install', '--quiet', '--disable-pip-version-check', '--target', f'{folder}/packages', *PACKAGES])
        sys.path.append(f'{folder}/packages')
        draw = [lambda: rasterization(**arrays, eps2d=0.0)[0][0], theirs(Path(folder), arrays)]
        ours, other = (d() for d in draw)
        error = float(((ours - other) ** 2).mean())
        print(f'images: {-10 * np.log10(error):.1f} dB apart')
        if error > 1e-3:
            sys.exit('expected images at 30 dB or more')
        times = []
        for _ in range(rounds):
            row = []
            for d in draw:
                start = time.perf_counter()
                d()
                row.append(time.perf_counter() - start)
            times.append(row)
        ours, other = (statistics.median(column) for column in zip(*times))
        print(f'{COUNT} Gaussians at {WIDTH}×{HEIGHT}: {1e3 * ours:.2f} ms, litesplat {1e3 * other:.0f} ms, {other / ours:.0f} times as fast')


if __name__ == '__main__':
    main()
