"""The two sums over the samples of rays that gsplat's `accumulate` takes from nerfacc, with gradients; samples of a ray follow each other, front to back."""
import torch


def render_weight_from_alpha(alphas, ray_indices, n_rays):
    """α·T of every sample and T, the product of 1 − α of those before it on its ray."""
    logs = torch.log1p(-alphas.double())
    before = torch.cumsum(logs, 0) - logs
    counts = torch.bincount(ray_indices, minlength=n_rays)
    counts = counts[counts > 0]
    starts = torch.cumsum(counts, 0) - counts
    trans = torch.exp(before - torch.repeat_interleave(before[starts], counts)).to(alphas.dtype)
    return alphas * trans, trans


def accumulate_along_rays(weights, values, ray_indices, n_rays):
    source = weights[:, None] if values is None else weights[:, None] * values
    return torch.zeros(n_rays, source.shape[-1], dtype=source.dtype).index_add(0, ray_indices, source)
