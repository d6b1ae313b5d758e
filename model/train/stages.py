"""The stages of training. Each is a function from (network, settings, run) that can stop and go on at any step.

colours   the head alone, on top of the window extractor: a linear map through the rasteriser
static    upsampler and head on single frames (the encoder is the exact extractor of start.py; `--encoder` frees it)
motion    the decoder against teacher motion, nothing rendered
dynamic   deformation upsampler and heads, rendered at both key times and at times between; encoder and static half frozen
"""
import math
import time

import numpy as np
import torch
import torch.nn.functional as F

from . import data, losses, start
from .rasteriser import render_pair, render_static


class Progress:
    """How much of a stage is done: by steps (exactly repeatable) or by a time budget in minutes (whichever is given).

    Time is counted while this process is alive; a process that was stopped and continued has spent the time in between."""

    def __init__(self, steps, minutes):
        if not steps and not minutes:
            raise ValueError('a stage needs --steps or --minutes')
        self.steps, self.minutes, self.spent, self._since = steps, minutes, 0.0, time.monotonic()

    def tick(self):
        now = time.monotonic()
        self.spent += (now - self._since) / 60
        self._since = now

    def at(self, step):
        return step / self.steps if self.steps else min(1.0, self.spent / self.minutes)


def cosine(f, step, warm=40, hold=0.2):
    return min(1.0, (step + 1) / warm) * (0.03 + 0.97 * 0.5 * (1 + math.cos(math.pi * max(0.0, (f - hold) / (1 - hold)))))


class Stage:
    """Optimiser, running mean of the weights, log and state around one `loss(step, fraction) -> (loss, figures)`."""

    def __init__(self, name, net, groups, run, steps=0, minutes=0.0, beta2=0.98, clip=8.0, decay=0.0, every=25, keep=180.0, mean=0.995):
        for p in net.parameters():
            p.requires_grad_(False)
        self.name, self.net, self.run, self.every, self.keep, self.clip, self.mean = name, net, run, every, keep, clip, mean
        self.rates = []
        params = []
        for tensors, rate in groups:
            tensors = list(tensors)
            for p in tensors:
                p.requires_grad_(True)
            params.append(dict(params=tensors, lr=rate))
            self.rates.append(rate)
        self.trained = [p for g in params for p in g['params']]
        self.names = {id(p): k for k, p in net.named_parameters()}
        self.opt = torch.optim.AdamW(params, betas=(0.9, beta2), eps=1e-10, weight_decay=decay)
        self.average = {self.names[id(p)]: p.detach().clone() for p in self.trained}
        self.progress, self.step, self.before = Progress(steps, minutes), 0, 0.0

    def resume(self, state):
        if state is None or state['stage'] != self.name:
            return
        self.net.load_state_dict(state['net'])
        self.opt.load_state_dict(state['opt'])
        self.average = {k: v.clone() for k, v in state['average'].items()}
        self.step, self.progress.spent, self.before = state['step'], state['spent'], state['before']

    def state(self, done=False):
        return dict(stage=self.name, done=done, net=self.net.state_dict(), opt=self.opt.state_dict(), average=self.average, step=self.step,
                    spent=self.progress.spent, before=self.before)

    def go(self, loss_of, until=None):
        """Runs to the end of the budget (or to step `until`), then puts the running mean into the network."""
        figures, saved = [], time.monotonic()
        while True:
            self.progress.tick()
            f = self.progress.at(self.step)
            if f >= 1 or (until is not None and self.step >= until):
                break
            for g, rate in zip(self.opt.param_groups, self.rates):
                g['lr'] = rate * cosine(f, self.step)
            loss, figure = loss_of(self.step, f)
            self.opt.zero_grad(set_to_none=True)
            loss.backward()
            norm = torch.nn.utils.clip_grad_norm_([p for p in self.trained if p.grad is not None], self.clip)
            if torch.isfinite(norm):
                self.opt.step()
            self.step += 1
            k = min(self.mean, self.step / (self.step + 15))
            with torch.no_grad():
                for p in self.trained:
                    self.average[self.names[id(p)]].lerp_(p.detach(), 1 - k)
            figures.append(dict(figure, loss=float(loss.detach()), gradient=float(norm)))
            if self.step % self.every == 0:
                self.progress.tick()
                row = dict(stage=self.name, step=self.step, minutes=round(self.progress.spent, 3), total_minutes=round(self.before + self.progress.spent, 3))
                row.update({k: round(float(np.mean([q[k] for q in figures if k in q])), 4) for k in sorted({k for q in figures for k in q})})
                self.run.log(row)
                print(row, flush=True)
                figures = []
            if time.monotonic() - saved > self.keep:
                self.run.save(self.state())
                saved = time.monotonic()
        if until is not None and self.step >= until and self.progress.at(self.step) < 1:
            self.run.save(self.state())
            return self
        with torch.no_grad():
            for p in self.trained:
                p.copy_(self.average[self.names[id(p)]])
        self.run.save(self.state(done=True))
        self.run.curve()
        return self


def flat_depth(net):
    """Freezes the row of the position layers that moves Gaussians in depth: equal depths keep their order, and order is fragile."""
    def hook(g):
        g = g.clone()
        g[1] = 0
        return g
    head = net.gs_predictor.predictor
    layers = [head.mix_layer['xyz_static_mean']] if head.sampled else [head.gs_layer['xyz_static']]
    layers.append(net.gs_dynamic_predictor.gs_layer['xyz_dynamic'].layers['7'])
    hooks = [p.register_hook(hook) for layer in layers for p in (layer.weight, layer.bias) if p.requires_grad]
    return hooks


def named(module, *words, exclude=()):
    return [p for k, p in module.named_parameters() if (not words or any(w in k for w in words)) and not any(w in k for w in exclude)]


def static_groups(net, attention=False, encoder=False):
    up, head = net.gs_predictor.gaussian_upsampler, net.gs_predictor.predictor
    silent = () if attention else ('.attn.', 'layernorm1')
    groups = [(named(up, 'mlp.', exclude=silent), 5e-4), (named(up, 'layernorm', exclude=silent), 1e-3), (named(up, 'residual_fc'), 1e-4), (head.parameters(), 5e-4)]
    if attention:
        groups.append((named(up, '.attn.'), 3e-4))
    if encoder:
        groups.append((named(net.gs_predictor.encoder), 2e-5))
    return groups


def colours(net, o, run, clips, state=None):
    stage = Stage('colours', net, [(net.gs_predictor.predictor.parameters(), 2e-2)], run, o.steps, o.minutes)
    stage.resume(state)
    return _static(stage, net, o, clips, encoder=False)


def static(net, o, run, clips, state=None):
    stage = Stage('static', net, static_groups(net, o.attention, o.encoder), run, o.steps, o.minutes)
    stage.resume(state)
    return _static(stage, net, o, clips, o.encoder)


def _static(stage, net, o, clips, encoder):
    h, w = net.config.resolution
    source = data.Frames(clips, o.seed, o.batch, None if not o.crop else tuple(o.crop))
    hooks = [] if o.depth else flat_depth(net)
    sampled = net.gs_predictor.predictor.sampled

    def loss_of(step, f):
        x, place = source.batch(step)
        x = torch.from_numpy(x)
        grid = (x.shape[2] // 8, x.shape[3] // 8)
        gen = torch.Generator().manual_seed(o.seed * 1_000_003 + step)
        with torch.set_grad_enabled(encoder):
            e = net.encode(x, place=place)
        token = net.gs_predictor.gaussian_upsampler(e, grid)
        u = torch.rand(*token.shape[:2], 3, generator=gen) if sampled and not o.mean_positions else None
        g = net.gs_predictor.predictor(token, u, net.cells(grid, place))
        image, T = render_static(g, x.shape[2], x.shape[3], torch.rand(len(x), 3, generator=gen), (h, w), (place[0] * 8, place[1] * 8))
        # a crop's rim lacks the neighbours that the full frame has
        m = 8 if grid != net.config.grid else 0
        inner = (slice(None), slice(None), slice(m, x.shape[2] - m), slice(m, x.shape[3] - m))
        a, b = image[:, :3][inner], x[inner]
        loss = losses.log_error(a, b) + o.gradient * losses.gradient_l1(a, b)
        return loss, dict(key=float(losses.psnr(a.detach(), b).mean()), transmittance=float(T.mean()))

    stage.go(loss_of, o.until)
    for hook in hooks:
        hook.remove()
    return stage


def motion(net, o, run, clips, state=None):
    """The decoder alone: the smoothed motion axes against the teacher, on patches."""
    dec = net.decoder.transformer_decoder
    readers = torch.load(o.readers, weights_only=True)
    b0, b1 = dec.transformer.resblocks[:2]
    groups = [(named(b0.mlp), 2e-4), ([b0.mlp_ln.weight, b1.mlp_ln.weight], 1e-3), (named(b1.mlp), 2e-4)]
    stage = Stage('motion', net, groups, run, o.steps, o.minutes)
    stage.resume(state)
    source = data.Pairs(clips, o.seed, o.batch, middle=1, procedural=o.procedural, gaps=tuple(o.gaps))
    axes = torch.stack([readers['motion']['sx'], readers['motion']['sy']]).float() * readers['decoder_gain'] * start.SMOOTH_UNIT * net.config.patch_size

    def loss_of(step, f):
        b = {k: torch.from_numpy(v) for k, v in source.batch(step).items()}
        with torch.no_grad():
            h = net.encode(b['rgb'][:, :2].flatten(0, 1))
        got = dec(h) @ axes.T
        p = net.config.patch_size
        want = (F.avg_pool2d(b['flow'].flatten(0, 1), p).flatten(2).transpose(1, 2).unflatten(0, (-1, 2)) * torch.tensor([1.0, -1.0]).view(1, 2, 1, 1)).flatten(0, 1)
        sure = (F.avg_pool2d(b['sure'].flatten(0, 1)[:, None], p).flatten(1) > 0.95).float() * (want.norm(dim=-1) < 60)
        error = (got - want).pow(2).sum(-1).add(0.01).sqrt()
        loss = (error * sure).sum() / (sure.sum() + 1)
        return loss, dict(epe=float(loss.detach()), epe_zero=float((want.norm(dim=-1) * sure).sum() / (sure.sum() + 1)))

    stage.go(loss_of, o.until)
    return stage


def dynamic(net, o, run, clips, state=None):
    up, head, dec = net.gaussian_upsampler, net.gs_dynamic_predictor, net.decoder.transformer_decoder
    groups = [(named(up, 'mlp.'), 3e-4), (named(up, 'layernorm2'), 1e-3), (named(up, 'residual_fc'), 1e-4), (net.encoder_proj.parameters(), 3e-4),
              (named(head, 'xyz_dynamic.'), 1e-4), (named(head, 'opacity_dynamic'), 1e-3)]
    if o.decoder:
        groups.append((named(dec, 'mlp'), 5e-5))
    stage = Stage('dynamic', net, groups, run, o.steps, o.minutes)
    stage.resume(state)
    size = h, w = net.config.resolution
    source = data.Pairs(clips, o.seed, o.batch, middle=o.middle, procedural=o.procedural, gaps=tuple(o.gaps))
    hooks = [] if o.depth else flat_depth(net)

    def loss_of(step, f):
        b = {k: torch.from_numpy(v) for k, v in source.batch(step).items()}
        gen = torch.Generator().manual_seed(o.seed * 1_000_003 + step)
        with torch.no_grad():
            e = net.encode(b['rgb'][:, :2].flatten(0, 1))
            g, token = net.static(e)
        with torch.set_grad_enabled(bool(o.decoder)):
            d = dec(e)
        velocity, gamma = head(torch.cat([net.encoder_proj(token), up(d)], -1))
        g = {k: t.unflatten(0, (-1, 2)) for k, t in dict(g, velocity=velocity, gamma=gamma).items()}
        B, K = b['time'].shape
        image, _ = render_pair(g, b['time'], h, w, torch.rand(B, 1, 3, generator=gen).expand(B, K, 3).contiguous())
        image = image[:, :, :3]
        target, sure = losses.splat_flow(b['flow'], b['sure'], net.config.splat_grid)
        epe, epe_zero = losses.end_point_error(velocity, target, sure, size)
        weight = 1 + 3 * b['foreground'][:, :, None]
        masked = (weight * (image - b['rgb']).pow(2)).mean((2, 3, 4))
        loss = 0.3 * losses.log_error(image[:, :2], b['rgb'][:, :2]) + 0.7 * torch.log(masked[:, 2:] + 1e-4).mean()
        loss = loss + o.gradient * losses.gradient_l1(image, b['rgb']) + o.flow * (1 - 0.9 * f) * epe
        with torch.no_grad():
            t = b['time'][:, 2:, None, None, None]
            fade = b['rgb'][:, :1] * (1 - t) + b['rgb'][:, 1:2] * t
            figures = dict(key=float(losses.psnr(image[:, :2], b['rgb'][:, :2]).mean()), middle=float(losses.psnr(image[:, 2:], b['rgb'][:, 2:]).mean()),
                           crossfade=float(losses.psnr(fade, b['rgb'][:, 2:]).mean()), epe=float(epe), epe_zero=float(epe_zero))
        return loss, figures

    stage.go(loss_of, o.until)
    for hook in hooks:
        hook.remove()
    return stage
