"""Checks of tests/outside/rasterization/run: check.py GSPLAT-FOLDER.

`streamsplat_cpu.rasterization` against gsplat's formulas on the same arrays in float64: images of 1,000 to 100,000 Gaussians, every mode, and the gradients of
a loss. gsplat selects a Gaussian's pixels like the formulas here, up to thresholds: an α next to 1/255 may be drawn by one and not by the other.
"""
import contextlib
import functools
import sys

import numpy as np
import streamsplat_cpu
import torch
from formulas import formulas

gsplat = formulas(sys.argv[1])
NAMES = ('means', 'quats', 'scales', 'opacities', 'colors', 'viewmats', 'backgrounds')
failed = False


def report(name, passed, text, expected):
    global failed
    failed |= not passed
    print(f'{name:66} {text}' + ('' if passed else f'   FAILED: expected {expected}'))


def turned(random, count, away):
    """Cameras that look at the origin from near `away`."""
    views = np.tile(np.eye(4), (count, 1, 1))
    for view in views:
        a, b = random.uniform(-0.4, 0.4, 2)
        x = [[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]]
        y = [[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]]
        view[:3, :3], view[:3, 3] = np.array(x) @ y, [0, 0, away]
    return views


def scene(seed, count, cameras=2, size=(160, 120), degree=None, channels=3, per_camera=False, ortho=False, log_scale=(-4.5, -2.5)):
    random = np.random.default_rng(seed)
    width, height = size
    k = np.array([[width * (0.3 if ortho else 1.0), 0, 0.52 * width], [0, width * (0.31 if ortho else 1.02), 0.49 * height], [0, 0, 1]])
    each = (cameras, count) if per_camera else (count,)
    shape = (*each, channels) if degree is None else (*each, (degree + 1) ** 2, 3)
    colors = random.uniform(0, 1, shape) if degree is None else random.normal(0, 0.3, shape)
    arrays = dict(
        means=random.normal(0, 0.8, (count, 3)), quats=random.normal(size=(count, 4)), scales=np.exp(random.uniform(*log_scale, (count, 3))),
        opacities=random.uniform(0.05, 0.98, count), colors=colors, viewmats=turned(random, cameras, 4.0), Ks=np.tile(k, (cameras, 1, 1)),
        backgrounds=random.uniform(0, 1, (cameras, channels if degree is None else 3)))
    # Rounded to float32.
    return {name: torch.tensor(values, dtype=torch.float32) for name, values in arrays.items()}, dict(width=width, height=height, sh_degree=degree)


@contextlib.contextmanager
def model(ortho):
    """gsplat's formulas with this camera model, which `_rasterization` does not pass on."""
    source = sys.modules['gsplat.cuda._torch_impl']
    whole = source._fully_fused_projection
    source._fully_fused_projection = functools.partial(whole, camera_model='ortho' if ortho else 'pinhole')
    try:
        yield
    finally:
        source._fully_fused_projection = whole


def theirs(arrays, words, ortho=False):
    torch.set_default_dtype(torch.float64)
    wide = {name: values.detach().double().requires_grad_(values.requires_grad) for name, values in arrays.items()}
    with model(ortho):
        found = gsplat._rasterization(**wide, **words)
    torch.set_default_dtype(torch.float32)
    return found, wide


def images():
    cases = [(1_000, dict(degree=3), {}), (10_000, dict(), dict(render_mode='RGB+ED')), (10_000, dict(channels=7, per_camera=True), dict(rasterize_mode='antialiased')),
             (10_000, dict(ortho=True), dict(render_mode='RGB+D')), (3_000, dict(degree=2, per_camera=True), dict(render_mode='D')),
             (3_000, dict(), dict(render_mode='ED', rasterize_mode='antialiased', near_plane=3.5, far_plane=4.5, eps2d=0.1)),
             (100_000, dict(cameras=1, size=(640, 360), log_scale=(-6, -3.8)), {})]
    for seed, (count, make, words) in enumerate(cases):
        arrays, size = scene(seed, count, **make)
        ortho = make.get('ortho', False)
        with torch.no_grad():
            (expected, alpha, meta), _ = theirs(arrays, size | words, ortho)
        numpy = {name: values.numpy() for name, values in arrays.items()}
        words_ours = size | words | dict(camera_model='ortho' if ortho else 'pinhole')
        found, found_alpha, found_meta = streamsplat_cpu.rasterization(**numpy, **words_ours, packed=False)
        tensors = streamsplat_cpu.rasterization(**arrays, **words_ours, packed=False)
        assert isinstance(found, np.ndarray) and np.array_equal(found, tensors[0].numpy()), 'NumPy and PyTorch differ'
        expected = expected.numpy()
        assert found.shape == expected.shape and found_alpha.shape == tuple(alpha.shape), (found.shape, expected.shape)
        assert expected.std() > 0.01, 'the image is flat'
        # Depth in the scene's units, from about 3 to 5, has the same bound relative to its range.
        scale = np.maximum(1.0, np.abs(expected).reshape(-1, expected.shape[-1]).max(0) / 5)
        apart = np.abs(found - expected) / scale
        if 'ED' in words.get('render_mode', ''):
            # Where hardly anything is drawn, few Gaussians determine depth.
            apart[..., -1] *= alpha.numpy()[..., 0] > 0.02
        psnr, largest = -10 * np.log10(max(np.mean(apart ** 2), 1e-30)), 255 * apart.max()
        name = f'{count} Gaussians, ' + ', '.join(f'{k} {v}' for k, v in (make | words).items())
        report(name, psnr >= 50 and largest <= 3, f'{psnr:6.1f} dB, largest difference {largest:.4f}/255', 'at least 50 dB and at most 3/255')
        both = (found_meta['radii'] > 0).all(-1) & (meta['radii'].numpy() > 0).all(-1)
        for field in ('means2d', 'depths', 'conics', 'opacities'):
            wanted, got = (np.broadcast_to(m, found_meta[field].shape)[both] for m in (meta[field].numpy(), found_meta[field]))
            assert np.allclose(got, wanted, rtol=1e-3, atol=1e-4), (field, np.abs(got - wanted).max())
        packed = streamsplat_cpu.rasterization(**numpy, **words_ours)[2]
        shown = (found_meta['radii'] > 0).all(-1)
        assert np.array_equal(packed['means2d'], found_meta['means2d'][shown]) and np.array_equal(packed['gaussian_ids'], np.nonzero(shown)[-1])


def gradients():
    cases = [(200, dict(), {}), (200, dict(degree=3), dict(render_mode='RGB+ED')), (100, dict(degree=1, per_camera=True), dict(rasterize_mode='antialiased')),
             (200, dict(channels=6, per_camera=True), dict(render_mode='RGB+D')), (200, dict(ortho=True), dict(rasterize_mode='antialiased')),
             (200, dict(), dict(render_mode='ED')), (2_000, dict(cameras=1), {})]
    for seed, (count, make, words) in enumerate(cases):
        arrays, size = scene(100 + seed, count, size=(80, 60), log_scale=(-3.5, -1.5), **make)
        for name in NAMES:
            arrays[name].requires_grad_(True)
        ortho = make.get('ortho', False)
        (expected, alpha, _), wide = theirs(arrays, size | words, ortho)
        found, found_alpha, meta = streamsplat_cpu.rasterization(**arrays, **size, **words, camera_model='ortho' if ortho else 'pinhole')
        meta['means2d'].retain_grad()
        weights = torch.from_numpy(np.random.default_rng(seed).normal(size=expected.shape))
        of_alpha = torch.from_numpy(np.random.default_rng(seed + 50).normal(size=alpha.shape))
        # Expected depth where something is drawn.
        weights = weights * (alpha.detach() > 0.02)
        ((expected * weights).sum() + (alpha * of_alpha).sum()).backward()
        ((found * weights.float()).sum() + (found_alpha * of_alpha.float()).sum()).backward()
        assert meta['means2d'].grad.shape == meta['means2d'].shape and meta['means2d'].grad.abs().sum() > 0
        errors = {}
        for name in NAMES:
            wanted, got = wide[name].grad, arrays[name].grad
            if wanted is None or not wanted.any():
                assert got is None or not got.any(), name
                continue
            if name == 'viewmats':
                # Their last rows are not part of a camera.
                wanted, got = wanted[:, :3], got[:, :3]
            errors[name] = float((got.double() - wanted).norm() / wanted.norm())
        name = f'gradients, {count} Gaussians, ' + ', '.join(f'{k} {v}' for k, v in (make | words).items())
        worst = max(errors, key=errors.get)
        report(name, errors[worst] < 1e-3, f'largest relative error {errors[worst]:.1e} ({worst})', 'less than 1e-3')


def details():
    arrays, size = scene(1, 10)
    numpy = {name: values.numpy() for name, values in arrays.items()}
    nan = numpy['means'].copy()
    nan[3, 1] = np.nan
    flat = numpy['viewmats'].copy()
    flat[0, 0] = flat[0, 1]
    cases = [
        (dict(means=nan), ValueError, 'means: expected finite numbers, found NaN at place 10'),
        (dict(means=numpy['means'][:0]), ValueError, 'means: expected at least one, found none'),
        (dict(quats=numpy['quats'][:3]), ValueError, 'quats: expected the shape [10, 4], found [3, 4]'),
        (dict(scales=numpy['scales'].astype(float)), TypeError, 'scales: expected float32, found float64'),
        (dict(opacities=arrays['opacities']), TypeError, 'expected a torch tensor'),
        (dict(viewmats=flat), ValueError, 'viewmats: expected a matrix with an inverse'),
        (dict(Ks=numpy['Ks'] * 0), ValueError, 'Ks: expected [[fx, 0, cx]'),
        (dict(backgrounds=numpy['backgrounds'][:, :1]), ValueError, 'backgrounds: expected the shape'),
        (dict(sh_degree=4), NotImplementedError, 'sh_degree: expected 0 to 3, found 4'),
        (dict(camera_model='fisheye'), NotImplementedError, 'camera_model: expected pinhole or ortho, found fisheye'),
        (dict(absgrad=True), NotImplementedError, 'absgrad: expected False'),
        (dict(covars=nan), NotImplementedError, 'covars: expected None'),
        (dict(render_mode='depth'), ValueError, 'render_mode: expected one of RGB'),
        (dict(width=0), ValueError, 'width: expected at least one, found none'),
        (dict(means=np.broadcast_to(numpy['means'][:1], ((1 << 24) + 1, 3))), ValueError, 'means: expected at most 16777216 Gaussians, found 16777217'),
    ]
    for change, kind, text in cases:
        try:
            streamsplat_cpu.rasterization(**(numpy | size | change))
        except kind as error:
            assert text in str(error), (text, str(error))
        else:
            raise AssertionError(f'{change} was taken')
    for packed in (True, False):
        wide = arrays | dict(means=arrays['means'].clone().requires_grad_(True))
        found, _, meta = streamsplat_cpu.rasterization(**wide, **size, packed=packed)
        meta['means2d'].retain_grad()
        found.sum().backward()
        assert meta['means2d'].grad.shape == meta['means2d'].shape and meta['means2d'].grad.any(), packed
    elsewhere = {name: values.to('meta') for name, values in arrays.items()}
    try:
        streamsplat_cpu.rasterization(**elsewhere, **size)
    except ValueError as error:
        assert 'means: expected a tensor on the CPU, found one on meta (means.cpu() is one)' in str(error), error
    else:
        raise AssertionError('a tensor elsewhere was taken')
    meta = streamsplat_cpu.rasterization(**numpy, **size)[2]
    try:
        meta['isect_ids']
    except KeyError as error:
        assert 'tiles and lists are its own' in str(error)
    else:
        raise AssertionError('lists of tiles are there')


if __name__ == '__main__':
    details()
    images()
    gradients()
    sys.exit(failed)
