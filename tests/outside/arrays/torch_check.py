"""PyTorch and gsplat's formulas accept the arrays: torch_check.py SCENE GSPLAT"""

import importlib.util
import sys
import warnings
from pathlib import Path

import numpy as np
import torch
from scene import scenes

import streamsplat_cpu

spec = importlib.util.spec_from_file_location('gsplat_formulas', Path(sys.argv[2]) / 'gsplat/cuda/_torch_impl.py')
gsplat = importlib.util.module_from_spec(spec)
spec.loader.exec_module(gsplat)


def shared(splats):
    """Tensors through DLPack show the arrays' own memory, without a copy and without a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        for name in ('means', 'quats', 'scales', 'opacities', 'colors', 'sh'):
            array = getattr(splats, name)
            tensor = torch.from_dlpack(array)
            assert tensor.data_ptr() == array.ctypes.data and tensor.dtype == torch.float32 and tuple(tensor.shape) == array.shape, name
        torch.from_numpy(splats.means.copy())
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter('always')
        assert torch.from_numpy(splats.means).data_ptr() == splats.means.ctypes.data
    # torch has no read-only tensors, and warns once per process.
    shared.warnings += [str(warning.message) for warning in warned]
    # Tensors are accepted; for those that NumPy cannot read the error is torch's message with the argument's name.
    again = streamsplat_cpu.Splats(*(torch.from_dlpack(x) for x in (splats.means, splats.scales, splats.opacities)),
                                   quats=torch.from_dlpack(splats.quats), sh=torch.from_dlpack(splats.sh))
    assert np.array_equal(again.sh, splats.sh) and np.array_equal(again.means, splats.means)
    for wrong, text in ((torch.zeros(1, 3, device='meta'), 'meta'), (torch.zeros(1, 3, requires_grad=True), 'detach()')):
        try:
            streamsplat_cpu.Splats(wrong, wrong, [0.5], colors=wrong)
        except TypeError as error:
            assert str(error).startswith('means: ') and text in str(error), error
        else:
            raise AssertionError(f'{wrong} was taken')


shared.warnings = []


def formulas(splats):
    """gsplat's covariances are ours, and a Gaussian alone is drawn where its projection puts it, in the colour of its harmonics."""
    covariances, _ = gsplat._quat_scale_to_covar_preci(torch.from_dlpack(splats.quats), torch.from_dlpack(splats.scales), compute_preci=False)
    np.testing.assert_allclose(covariances, splats.covariances, atol=1e-6)
    width, height = 320, 180
    camera = streamsplat_cpu.Camera.look_at((0.4, -0.3, -3.5), (0, 0, 0.2), width=width, height=height)
    viewmat, K = torch.from_dlpack(camera.viewmat), torch.from_dlpack(camera.K)
    radii, centres, depths, _, _ = gsplat._fully_fused_projection(torch.from_dlpack(splats.means), covariances, viewmat[None], K[None], width, height)
    directions = torch.from_dlpack(splats.means) - torch.tensor(camera.position, dtype=torch.float32)
    colours = gsplat._spherical_harmonics(splats.sh_degree, directions, torch.from_dlpack(splats.sh)) + 0.5
    inside = (centres[0] > 40).all(-1) & (centres[0, :, 0] < width - 40) & (centres[0, :, 1] < height - 40) & (radii[0].amax(-1) < 30)
    chosen = torch.nonzero(inside & (depths[0] > 0))[:40, 0].tolist()
    assert len(chosen) == 40
    for i in chosen:
        one = [array[i:i + 1] for array in (splats.means, splats.scales)]
        alone = streamsplat_cpu.Splats(*one, [0.9], quats=splats.quats[i:i + 1], sh=splats.sh[i:i + 1])
        image = alone.render(camera, background=0.0, depth=True, alpha=True)
        weight = image.alpha.astype(float)
        rows, columns = np.mgrid[0.5:height, 0.5:width]
        centre = [(weight * columns).sum() / weight.sum(), (weight * rows).sum() / weight.sum()]
        np.testing.assert_allclose(centre, centres[0, i], atol=0.06)
        at = np.unravel_index(weight.argmax(), weight.shape)
        np.testing.assert_allclose(image.rgb[at] / weight[at], colours[i].clamp(min=0), atol=2e-5)
        np.testing.assert_allclose(image.depth[at] / weight[at], depths[0, i], rtol=1e-5)


for name, splats in scenes(Path(sys.argv[1])).items():
    shared(splats)
    formulas(splats)
    print(f'{name}: torch shares the memory of the arrays, gsplat projects them where they are drawn')
assert len(shared.warnings) == 1 and 'not writable' in shared.warnings[0], shared.warnings
