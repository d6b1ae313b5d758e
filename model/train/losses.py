"""Losses. Images are [.., 3, H, W] in [0, 1]."""
import torch
import torch.nn.functional as F


def log_error(image, truth, floor=1e-4):
    """Mean over images of log(MSE + floor). The reported figure is a mean of PSNRs, so every image has equal weight.

    Under `floor` (40 dB) an image is good enough and its gradient vanishes."""
    return torch.log((image - truth).pow(2).mean((-3, -2, -1)) + floor).mean()


FITTED_FLOOR = 1e-5    # of `log_error` for pictures of fitted colours (50 dB)


def psnr(image, truth):
    return -10 * torch.log10((image - truth).pow(2).mean((-3, -2, -1)) + 1e-10)


def gradient_l1(image, truth):
    d = image - truth
    return (d[..., 1:] - d[..., :-1]).abs().mean() + (d[..., 1:, :] - d[..., :-1, :]).abs().mean()


LOCAL = 4.0    # cells of the splat grid: the largest scale of a Gaussian


def kept_local(g, splat_grid, weight=20.0):
    """(Gaussians whose scales end at LOCAL cells, the loss weight * mean log(1 + max(0, scale / limit - 1)) of the scales as they were).

    Depths are equal while the static half trains, so array order decides what is in front. Without a limit the last row grows into an opaque backdrop, which
    all others hide and which covers the scene from any other camera. The picture uses the limited scales, so passing the limit gains nothing; the loss brings
    larger scales back."""
    most = LOCAL * 2 / splat_grid[1]
    excess = F.relu(g['scale'] / most - 1)
    return dict(g, scale=g['scale'].clamp(max=most)), weight * torch.log1p(excess).mean()


def splat_flow(flow, sure, splat_grid):
    """Pixel flow [B,2,2,H,W] -> velocity target (x, z) [2B,N,2] in world units per interval on the splat grid, and its weight [2B,N].

    Frame 1 is at the interval's end, so its velocity points the other way."""
    h, w = flow.shape[-2:]
    k = h // splat_grid[0]
    v = F.avg_pool2d(flow.flatten(0, 1), k).flatten(2).transpose(1, 2) * flow.new_tensor([2 / w, -2 / h])
    v = v.unflatten(0, (-1, 2)) * flow.new_tensor([1.0, -1.0]).view(1, 2, 1, 1)
    return v.flatten(0, 1), (F.avg_pool2d(sure.flatten(0, 1)[:, None], k).flatten(1) > 0.99).to(flow)


def end_point_error(velocity, target, weight, size, limit=60.0):
    """Mean robust distance in pixels where the teacher is sure and within `limit`; and the same of no motion."""
    px = velocity.new_tensor([size[1] / 2, size[0] / 2])
    error = ((velocity[..., [0, 2]] - target) * px).pow(2).sum(-1).add(0.01).sqrt()
    reach = (target * px).norm(dim=-1)
    w = weight * (reach < limit)
    return (error * w).sum() / (w.sum() + 1), (reach * w).sum() / (w.sum() + 1)
