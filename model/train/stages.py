"""The stages of training. Each is a function of (network, settings, run) that can stop and resume at any step.

static    upsampler and head on single frames (the encoder is the exact extractor of start.py; `--encoder` frees it)
heads     the deformation heads alone, on tokens of pairs that are computed once, rendered at one key time and two between
flow      decoder, deformation upsampler and velocity head against flow alone, each tensor at a rate from its sensitivity; nothing is rendered
dynamic   the same tensors and rates, and the opacity head, rendered at both key times and at times between
"""
import itertools
import math
import signal
import time

import numpy as np
import torch

from . import data, depth, lifted, losses, network
from .optimiser import Mixed, groups_of
from .rasteriser import render_fitted, render_pair, render_static


class Progress:
    """Progress of a stage, by steps (exactly repeatable) or by a time budget in minutes, whichever is set.

    Time counts while this process is alive; a process that was suspended and continued has spent the time in between."""

    def __init__(self, steps, minutes):
        if not steps and not minutes:
            raise ValueError('a stage needs --steps or --minutes')
        self.steps, self.minutes, self.spent, self._since = steps, minutes, 0.0, time.monotonic()

    def tick(self):
        now = time.monotonic()
        self.spent += (now - self._since) / 60
        self._since = now

    def skip(self):
        self._since = time.monotonic()

    def at(self, step):
        return step / self.steps if self.steps else min(1.0, self.spent / self.minutes)


def tensors(batch, device):
    """A batch of numpy arrays as tensors on the network's device."""
    return {k: torch.from_numpy(v).to(device) for k, v in batch.items()}


class _Made(torch.utils.data.Dataset):
    def __init__(self, make):
        self.make = make

    def __getitem__(self, step):
        return self.make(step)


def ahead(make, first, workers, device):
    """make(first), make(first + 1), … as tensors: `workers` processes compute them ahead of time; without workers they are computed here, on demand."""
    loader = torch.utils.data.DataLoader(_Made(make), batch_size=None, sampler=itertools.count(first), num_workers=workers, pin_memory=device.type == 'cuda',
                                         prefetch_factor=4 if workers else None, multiprocessing_context='fork' if workers else None)
    return iter(loader)


def half(o, device):
    """Mixed precision for upsamplers and heads with `--mixed`. Encoder and decoder stay in float32: their start keeps matching and motion in faint directions
    that 8 bits of mantissa would lose."""
    return torch.autocast(device.type, torch.bfloat16, enabled=o.mixed)


def single(g):
    return {k: t.float() for k, t in g.items()}


def cosine(f, step, warm=20, hold=0.1):
    return min(1.0, (step + 1) / warm) * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * max(0.0, (f - hold) / (1 - hold)))))


class Stage:
    """Optimiser, running mean of the weights, log and state around one `loss(step, fraction) -> (loss, figures)`."""

    def __init__(self, name, net, groups, run, steps=0, minutes=0.0, clip=8.0, every=25, keep=120.0, mean=0.995):
        for p in net.parameters():
            p.requires_grad_(False)
        self.name, self.net, self.run, self.every, self.keep, self.clip, self.mean = name, net, run, every, keep, clip, mean
        self.rates = [g['lr'] for g in groups]
        self.trained = [p for g in groups for p in g['params']]
        self.device = self.trained[0].device
        for p in self.trained:
            p.requires_grad_(True)
        self.names = {id(p): k for k, p in net.named_parameters()}
        self.opt = Mixed(groups)
        self.average = {self.names[id(p)]: p.detach().clone() for p in self.trained}
        self.progress, self.step, self.before = Progress(steps, minutes), 0, 0.0

    def resume(self, state):
        if state is None or state['stage'] != self.name:
            return
        self.net.load_state_dict(state['net'])
        self.opt.load_state_dict(state['opt'])
        self.rates = [g.get('rate', r) for g, r in zip(self.opt.param_groups, self.rates)]
        self.average = {k: v.to(self.device, copy=True) for k, v in state['average'].items()}
        self.step, self.progress.spent, self.before = state['step'], state['spent'], state['before']

    def state(self, done=False):
        return dict(stage=self.name, done=done, net=self.net.state_dict(), opt=self.opt.state_dict(), average=self.average, step=self.step,
                    spent=self.progress.spent, before=self.before)

    def go(self, loss_of, until=None):
        """Runs to the end of the budget, then puts the running mean into the network. At step `until` or on SIGTERM it stops and stores the state to resume
        from."""
        figures, saved, stop = [], time.monotonic(), []
        before = signal.signal(signal.SIGTERM, lambda *_: stop.append(1))
        while True:
            self.progress.tick()
            f = self.progress.at(self.step)
            if f >= 1 or stop or (until is not None and self.step >= until):
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
            figures.append(dict(figure, loss=loss.detach(), gradient=norm))
            if self.step % self.every == 0:
                self.progress.tick()
                row = dict(stage=self.name, step=self.step, minutes=round(self.progress.spent, 3), total_minutes=round(self.before + self.progress.spent, 3))
                row.update({k: round(float(np.mean([float(q[k]) for q in figures if k in q])), 4) for k in sorted({k for q in figures for k in q})})
                self.run.log(row)
                print(row, flush=True)
                figures = []
            if time.monotonic() - saved > self.keep:
                self.run.save(self.state())
                saved = time.monotonic()
        signal.signal(signal.SIGTERM, before)
        if self.progress.at(self.step) < 1:
            self.run.save(self.state())
            if stop:
                raise SystemExit(f'stopped at step {self.step}; the same command goes on from there')
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


def static_groups(net, attention=False, encoder=False, rate=1.0):
    up, head = net.gs_predictor.gaussian_upsampler, net.gs_predictor.predictor
    attention_names = () if attention else ('.attn.', 'layernorm1')
    groups = groups_of(up, 0.015 * rate, 3e-3 * rate, slow={'residual_fc': 0.0045 * rate}, skip=attention_names)
    groups.append(dict(params=list(head.parameters()), lr=7.5e-3 * rate))
    if encoder:
        groups += groups_of(net.gs_predictor.encoder, 1.5e-3 * rate, 1.5e-4 * rate)
    return groups


def static(net, o, run, clips, state=None):
    if o.depth:
        if o.crop:
            raise ValueError('--depth takes whole frames: no --crop')
        if not state:
            depth.keep_frames_apart(net)
            depth.write_lean(net, torch.from_numpy(data.Frames(clips, o.seed, 2).batch(1 << 22)[0]).to(next(net.parameters()).device))
    stage = Stage('static', net, static_groups(net, o.attention, o.encoder, o.rate), run, o.steps, o.minutes)
    stage.resume(state)
    _static(stage, net, o, clips, o.encoder)
    if o.depth and stage.progress.at(stage.step) >= 1:
        depth.settle(net)
        run.save(stage.state(done=True))
    return stage


def _static(stage, net, o, clips, encoder):
    h, w = net.config.resolution
    if o.fit and o.crop:
        raise ValueError('--fit takes whole frames: no --crop')
    if o.turned and not o.depth:
        raise ValueError('--turned needs scenes whose depth is known: --depth')
    source = data.Frames(clips, o.seed, o.batch, None if not o.crop else tuple(o.crop), o.magnified)
    scenes = data.Pairs(clips, o.seed, 1, middle=0) if o.depth else None
    hooks = depth.kept_lean(net) if o.depth else flat_depth(net)
    sampled = net.gs_predictor.predictor.sampled

    def turn(step):
        return float(np.random.default_rng([o.seed, step, 1 << 24]).uniform(4, 12)) * (-1) ** step

    def batch(step):
        x, place = source.batch(step)
        if not scenes:
            return x, place, np.zeros(0, np.float32)
        # the last frames of the batch are scenes of known depth
        made = [scenes.turned(step, k, turn(step)) if o.turned else scenes.still(step, k) for k in range(o.scenes)]
        of, *known = (np.concatenate(each) for each in zip(*made))
        return np.concatenate([x, of]), place, *known

    batches = ahead(batch, stage.step, o.workers, stage.device)

    def loss_of(step, f):
        x, place, front, *known = next(batches)
        x, place = x.to(stage.device, non_blocking=True), tuple(int(k) for k in place)
        grid = (x.shape[2] // 8, x.shape[3] // 8)
        gen = torch.Generator().manual_seed(o.seed * 1_000_003 + step)
        with torch.set_grad_enabled(encoder):
            e = net.encode(x, place=place)
        with half(o, stage.device):
            token = net.gs_predictor.gaussian_upsampler(e, grid)
            u = torch.rand(*token.shape[:2], 3, generator=gen).to(stage.device) if sampled and not o.mean_positions else None
            g = single(net.gs_predictor.predictor(token, u, net.cells(grid, place)))
        g, wide = losses.kept_local(g, net.config.splat_grid)
        background = torch.rand(len(x), 3, generator=gen).to(stage.device)
        image, T = render_static(g, x.shape[2], x.shape[3], background, (h, w), (place[0] * 8, place[1] * 8), o.rasteriser)
        # a crop's rim lacks neighbours that the full frame has
        m = 8 if grid != net.config.grid else 0
        more = {}
        inner = (slice(None), slice(None), slice(m, x.shape[2] - m), slice(m, x.shape[3] - m))
        a, b = image[:, :3][inner], x[inner]
        loss = losses.log_error(a, b) + o.gradient * losses.gradient_l1(a, b) + wide
        if o.fit:
            fitted, _ = render_fitted(g, x, background, o.fit_steps, o.rasteriser)
            loss = loss + o.fit * losses.log_error(fitted, x, losses.FITTED_FLOOR)
            more['fitted'] = losses.psnr(fitted.detach(), x).mean()
        if scenes:
            uneven, misplaced = depth.lean_loss(g['xyz'][..., 1], net.config.splat_grid, front.to(stage.device))
            loss = loss + o.depth * (depth.UNEVEN * uneven + misplaced)
            more.update(uneven=uneven.detach(), misplaced=misplaced.detach())
        if o.turned:
            last = slice(len(x) - len(front), None)
            y, turned, inside = (t.to(stage.device, non_blocking=True) for t in known)
            aside, figures = lifted.lifted_loss({k: t[last] for k, t in g.items()}, y, x[last], turned, inside, background[last], turn(step), net.config.splat_grid,
                                                o.fit_steps, o.rasteriser)
            loss = loss + o.turned * aside
            more.update(figures)
        return loss, dict(more, wide=wide.detach(), key=losses.psnr(a.detach(), b).mean(), transmittance=T.mean())

    stage.go(loss_of, o.until)
    for hook in hooks:
        hook.remove()
    return stage


class Prepared:
    """Pairs with the input of the deformation heads, computed once: the parts before the heads are fixed in their stage."""

    def __init__(self, net, o, clips, device):
        source = data.Pairs(clips, o.seed, 1, middle=o.middle, procedural=o.procedural, gaps=tuple(o.gaps))
        self.pairs, self.seed = [], o.seed
        for k in range(o.pairs):
            b = tensors(source.batch(k), device)
            with torch.no_grad():
                e = net.encode(b['rgb'][:, :2].flatten(0, 1))
                g, token = net.static(e)
                features = torch.cat([token, net.gaussian_upsampler(net.decoder.transformer_decoder(e))], -1)
                target, sure = losses.splat_flow(b['flow'], b['sure'], net.config.splat_grid)
            entry = dict(g, features=features, target=target, sure=sure, frames=b['rgb'], time=b['time'], foreground=b['foreground'])
            self.pairs.append({k: v.half() for k, v in entry.items()} | dict(xyz=g['xyz']))

    def at(self, step):
        """One pair with its first or last frame and two of those between."""
        r = np.random.default_rng([self.seed, step, 1 << 21])
        b = {k: v.float() for k, v in self.pairs[r.integers(len(self.pairs))].items()}
        inner = b['time'].shape[1] - 2
        pick = [int(r.integers(2)), *(2 + r.permutation(inner)[:2]).tolist()]
        return dict(b, **{k: b[k][:, pick] for k in ('frames', 'time', 'foreground')}, ends=b['frames'][:, :2])


def heads(net, o, run, clips, state=None):
    head, (h, w) = net.gs_dynamic_predictor, net.config.resolution
    proj = net.encoder_proj.weight
    groups = groups_of(head.gs_layer['xyz_dynamic'], 0.005 * o.rate, 3e-4 * o.rate, output=('layers.7',))
    groups += groups_of(head.gs_layer['opacity_dynamic'], 0.01 * o.rate, 3e-3 * o.rate, output=('layers.7',))
    stage = Stage('heads', net, groups, run, o.steps, o.minutes, every=100)
    stage.resume(state)
    source = Prepared(net, o, clips, stage.device)
    stage.progress.skip()                         # computing the tokens is not training
    hooks = [] if o.depth else flat_depth(net)

    def loss_of(step, f):
        b = source.at(step)
        gen = torch.Generator().manual_seed(o.seed * 1_000_003 + step)
        token, up = b['features'].chunk(2, -1)
        velocity, gamma = head(torch.cat([token @ proj.T, up], -1))
        g = {k: b[k].unflatten(0, (-1, 2)) for k in ('xyz', 'scale', 'opacity', 'rgb')}
        g.update(velocity=velocity.unflatten(0, (-1, 2)), gamma=gamma.unflatten(0, (-1, 2)))
        background = torch.rand(1, 1, 3, generator=gen).expand(1, b['time'].shape[1], 3).contiguous().to(stage.device)
        image = render_pair(g, b['time'], h, w, background, o.rasteriser)[0][:, :, :3]
        epe, epe_zero = losses.end_point_error(velocity, b['target'], b['sure'], (h, w))
        masked = ((1 + 3 * b['foreground'][:, :, None]) * (image - b['frames']).pow(2)).mean((2, 3, 4))
        loss = torch.log(masked + 1e-4).mean() + o.flow * (1 - 0.9 * f) * epe
        with torch.no_grad():
            t = b['time'][:, 1:, None, None, None]
            fade = b['ends'][:, :1] * (1 - t) + b['ends'][:, 1:] * t
            psnr = losses.psnr(image, b['frames'])
            figures = dict(key=float(psnr[:, 0].mean()), middle=float(psnr[:, 1:].mean()), crossfade=float(losses.psnr(fade, b['frames'][:, 1:]).mean()),
                           epe=float(epe), epe_zero=float(epe_zero))
        return loss, figures

    stage.go(loss_of, o.until)
    for hook in hooks:
        hook.remove()
    return stage


def calibrated(named, error_of, pairs, pixels, most=4e-4):
    """Adam groups, one per tensor: at its rate a step may change the flow's error by `pixels` / sqrt(tensors), to first order.

    A step of Adam is as large for every entry, so it changes the error by rate * sum|gradient|. The start codes places and contents faintly compared with the
    position table, and these sums span four orders of magnitude."""
    size = {k: 0.0 for k, _ in named}
    for b in pairs:
        grads = torch.autograd.grad(error_of(b), [p for _, p in named], allow_unused=True)
        for (k, _), g in zip(named, grads):
            size[k] += 0.0 if g is None else float(g.abs().sum()) / len(pairs)
    rate = {k: min(most, pixels / math.sqrt(len(named)) / max(a, 1e-9)) for k, a in size.items()}
    return [dict(params=[p], lr=rate[k], rate=rate[k]) for k, p in named]


class Motion:
    """Shared by `flow` and `dynamic`: pairs, the tensors that determine velocities with their rates (`calibrated` at `pixels`), and a pair's motion against the
    teacher's."""

    def __init__(self, net, o, clips, middle, pixels):
        self.net, self.o, self.device = net, o, next(net.parameters()).device
        self.source = data.Pairs(clips, o.seed, o.batch, middle=middle, procedural=o.procedural, gaps=tuple(o.gaps))
        frozen = ('positional_embedding', 'gs_predictor', 'opacity_dynamic', 'xyz_dynamic_scale')
        frozen += tuple(f'{name}.' for name, _, size in network.branches(net) if not size) if o.keep_zero_output else ()
        named = [(k, p) for k, p in net.named_parameters() if not any(s in k for s in frozen) and not ('gaussian_upsampler' in k and '.attn.' in k)]
        for k, p in net.named_parameters():
            p.requires_grad_(any(p is q for _, q in named))
        self.groups = calibrated(named, lambda b: self.of(b)[0], [self.batch((1 << 22) + k) for k in range(6)], pixels * o.rate)

    def batch(self, step):
        return tensors(self.source.batch(step), self.device)

    def batches(self, first):
        for b in ahead(self.source.batch, first, self.o.workers, self.device):
            yield {k: v.to(self.device, non_blocking=True) for k, v in b.items()}

    def of(self, b):
        """(end-point error, that of no motion, all Gaussians [2B, N, .])"""
        net = self.net
        with torch.no_grad():
            e = net.encode(b['rgb'][:, :2].flatten(0, 1))
            with half(self.o, self.device):
                g, token = net.static(e)
        d = net.decoder.transformer_decoder(e)
        with half(self.o, self.device):
            velocity, gamma = net.gs_dynamic_predictor(torch.cat([net.encoder_proj(token), net.gaussian_upsampler(d)], -1))
        g = single(dict(g, velocity=velocity, gamma=gamma))
        target, sure = losses.splat_flow(b['flow'], b['sure'], net.config.splat_grid)
        return *losses.end_point_error(g['velocity'], target, sure, net.config.resolution), g


def flow(net, o, run, clips, state=None):
    motion = Motion(net, o, clips, 1, 0.05)
    stage = Stage('flow', net, motion.groups, run, o.steps, o.minutes)
    stage.resume(state)
    batches = motion.batches(stage.step)

    def loss_of(step, f):
        error, still, _ = motion.of(next(batches))
        return error, dict(epe=float(error.detach()), epe_zero=float(still))

    stage.go(loss_of, o.until)
    return stage


def dynamic(net, o, run, clips, state=None):
    motion, (h, w) = Motion(net, o, clips, o.middle, 0.125), net.config.resolution
    head = net.gs_dynamic_predictor.gs_layer['opacity_dynamic']
    stage = Stage('dynamic', net, motion.groups + groups_of(head, 0.0125 * o.rate, 3.75e-3 * o.rate, output=('layers.7',)), run, o.steps, o.minutes)
    stage.resume(state)
    hooks = [] if o.depth else flat_depth(net)
    batches = motion.batches(stage.step)

    def loss_of(step, f):
        b = next(batches)
        error, still, g = motion.of(b)
        gen = torch.Generator().manual_seed(o.seed * 1_000_003 + step)
        B, K = b['time'].shape
        background = torch.rand(B, 1, 3, generator=gen).expand(B, K, 3).contiguous().to(stage.device)
        g = {k: t.unflatten(0, (-1, 2))[:, :1 if o.one_way else 2] for k, t in g.items()}
        image = render_pair(g, b['time'], h, w, background, o.rasteriser)[0][:, :, :3]
        masked = torch.log(((1 + 3 * b['foreground'][:, :, None]) * (image - b['rgb']).pow(2)).mean((2, 3, 4)) + 1e-4)
        loss = 0.3 * masked[:, :2].mean() + 0.7 * masked[:, 2:].mean() + o.gradient * losses.gradient_l1(image, b['rgb']) + o.flow * error
        with torch.no_grad():
            t = b['time'][:, 2:, None, None, None]
            fade = b['rgb'][:, :1] * (1 - t) + b['rgb'][:, 1:2] * t
            figures = dict(key=float(losses.psnr(image[:, :2], b['rgb'][:, :2]).mean()), middle=float(losses.psnr(image[:, 2:], b['rgb'][:, 2:]).mean()),
                           crossfade=float(losses.psnr(fade, b['rgb'][:, 2:]).mean()), epe=float(error), epe_zero=float(still))
        return loss, figures

    stage.go(loss_of, o.until)
    for hook in hooks:
        hook.remove()
    return stage
