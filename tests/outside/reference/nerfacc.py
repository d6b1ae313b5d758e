"""The two sums over the samples of rays that gsplat's `accumulate` takes from nerfacc; samples of a ray follow each other, front to back."""
import numpy as np


def render_weight_from_alpha(alphas, ray_indices, n_rays):
    """α·T of every sample, T the product of 1 − α of those before it on its ray."""
    weights = np.empty_like(alphas)
    starts = np.flatnonzero(np.diff(ray_indices, prepend=-1))
    for start, end in zip(starts, [*starts[1:], len(alphas)]):
        own = alphas[start:end]
        weights[start:end] = own * np.concatenate([[1.0], np.cumprod(1.0 - own)[:-1]])
    return weights, None


def accumulate_along_rays(weights, values, ray_indices, n_rays):
    values = np.ones((len(weights), 1)) if values is None else values
    return np.stack([np.bincount(ray_indices, weights * channel, n_rays) for channel in values.T], -1)
