"""Puts the Gaussians of the frame that is nearer in time in front.

A pair draws both frames' Gaussians. With all of them at one depth and opacities that fade linearly, the middle of an interval is two half-transparent pictures
over each other. A half-transparent layer is also blurred: its splats stop hiding their neighbours. So nothing fades early. Instead the depth velocity, -s for
the first frame and +s for the second, puts the frame that is nearer in time in front. The other is visible only in the holes that motion opens. The head's tanh
saturates, so every Gaussian of a frame gets the same value. Their order is then the order of storage, which must not change: order noise among overlapping
neighbours costs 4 dB. `s` is small (0.002 of the inverse-depth range, by way of the checkpoint's `dynamic_scalar`): it orders the layers and moves nothing
visibly.
"""
import math

import torch

STEP = 0.002


@torch.no_grad()
def frame_flag(net, frames, ridge=1e-2):
    """Linear read-out (weight, bias) of the deformation head's input that is +1 for the first frame of a pair and -1 for the
    second, fitted on `frames` [2B,3,H,W]; also the worst margin seen and the inputs."""
    h = net.encode(frames)
    _, static_token = net.static(h)
    token = net.gaussian_upsampler(net.decoder.transformer_decoder(h))
    x = torch.cat([net.encoder_proj(static_token), token], -1)
    sign = torch.tensor([1.0, -1.0]).repeat(len(frames) // 2)[:, None].expand(x.shape[:2])
    flat = torch.cat([x, torch.ones_like(x[..., :1])], -1).flatten(0, 1).double()
    gram = flat.T @ flat
    solution = torch.linalg.solve(gram + ridge * len(flat) / flat.shape[1] * torch.eye(len(gram), dtype=torch.float64), flat.T @ sign.flatten().double())
    margin = float(((flat @ solution) * sign.flatten()).min())
    return solution[:-1].float(), float(solution[-1]), margin, x


@torch.no_grad()
def write_layering(net, frames, gain=40.0):
    """Overwrites the two least used hidden units of each velocity layer with a pass-through of the frame flag."""
    weight, bias, margin, x = frame_flag(net, frames)
    layers = net.gs_dynamic_predictor.gs_layer['xyz_dynamic'].layers
    first = torch.nn.functional.silu(layers['1'](x)).flatten(0, 1)
    second = torch.nn.functional.silu(layers['4'](first))
    use = lambda act, w: act.std(0) * w.norm(dim=0)
    i = use(first, layers['4'].weight).argsort()[:2]
    j = use(second, layers['7'].weight[[0, 2]]).argsort()[:2]
    # the mean contribution of the overwritten units is kept
    layers['4'].bias += layers['4'].weight[:, i] @ first.mean(0)[i]
    layers['7'].bias += layers['7'].weight[:, j] @ second.mean(0)[j]
    layers['4'].weight[:, i] = 0
    layers['7'].weight[:, j] = 0
    for k, s in ((0, 1.0), (1, -1.0)):
        layers['1'].weight[i[k]], layers['1'].bias[i[k]] = s * weight, s * bias
        layers['4'].weight[j[k]], layers['4'].bias[j[k]] = 0, 0
        layers['4'].weight[j[k], i[0]], layers['4'].weight[j[k], i[1]] = s, -s
    layers['7'].weight[1], layers['7'].bias[1] = 0, 0
    layers['7'].weight[1, j[0]], layers['7'].weight[1, j[1]] = -gain, gain
    net.gs_dynamic_predictor.dynamic_scalar[1] = STEP
    return dict(margin=margin, units=[i.tolist(), j.tolist()])


@torch.no_grad()
def write_fade(net, sharpness, half_life, learned=0.0):
    """gamma = (sharpness, half_life) everywhere; `learned` keeps that share of the head's own output."""
    last = net.gs_dynamic_predictor.gs_layer['opacity_dynamic'].layers['7']
    last.weight.mul_(learned)
    last.bias.copy_(torch.tensor([sharpness, math.log(half_life / (1 - half_life))]))
