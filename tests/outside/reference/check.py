"""Checks of tests/outside/reference/run: check.py PROGRAM GSPLAT-FOLDER.

Still scenes drawn by this program, compared with gsplat's formulas in float64: its file `cuda/_torch_impl.py`, unchanged, for harmonics, projection,
anti-aliasing and the sums along rays. This file has the scenes, and determines the Gaussians that a pixel's ray meets, as described for gsplat's
`rasterize_to_indices_in_range`: an α from 1/255, until T would be 10⁻⁴ or less.
"""
import importlib.util
import json
import subprocess
import sys
import tempfile
import typing
from pathlib import Path

import numpy as np
import OpenEXR

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[2]
# `torch` and `nerfacc` in this folder.
sys.path.insert(0, str(HERE))
import torch  # noqa: E402

sys.modules |= {'torch.nn': torch.nn, 'torch.nn.functional': torch.nn.functional, 'typing_extensions': typing}
PROGRAM, GSPLAT = sys.argv[1:3]
_spec = importlib.util.spec_from_file_location('gsplat_formulas', Path(GSPLAT) / 'gsplat/cuda/_torch_impl.py')
gsplat = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(gsplat)

NAMES = ['x', 'y', 'z', 'f_dc_0', 'f_dc_1', 'f_dc_2', *(f'f_rest_{i}' for i in range(45)),
         'opacity', 'scale_0', 'scale_1', 'scale_2', 'rot_0', 'rot_1', 'rot_2', 'rot_3']
# Depth from which Gaussians are drawn; gsplat's own default is 0.01.
NEAR = 1e-6
BACKGROUND = 0.5


def write_ply(path, scene):
    header = f'ply\nformat binary_little_endian 1.0\nelement vertex {len(scene["mean"])}\n'
    header += ''.join(f'property float {name}\n' for name in NAMES) + 'end_header\n'
    # f_rest: all of the first channel, then the second, then the third.
    rest = scene['harmonics'][:, 1:].transpose(0, 2, 1).reshape(-1, 45)
    columns = [scene['mean'], scene['harmonics'][:, 0], rest, scene['logit'][:, None], scene['log_scale'], scene['rotation']]
    path.write_bytes(header.encode() + np.concatenate(columns, 1).astype('<f4').tobytes())


def read_ply(path):
    head, body = path.read_bytes().split(b'end_header\n', 1)
    names = [line.split()[-1].decode() for line in head.splitlines() if line.startswith(b'property float')]
    values = np.frombuffer(body, '<f4').reshape(-1, len(names)).astype(float)
    column = lambda *wanted: np.stack([values[:, names.index(name)] for name in wanted], -1)
    rest = sum(name.startswith('f_rest') for name in names) // 3
    harmonics = np.zeros((len(values), 16, 3))
    harmonics[:, 0] = column('f_dc_0', 'f_dc_1', 'f_dc_2')
    for channel in range(3):
        for k in range(rest):
            harmonics[:, 1 + k, channel] = column(f'f_rest_{channel * rest + k}')[:, 0]
    return dict(mean=column('x', 'y', 'z'), harmonics=harmonics, logit=column('opacity')[:, 0],
                log_scale=column('scale_0', 'scale_1', 'scale_2'), rotation=column('rot_0', 'rot_1', 'rot_2', 'rot_3'))


def scene(random, mean, log_scale, most=0.97):
    count = len(mean)
    harmonics = np.concatenate([random.uniform(-1.5, 1.5, (count, 1, 3)), random.normal(0, 0.25, (count, 15, 3))], 1)
    opacity = random.uniform(0.02, most, count)
    made = dict(mean=mean, log_scale=log_scale, harmonics=harmonics, logit=np.log(opacity / (1 - opacity)), rotation=random.normal(size=(count, 4)))
    # As stored in the file.
    return {name: values.astype(np.float32).astype(float) for name, values in made.items()}


def scenes():
    """Name, scene, camera."""
    random = np.random.default_rng(25)
    ahead = dict(width=160, height=120, fx=150.0, fy=145.0, cx=83.0, cy=57.5, pose=np.eye(4))
    inside = lambda count, near, far: np.stack([*random.uniform(-1.2, 1.2, (2, count)), np.ones(count)], 1) * random.uniform(near, far, (count, 1))
    needles = random.uniform(-2.0, 0.5, (1200, 1)) + np.array([[0.0, -6.0, -7.0]])
    yield 'needles', scene(random, inside(1200, 1, 6), needles), ahead
    yield 'huge', scene(random, inside(150, 0.5, 8), random.uniform(-1, 3, (150, 3)), 0.3), ahead
    near = np.stack([*random.uniform(-2, 2, (2, 900)), random.uniform(-0.5, 0.8, 900)], 1)
    yield 'behind and through the near plane', scene(random, near, random.uniform(-6, -2, (900, 3))), ahead
    turned = np.eye(4)
    a, b = 0.5, -0.3
    turned[:3, :3] = (np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
                      @ np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]]))
    turned[:3, 3] = [-2.0, -1.2, -3.5]
    cloud = random.normal(0, 0.8, (2500, 3))
    yield 'degree 3', scene(random, cloud, random.uniform(-5.5, -2, (2500, 3))), {**ahead, 'pose': turned}
    for camera in json.loads((ROOT / 'examples/golden/cameras.json').read_text()):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = camera['rotation'], camera['position']
        wide, high = camera['width'], camera['height']
        lighthouse = dict(width=wide, height=high, fx=camera['fx'], fy=camera['fy'], cx=wide / 2, cy=high / 2, pose=pose)
        yield f'lighthouse, {camera["img_name"]}', read_ply(ROOT / 'examples/golden/lighthouse.ply'), lighthouse


def reference(scene, camera, antialias):
    width, height = camera['width'], camera['height']
    mean, pose = torch.tensor(scene['mean']), camera['pose']
    covariance, _ = gsplat._quat_scale_to_covar_preci(torch.tensor(scene['rotation']), torch.tensor(np.exp(scene['log_scale'])), compute_preci=False)
    k = torch.tensor([[camera['fx'], 0, camera['cx']], [0, camera['fy'], camera['cy']], [0, 0, 1]])
    with np.errstate(all='ignore'):
        radii, centre, depth, conic, lowered = gsplat._fully_fused_projection(
            mean, covariance, torch.tensor(np.linalg.inv(pose))[None], k[None], width, height, near_plane=NEAR, calc_compensations=True)
    colour = gsplat._spherical_harmonics(3, mean - torch.tensor(pose[:3, 3]), torch.tensor(scene['harmonics']))
    colour = np.maximum(colour + 0.5, 0)
    opacity = 1 / (1 + np.exp(-scene['logit']))
    if antialias:
        opacity = opacity * lowered[0]
    radii, centre, depth, conic = radii[0], centre[0], depth[0], conic[0]

    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    left, done = np.ones((height, width)), np.zeros((height, width), bool)
    pixels, drawn = [], []
    for i in np.argsort(depth, kind='stable'):
        if not (radii[i] > 0).all():
            continue
        x, y = columns - centre[i, 0], rows - centre[i, 1]
        sigma = 0.5 * (conic[i, 0] * x * x + conic[i, 2] * y * y) + conic[i, 1] * x * y
        alpha = np.minimum(0.999, opacity[i] * np.exp(-sigma))
        met = (sigma >= 0) & (alpha >= 1 / 255) & ~done
        ended = met & (left * (1 - alpha) <= 1e-4)
        done |= ended
        met &= ~ended
        left[met] *= 1 - alpha[met]
        pixels.append(np.flatnonzero(met))
        drawn.append(np.full(len(pixels[-1]), i))
    pixels, drawn = np.concatenate(pixels), np.concatenate(drawn)
    order = np.argsort(pixels, kind='stable')
    pixels, drawn = pixels[order], drawn[order]
    rgb, alpha = gsplat.accumulate(centre[None], conic[None], torch.tensor(opacity)[None], torch.tensor(colour)[None],
                                   drawn, pixels, np.zeros(len(pixels), int), width, height)
    return np.asarray(rgb[0] + (1 - alpha[0]) * BACKGROUND)


def ours(folder, scene, camera, antialias):
    write_ply(folder / 'scene.ply', scene)
    # Our own JSON counts pixels from the middle of the first.
    (folder / 'camera.json').write_text(json.dumps({
        'type': 'pinhole', 'camera_to_world': camera['pose'].tolist(), 'size': [camera['width'], camera['height']],
        'fx': camera['fx'], 'fy': camera['fy'], 'cx': camera['cx'] - 0.5, 'cy': camera['cy'] - 0.5}))
    out = folder / 'image.exr'
    words = [PROGRAM, 'render', folder / 'scene.ply', '--camera', folder / 'camera.json', '--size', f'{camera["width"]}x{camera["height"]}',
             '--background', str(BACKGROUND), '--quiet', '-o', out] + ['--antialias'] * antialias
    done = subprocess.run(list(map(str, words)), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    with OpenEXR.File(str(out), separate_channels=True) as file:
        colour = {part.header['name']: part for part in file.parts}['colour'].channels
        return np.stack([colour[c].pixels for c in 'RGB'], -1).astype(float)


def main():
    failed = False
    with tempfile.TemporaryDirectory(prefix='streamsplat-reference-') as folder:
        for name, made, camera in scenes():
            for antialias in (False, True):
                expected = reference(made, camera, antialias)
                found = ours(Path(folder), made, camera, antialias)
                assert expected.std() > 0.01, f'{name}: the image is flat'
                apart = np.abs(found - expected)
                psnr = -10 * np.log10(max(np.mean(apart ** 2), 1e-30))
                largest = 255 * apart.max()
                passed = psnr >= 50 and largest <= 3
                failed |= not passed
                print(f'{name:40} {"antialiased" if antialias else "":12} {psnr:6.1f} dB, largest difference {largest:.4f}/255'
                      + ('' if passed else '   FAILED: expected at least 50 dB and at most 3/255'))
    sys.exit(failed)


if __name__ == '__main__':
    main()
