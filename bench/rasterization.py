"""streamsplat_cpu.rasterization against gsplat's PyTorch formulas: rasterization.py GSPLAT-FOLDER [ROUNDS] [GAUSSIANS]

100,000 Gaussians with the statistics of trained scenes (fixtures/src/trained.rs, stated in pixels of this image) at 640×360, RGB, two threads. gsplat's
`_rasterization` runs unchanged (tests/outside/rasterization/formulas.py); the indices that it takes from CUDA are computed once and not timed. Runs alternate;
figures are medians of all rounds. Then follows the memory per further Gaussian and pixel, of this rasteriser alone.

The environment is that of tests/outside/rasterization/run.
"""
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

os.environ.setdefault('RAYON_NUM_THREADS', '2')
# Otherwise PyTorch's idle threads spin on the cores that others need.
os.environ.setdefault('OMP_WAIT_POLICY', 'passive')
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'tests/outside/rasterization'))

import numpy as np
import torch
from streamsplat_cpu import rasterization

torch.set_num_threads(2)


def scene(count, width, height):
    random = np.random.default_rng(6)
    focal = 1600 / 1920 * width
    z = np.exp(random.uniform(0, np.log(30), count))
    u, v = random.uniform(-0.6, 0.6, (2, count)) * [[width], [height]]
    scales = 1.5 * np.exp(0.8 * random.normal(size=(count, 3))) * z[:, None] / focal
    scales[:, 2] *= np.exp(-1.5)
    k = [[[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]]
    arrays = dict(means=np.stack([u * z / focal, v * z / focal, z], -1), quats=random.normal(size=(count, 4)), scales=scales,
                  opacities=1 / (1 + np.exp(-2 * random.normal(size=count))), colors=random.uniform(0, 1, (count, 3)), viewmats=np.eye(4)[None], Ks=k)
    return {name: torch.tensor(np.asarray(values), dtype=torch.float32) for name, values in arrays.items()} | dict(width=width, height=height)


def with_gradients(draw, arrays, weights):
    wide = {name: a.clone().requires_grad_(True) if name in ('means', 'quats', 'scales', 'opacities', 'colors') else a for name, a in arrays.items()}
    start = time.perf_counter()
    image = draw(**wide)[0]
    middle = time.perf_counter()
    (image * weights).sum().backward()
    return middle - start, time.perf_counter() - middle, [a.grad for a in wide.values() if torch.is_tensor(a) and a.grad is not None]


def timed(draw, arrays):
    with torch.no_grad():
        start = time.perf_counter()
        image = draw(**arrays)[0]
        return time.perf_counter() - start, image


def resident(field):
    return next(int(line.split()[1]) << 10 for line in open('/proc/self/status') if line.startswith(field))


def memory():
    """Peak bytes of a process that draws and differentiates once, above those before."""
    arrays = scene(*map(int, sys.argv[2:5]))
    # The peak counts from here on.
    Path('/proc/self/clear_refs').write_text('5')
    before = resident('VmRSS')
    with_gradients(rasterization, arrays, torch.ones(1, arrays['height'], arrays['width'], 3))
    print(resident('VmHWM') - before)


def main():
    from formulas import formulas, kept
    gsplat = formulas(sys.argv[1])
    rounds, count = (int(v) for v in (sys.argv[2:4] + ['5', '100000'][len(sys.argv[2:4]):]))
    arrays = scene(count, 640, 360)
    weights = torch.from_numpy(np.random.default_rng(1).normal(size=(1, 360, 640, 3)).astype(np.float32))
    kept['wanted'] = True
    _, expected = timed(gsplat._rasterization, arrays)
    _, found = timed(rasterization, arrays)
    apart = (found - expected).abs().max()
    assert apart < 3 / 255, f'images differ by {apart}'
    ours, theirs = ([], [], []), ([], [], [])
    for _ in range(rounds):
        for times, draw in ((ours, rasterization), (theirs, gsplat._rasterization)):
            times[0].append(timed(draw, arrays)[0])
            forward, backward, _ = with_gradients(draw, arrays, weights)
            times[1].append(forward + backward)
            times[2].append(backward)
    cpu = next((line.split(': ')[1].strip() for line in open('/proc/cpuinfo') if line.startswith('model name')), 'unknown')
    print(f'{cpu}, 2 threads, {count} Gaussians, 640×360, {len(kept["found"][0])} Gaussians on pixels, medians of {rounds} rounds, largest difference {255 * apart:.3f}/255')
    median = statistics.median
    for name, place in (('forward', 0), ('forward and backward', 1), ('backward', 2)):
        a, b = median(ours[place]), median(theirs[place])
        print(f'{name:22} {1e3 * a:9.1f} ms   gsplat {1e3 * b:9.1f} ms   {b / a:6.1f} times as fast')
    print(f'backward over forward  {median(ours[2]) / median(ours[0]):.2f}')
    for size in ((count, 640, 360), (2 * count, 640, 360), (4 * count, 640, 360), (count, 1280, 720)):
        done = subprocess.run([sys.executable, __file__, '--memory', *map(str, size)], capture_output=True, text=True, check=True)
        print(f'{size[0]} Gaussians, {size[1]}×{size[2]}: {int(done.stdout) / 2**20:.0f} MiB')


if __name__ == '__main__':
    memory() if sys.argv[1] == '--memory' else main()
