"""gsplat's `rasterization` on CPUs, for NumPy arrays and for PyTorch's tensors with gradients."""

from __future__ import annotations

import math
import sys
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ._streamsplat import View, harmonics, harmonics_gradients

_Floats = NDArray[np.float32]
_Views = list[list[View]]
# Means, quaternions, scales, opacities.
_Gaussians = tuple[_Floats, _Floats, _Floats, _Floats]

MODES = ("RGB", "D", "ED", "RGB+D", "RGB+ED")
MOST_GAUSSIANS = 1 << 24
MOST_CHANNELS = 1 << 10
_NONE = np.empty(0, np.float32)


class Meta(dict[str, Any]):
    """The content of gsplat's third result, except the lists of its tiles."""

    ABSENT = ("tiles_per_gauss", "isect_ids", "flatten_ids", "isect_offsets")

    def __missing__(self, key: str) -> Any:
        if key in self.ABSENT:
            raise KeyError(f"{key}: this rasteriser's tiles and lists are its own and no part of the result")
        raise KeyError(key)


def _torch(*arrays: object) -> Any:
    """Returns PyTorch if one of the arrays is a tensor, else None."""
    torch = sys.modules.get("torch")
    return torch if torch is not None and any(torch.is_tensor(a) for a in arrays) else None


def _checked(torch: Any, name: str, array: Any, shape: tuple[int | None, ...]) -> None:
    """Raises an error unless `array` is float32, of this shape, and on the CPU; `None` means any length."""
    kind = "a torch tensor" if torch else "a NumPy array"
    if not (torch.is_tensor(array) if torch else isinstance(array, np.ndarray)):
        raise TypeError(f"{name}: expected {kind} as means is, found {type(array).__name__}")
    if torch and array.device.type != "cpu":
        raise ValueError(f"{name}: expected a tensor on the CPU, found one on {array.device} ({name}.cpu() is one)")
    if array.dtype != (torch.float32 if torch else np.float32):
        fix = f"{name}.float()" if torch else f"{name}.astype('float32')"
        raise TypeError(f"{name}: expected float32, found {array.dtype} ({fix} is that)")
    found = tuple(array.shape)
    if len(found) != len(shape) or any(s is not None and s != f for s, f in zip(shape, found)):
        text = ", ".join("…" if s is None else str(s) for s in shape)
        raise ValueError(f"{name}: expected the shape [{text}], found {list(found)}")


def _plain(array: Any) -> _Floats:
    """Returns the array itself if contiguous, else a copy."""
    return np.ascontiguousarray(array)


def _stacked(parts: list[NDArray[Any]]) -> NDArray[Any]:
    return parts[0][None] if len(parts) == 1 else np.stack(parts)


def _rows(parts: list[list[NDArray[Any]]]) -> NDArray[Any]:
    return _stacked([_stacked(row) for row in parts])


def _project(options: tuple[Any, ...], gaussians: _Gaussians, viewmats: _Floats, ks: _Floats) -> tuple[_Views, list[NDArray[Any]]]:
    """Returns views [B][C], and their centres, depths, conics, opacities, radii and eyes [B, C, …]."""
    means, quats, scales, opacities = gaussians
    views = [
        [View(means[b], quats[b], scales[b], opacities[b], _plain(viewmats[b, c]), _plain(ks[b, c]), *options) for c in range(viewmats.shape[1])]
        for b in range(len(means))
    ]
    found = [[view.projected() for view in row] for row in views]
    return views, [_rows([[one[field] for one in row] for row in found]) for field in range(6)]


def _project_gradients(
    views: _Views, gaussians: _Gaussians, footprints: _Floats, depths: _Floats | None, eyes: _Floats | None
) -> list[_Floats]:
    """Computes gradients by means, quaternions, scales, opacities and view matrices; a batch's cameras are added in order."""
    means, quats, scales, opacities = gaussians
    out: list[list[_Floats]] = [[], [], [], [], []]
    for b, row in enumerate(views):
        sums: list[_Floats] = []
        matrices = []
        for c, view in enumerate(row):
            of_depth = _NONE if depths is None else _plain(depths[b, c])
            of_eye = [0.0, 0.0, 0.0] if eyes is None else [float(v) for v in eyes[b, c]]
            *found, matrix = view.gradients(means[b], quats[b], scales[b], opacities[b], _plain(footprints[b, c]), of_depth, of_eye)
            matrices.append(matrix)
            sums = [a + b for a, b in zip(sums, found)] if sums else found
        for to, part in zip(out, [*sums, _stacked(matrices)]):
            to.append(part)
    return [_stacked(parts) for parts in out]


def _draw(views: _Views, colors: _Floats, backgrounds: _Floats | None) -> tuple[_Floats, _Floats]:
    """Draws images [B, C, H, W, D] and alphas [B, C, H, W] in colours [B, C, N, D]."""
    drawn = [
        [view.draw(_plain(colors[b, c]), _NONE if backgrounds is None else _plain(backgrounds[b, c])) for c, view in enumerate(row)]
        for b, row in enumerate(views)
    ]
    return _rows([[image for image, _ in row] for row in drawn]), _rows([[alpha for _, alpha in row] for row in drawn])


def _eye(eyes: _Floats, b: int, c: int) -> list[float]:
    return [float(v) for v in eyes[b, c]]


def _harmonics(degree: int, coefficients: _Floats, means: _Floats, eyes: _Floats) -> _Floats:
    """Computes colours [B, C, N, 3] from coefficients [B, C, N, K, 3]."""
    B, C = eyes.shape[:2]
    return _rows([[harmonics(_plain(coefficients[b, c]), degree, means[b], _eye(eyes, b, c)) for c in range(C)] for b in range(B)])


def _detached(tensor: Any) -> _Floats:
    return _plain(tensor.detach().numpy())


class _Project:
    """-> centres, depths, opacities, eyes, shapes (which carry a gradient but no value), conics, radii."""

    @staticmethod
    def forward(
        ctx: Any, torch: Any, holder: _Views, options: tuple[Any, ...], means: Any, quats: Any, scales: Any, opacities: Any, viewmats: Any, ks: Any
    ) -> Any:
        gaussians = _detached(means), _detached(quats), _detached(scales), _detached(opacities)
        views, found = _project(options, gaussians, viewmats.detach().numpy(), ks.detach().numpy())
        holder.extend(views)
        ctx.torch, ctx.views, ctx.gaussians = torch, views, gaussians
        centres, depths, conics, drawn, radii, eyes = map(torch.from_numpy, found)
        shapes = torch.zeros(*depths.shape, 3)
        ctx.mark_non_differentiable(conics, radii)
        ctx.set_materialize_grads(False)
        return centres, depths, drawn, eyes, shapes, conics, radii

    @staticmethod
    def backward(ctx: Any, centres: Any, depths: Any, drawn: Any, eyes: Any, shapes: Any, *_: Any) -> Any:
        count = ctx.gaussians[0].shape[1]
        of = np.zeros((len(ctx.views), len(ctx.views[0]), count, 6), np.float32)
        for place, gradient in ((slice(0, 2), centres), (slice(2, 5), shapes), (5, drawn)):
            if gradient is not None:
                of[..., place] = gradient.numpy()
        found = _project_gradients(
            ctx.views, ctx.gaussians, of, None if depths is None else depths.numpy(), None if eyes is None else eyes.numpy()
        )
        return None, None, None, *map(ctx.torch.from_numpy, found), None


class _Harmonics:
    """Coefficients [B, C, N, K, 3], means and eyes -> colours [B, C, N, 3]."""

    @staticmethod
    def forward(ctx: Any, torch: Any, degree: int, coefficients: Any, means: Any, eyes: Any) -> Any:
        ctx.torch, ctx.degree, ctx.arrays = torch, degree, (coefficients.detach().numpy(), _detached(means), _detached(eyes))
        ctx.colors = _harmonics(degree, *ctx.arrays)
        return torch.from_numpy(ctx.colors)

    @staticmethod
    def backward(ctx: Any, of: Any) -> Any:
        coefficients, means, eyes = ctx.arrays
        of, (B, C) = _plain(of.numpy()), eyes.shape[:2]
        found = [
            [
                harmonics_gradients(_plain(coefficients[b, c]), ctx.degree, means[b], _eye(eyes, b, c), _plain(ctx.colors[b, c]), of[b, c])
                for c in range(C)
            ]
            for b in range(B)
        ]
        of_means = []
        for row in found:
            total = row[0][1]
            for one in row[1:]:
                total = total + one[1]
            of_means.append(total)
        of_eyes = np.array([[one[2] for one in row] for row in found], np.float32)
        arrays = _rows([[one[0] for one in row] for row in found]), _stacked(of_means), of_eyes
        return None, None, *map(ctx.torch.from_numpy, arrays)


class _Draw:
    """Centres, shapes, opacities, colours and backgrounds of views -> images and alphas."""

    @staticmethod
    def forward(ctx: Any, torch: Any, views: _Views, centres: Any, shapes: Any, opacities: Any, colors: Any, backgrounds: Any) -> Any:
        behind = None if backgrounds is None else backgrounds.detach().numpy()
        ctx.torch, ctx.views, ctx.arrays = torch, views, (colors.detach().numpy(), behind)
        images, alphas = map(torch.from_numpy, _draw(views, *ctx.arrays))
        ctx.save_for_backward(images, alphas)
        return images, alphas

    @staticmethod
    def backward(ctx: Any, of_images: Any, of_alphas: Any) -> Any:
        (colors, backgrounds), (images, alphas) = ctx.arrays, (t.numpy() for t in ctx.saved_tensors)
        of_images, of_alphas = _plain(of_images.numpy()), _plain(of_alphas.numpy())
        found = [
            [
                view.draw_gradients(
                    _plain(colors[b, c]),
                    _NONE if backgrounds is None else _plain(backgrounds[b, c]),
                    images[b, c],
                    alphas[b, c],
                    of_images[b, c],
                    of_alphas[b, c],
                )
                for c, view in enumerate(row)
            ]
            for b, row in enumerate(ctx.views)
        ]
        of = [ctx.torch.from_numpy(_rows([[one[field] for one in row] for row in found])) for field in range(3)]
        return None, None, of[0][..., :2], of[0][..., 2:5], of[0][..., 5], of[1], None if backgrounds is None else of[2]


_functions: Any = None


def _autograd(torch: Any) -> Any:
    """Returns the three differentiable steps as PyTorch's functions, created on first use."""
    global _functions
    if _functions is None:
        _functions = [type(step.__name__, (step, torch.autograd.Function), {}) for step in (_Project, _Harmonics, _Draw)]
    return _functions


def _shown(radii: NDArray[np.int32]) -> tuple[NDArray[np.int64], tuple[NDArray[np.int64], ...]]:
    """Returns the visible Gaussians: indices in the flattened array, and batch, camera and Gaussian of each."""
    places = np.flatnonzero(radii[..., 0])
    return places, np.unravel_index(places, radii.shape[:-1])


def _drawn(_: Any, batch: tuple[int, ...], options: tuple[Any, ...], arguments: list[Any], degree: int | None, per_camera: bool, mode: str, packed: bool) -> Any:
    """Returns images and alphas [B, C, H, W, …], the fields of the projection, and the ids of the visible Gaussians, as NumPy arrays."""
    means, quats, scales, opacities, colors, viewmats, ks, backgrounds = arguments
    gaussians = _plain(means), _plain(quats), _plain(scales), _plain(opacities)
    views, (centres, depths, conics, drawn, radii, eyes) = _project(options, gaussians, viewmats, ks)
    fields, ids = {"radii": radii, "means2d": centres, "depths": depths, "conics": conics, "opacities": drawn}, None
    if packed:
        places, ids = _shown(radii)
        fields = {name: field.reshape(-1, *field.shape[3:])[places] for name, field in fields.items()}
    else:
        fields = {name: field.reshape((*batch, *field.shape[1:])) for name, field in fields.items()}
    wanted: Any = None
    behind: Any = None
    if "RGB" in mode:
        B, C = len(means), len(views[0])
        wanted = colors if per_camera else np.broadcast_to(colors[:, None], (B, C, *colors.shape[1:]))
        wanted = wanted if degree is None else _harmonics(degree, wanted, gaussians[0], eyes)
        behind = backgrounds
    if mode != "RGB":
        wanted = depths[..., None] if wanted is None else np.concatenate([wanted, depths[..., None]], -1)
        behind = None if behind is None else np.concatenate([behind, np.zeros_like(behind[..., :1])], -1)
    images, alphas = _draw(views, wanted, behind)
    alphas = alphas[..., None]
    if "ED" in mode:
        images[..., -1:] /= np.maximum(alphas, np.float32(1e-10))
    return images, alphas, fields, ids


def _differentiable(torch: Any, batch: tuple[int, ...], options: tuple[Any, ...], arguments: list[Any], degree: int | None, per_camera: bool, mode: str, packed: bool) -> Any:
    """Draws as `_drawn` does, for tensors with gradients."""
    means, quats, scales, opacities, colors, viewmats, ks, backgrounds = arguments
    Project, Harmonics, Draw = _autograd(torch)
    views: _Views = []
    centres, depths, drawn, eyes, shapes, conics, radii = Project.apply(torch, views, options, means, quats, scales, opacities, viewmats, ks)
    fields, ids, behind = {"radii": radii, "means2d": centres, "depths": depths, "conics": conics, "opacities": drawn}, None, None
    if packed:
        places, ids = _shown(radii.numpy())
        index = torch.from_numpy(places)
        fields = {name: field.reshape(-1, *field.shape[3:]).index_select(0, index) for name, field in fields.items()}
        if centres.requires_grad:
            # The image is computed from the packed centres, so that they have a gradient.
            centres = torch.zeros_like(centres).reshape(-1, 2).index_copy(0, index, fields["means2d"]).reshape(centres.shape)
    else:
        # As above, with the shape that the caller sees.
        fields = {name: field.reshape((*batch, *field.shape[1:])) for name, field in fields.items()}
        centres = fields["means2d"].reshape(centres.shape)
    wanted = None
    if "RGB" in mode:
        wanted = colors if per_camera else colors[:, None].expand(-1, len(views[0]), *colors.shape[1:])
        wanted = wanted if degree is None else Harmonics.apply(torch, degree, wanted, means, eyes)
        behind = backgrounds
    if mode != "RGB":
        wanted = depths[..., None] if wanted is None else torch.cat([wanted, depths[..., None]], -1)
        behind = None if behind is None else torch.cat([behind, torch.zeros_like(behind[..., :1])], -1)
    images, alphas = Draw.apply(torch, views, centres, shapes, drawn, wanted, behind)
    alphas = alphas[..., None]
    if "ED" in mode:
        images = torch.cat([images[..., :-1], images[..., -1:] / alphas.clamp(min=1e-10)], -1)
    return images, alphas, fields, ids


def _refused(**arguments: tuple[object, object]) -> None:
    """Raises an error for arguments with a value other than the supported one."""
    for name, (value, only) in arguments.items():
        if value is not only and (only is None or value != only):
            raise NotImplementedError(f"{name}: expected {only}, found {value!r}, which this rasteriser does not support")


def rasterization(
    means: Any,
    quats: Any,
    scales: Any,
    opacities: Any,
    colors: Any,
    viewmats: Any,
    Ks: Any,
    width: int,
    height: int,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    eps2d: float = 0.3,
    sh_degree: int | None = None,
    packed: bool = True,
    tile_size: int = 16,
    backgrounds: Any = None,
    render_mode: Literal["RGB", "D", "ED", "RGB+D", "RGB+ED"] = "RGB",
    sparse_grad: bool = False,
    absgrad: bool = False,
    rasterize_mode: Literal["classic", "antialiased"] = "classic",
    channel_chunk: int = 32,
    distributed: bool = False,
    camera_model: Literal["pinhole", "ortho"] = "pinhole",
    segmented: bool = False,
    covars: Any = None,
    with_ut: bool = False,
    with_eval3d: bool = False,
    radial_coeffs: Any = None,
    tangential_coeffs: Any = None,
    thin_prism_coeffs: Any = None,
    ftheta_coeffs: Any = None,
    rolling_shutter: Any = None,
    viewmats_rs: Any = None,
) -> tuple[Any, Any, Meta]:
    """Draws Gaussians by gsplat 1.5.3's conventions, with the same bits on every CPU.

    Arrays are float32, all NumPy's or all PyTorch's on the CPU, and are read in place; the results are of the same kind. With PyTorch they have
    gradients by means, quats, scales, opacities, colors, backgrounds and viewmats.

    means [..., N, 3], quats [..., N, 4] (w first, of any length), scales [..., N, 3], opacities [..., N]; colors [..., N, D] or [..., C, N, D], or with
    `sh_degree` (0 to 3) [..., N, K, 3] or [..., C, N, K, 3]; viewmats [..., C, 4, 4] (world to camera), Ks [..., C, 3, 3];
    backgrounds [..., C, D].

    Returns images [..., C, height, width, X], alphas [..., C, height, width, 1] and a dictionary with batch_ids, camera_ids, gaussian_ids, radii, means2d,
    depths, conics, opacities, width, height, tile_width, tile_height, tile_size, n_batches and n_cameras: for the visible Gaussians if `packed`, else
    [..., C, N, …]. X: D, 1 (D, ED) or D + 1. Lists of tiles are absent. `tile_size`, `channel_chunk` and `segmented` change no result.

    Raises ValueError and TypeError for arrays that cannot be drawn, NotImplementedError for arguments that are not supported.
    """
    torch = _torch(means, quats, scales, opacities, colors, viewmats, Ks)
    _refused(
        sparse_grad=(bool(sparse_grad), False), absgrad=(bool(absgrad), False), distributed=(bool(distributed), False),
        with_ut=(bool(with_ut), False), with_eval3d=(bool(with_eval3d), False), covars=(covars, None),
        radial_coeffs=(radial_coeffs, None), tangential_coeffs=(tangential_coeffs, None), thin_prism_coeffs=(thin_prism_coeffs, None),
        ftheta_coeffs=(ftheta_coeffs, None), viewmats_rs=(viewmats_rs, None),
    )
    if rolling_shutter is not None and getattr(rolling_shutter, "name", rolling_shutter) != "GLOBAL":
        raise NotImplementedError(f"rolling_shutter: expected GLOBAL, found {rolling_shutter}, which this rasteriser does not support")
    if camera_model not in ("pinhole", "ortho"):
        raise NotImplementedError(f"camera_model: expected pinhole or ortho, found {camera_model}")
    if render_mode not in MODES:
        raise ValueError(f"render_mode: expected one of {', '.join(MODES)}, found {render_mode}")
    if rasterize_mode not in ("classic", "antialiased"):
        raise ValueError(f"rasterize_mode: expected classic or antialiased, found {rasterize_mode}")
    if sh_degree is not None and not 0 <= sh_degree <= 3:
        raise NotImplementedError(f"sh_degree: expected 0 to 3, found {sh_degree}")
    if tile_size < 1:
        raise ValueError(f"tile_size: expected 1 or more, found {tile_size}")

    _checked(torch, "means", means, tuple(getattr(means, "shape", ()))[:-1] + (3,) if getattr(means, "ndim", 0) >= 2 else (None, 3))
    batch, N = tuple(means.shape[:-2]), means.shape[-2]
    B = math.prod(batch)
    _checked(torch, "viewmats", viewmats, (*batch, None, 4, 4))
    C = viewmats.shape[-3]
    for name, number in (("means", N), ("viewmats", C), ("batches", B)):
        if number < 1:
            raise ValueError(f"{name}: expected at least one, found none")
    if N > MOST_GAUSSIANS:
        raise ValueError(f"means: expected at most {MOST_GAUSSIANS} Gaussians, found {N}")
    _checked(torch, "quats", quats, (*batch, N, 4))
    _checked(torch, "scales", scales, (*batch, N, 3))
    _checked(torch, "opacities", opacities, (*batch, N))
    _checked(torch, "Ks", Ks, (*batch, C, 3, 3))
    last = (None,) if sh_degree is None else (None, 3)
    per_camera = getattr(colors, "ndim", 0) == len(batch) + 2 + len(last)
    _checked(torch, "colors", colors, (*batch, *((C,) if per_camera else ()), N, *last))
    if sh_degree is not None and colors.shape[-2] < (sh_degree + 1) ** 2:
        raise ValueError(f"colors: expected at least {(sh_degree + 1) ** 2} coefficients for degree {sh_degree}, found {colors.shape[-2]}")
    D = 3 if sh_degree is not None else colors.shape[-1]
    if not 1 <= D < MOST_CHANNELS:
        raise ValueError(f"colors: expected 1 to {MOST_CHANNELS - 1} channels, found {D}")
    if backgrounds is not None:
        _checked(torch, "backgrounds", backgrounds, (*batch, C, D))
    for name, array in (("colors", colors), ("backgrounds", backgrounds)):
        if array is not None and not np.isfinite(array.detach().numpy() if torch else array).all():
            raise ValueError(f"{name}: expected finite numbers, found NaN or infinity")

    options = (width, height, near_plane, far_plane, radius_clip, eps2d, rasterize_mode == "antialiased", camera_model == "ortho")
    arguments = [a if a is None else a.reshape((B, *a.shape[len(batch):])) for a in (means, quats, scales, opacities, colors, viewmats, Ks, backgrounds)]
    differentiable = torch and torch.is_grad_enabled() and any(a is not None and a.requires_grad for a in arguments)
    call = _differentiable if differentiable else _drawn
    if torch and not differentiable:
        arguments = [a if a is None else a.detach().numpy() for a in arguments]
    images, alphas, fields, ids = call(torch, batch, options, arguments, sh_degree, per_camera, render_mode, packed)
    if torch and not differentiable:
        images, alphas = map(torch.from_numpy, (images, alphas))
        fields = {name: torch.from_numpy(field) for name, field in fields.items()}
    if ids is None:
        ids = [None, None, None]
    elif torch:
        ids = [torch.from_numpy(i) for i in ids]
    meta = Meta(zip(("batch_ids", "camera_ids", "gaussian_ids"), ids))
    meta |= fields
    meta |= {
        "tile_width": math.ceil(width / tile_size), "tile_height": math.ceil(height / tile_size), "width": width, "height": height,
        "tile_size": tile_size, "n_batches": B, "n_cameras": C,
    }
    return images.reshape((*batch, *images.shape[1:])), alphas.reshape((*batch, *alphas.shape[1:])), meta
