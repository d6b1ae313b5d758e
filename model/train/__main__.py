"""`python -m train COMMAND` (from the folder `model/`): see README.md."""
import argparse
import json
import os
import pathlib

os.environ.setdefault('OMP_WAIT_POLICY', 'passive')

import numpy as np
import torch

from . import data, depth, evaluate, layering, network, stages, start
from .checkpoint import Run


def sample_frames(clips, count, seed=0):
    """Frames spread over the clips, for calibration; float32 [count,3,H,W]."""
    r = np.random.default_rng([seed, 99])
    picks = [clips[i % len(clips)] for i in range(count)]
    return torch.from_numpy(np.stack([c[r.integers(len(c))] for c in picks])).permute(0, 3, 1, 2).float() / 255


def load_clips(o, size):
    if not o.clips:
        raise SystemExit('where are the clips? --clips DIR or STREAMSPLAT_CLIPS=DIR (a folder with train/ and val/)')
    return [data.load_clip(f, size, o.cache) for f in data.clip_folders(pathlib.Path(o.clips) / 'train')]


def begin(o):
    """Writes the analytic start, or the checkpoint `--from`, into a new run folder."""
    if o.source:
        net = network.open_official(o.source)
        return keep_start(o, net, dict(source=o.source))
    c = network.Config(hidden_dim=o.width, upsampler_window=o.window, resolution=tuple(o.resolution), condition_len=o.resolution[0] * o.resolution[1] // 64, static_position='truncated_normal' if o.sampling else 'tanh')
    clips = load_clips(o, c.resolution)
    torch.manual_seed(o.seed)
    net = network.StreamSplat(c)
    for p in net.parameters():
        p.requires_grad_(False)
    frames = sample_frames(clips, 24, o.seed)
    readers, info = start.write_encoder(net, frames)
    info.update(start.write_static(net, readers, frames))
    info.update(start.write_decoder(net, readers, frames[:8]))
    info.update(start.write_motion(net, readers, frames[:8]))
    keep_start(o, net, info)


def keep_start(o, net, info):
    run = Run(o.run)
    run.note('start', info)
    run.note('config', {k: list(v) if isinstance(v, tuple) else v for k, v in net.config.__dict__.items()})
    run.save(dict(stage='start', done=True, net=net.state_dict(), spent=0.0, before=0.0))
    print(info)


def open_run(o):
    run = Run(o.run)
    with open(run.folder / 'config.json') as f:
        c = network.Config.of(json.load(f))
    state = run.state
    net = network.StreamSplat(c)
    net.load_state_dict(state['net'])
    return run, net.to(o.device), state


def train(o):
    run, net, state = open_run(o)
    clips = load_clips(o, net.config.resolution)
    fresh = state['stage'] != o.stage or state['done']
    stage = None if fresh else state
    before = state['before'] + state['spent'] if fresh else state['before']
    if fresh:                                     # a stage after another starts with the weights of that one and a new optimiser
        run.save(dict(state, before=before, spent=0.0))
    return getattr(stages, o.stage)(net, o, run, clips, stage)


SHARES = dict(static=0.3, flow=0.25, dynamic=0.45)


def whole(o):
    """Start, the stages, checkpoint and held-out figures. Finished parts are skipped."""
    if not (pathlib.Path(o.run) / 'state.pt').exists():
        begin(o)
    order = ['start', *SHARES]
    for stage, share in SHARES.items():
        state = Run(o.run).state
        reached = order.index(state['stage'])
        if reached > order.index(stage) or reached == order.index(stage) and state['done']:
            continue
        settings = argparse.Namespace(**vars(o))
        settings.stage, settings.minutes, settings.steps, settings.batch = stage, o.minutes * share, o.steps, o.batch if stage == 'static' else 1
        train(settings)
    export(o)
    if o.intervals >= 0:
        o.model, o.limit, o.out = o.out, o.intervals, str(pathlib.Path(o.run) / 'eval.json')
        measure(o)


def pack(o):
    """All clips at the model's resolution in one folder of a limited size."""
    print(data.pack(pathlib.Path(o.clips or '.'), pathlib.Path(o.out), tuple(o.size), int(o.limit_mb * 1e6)))


def export(o):
    _, net, _ = open_run(o)
    if o.zero_below:
        print('zeroed:', *network.zero_small_branches(net, o.zero_below))
    if o.forward:
        clips = load_clips(o, net.config.resolution)
        frames = torch.from_numpy(np.concatenate([c[[0, 5]] for c in clips[::6]])).permute(0, 3, 1, 2).float() / 255
        margin = depth.come_forward(net, frames)
        if margin < depth.MARGIN:
            raise SystemExit(f'{o.out}: not written: the frame a token is of is read off it with a margin of {margin:.3f}, expected at least {depth.MARGIN}')
        print(f'least margin of the frame a token is of: {margin:.3f}')
    network.save_official(net, o.out, dict(f16=torch.float16, bf16=torch.bfloat16, f32=torch.float32)[o.dtype])


def opened(o):
    return network.open_official(o.model) if o.model else open_run(o)[1].cpu()


def measure(o):
    net = opened(o)
    evaluate.evaluate(net, pathlib.Path(o.clips) / o.split, tuple(o.gaps_measured), o.stride, o.limit, o.cache, o.out, o.one_way)


def order(o):
    """Measures depth: procedural scenes in order and from the side, and the effect of other compositing orders on the pictures."""
    net = opened(o)
    clips = [data.load_clip(f, net.config.resolution, o.cache) for f in data.clip_folders(pathlib.Path(o.clips) / o.split)]
    frames = torch.from_numpy(np.stack([c[len(c) // 2] for c in clips])).permute(0, 3, 1, 2).float() / 255
    result = dict(rendered=depth.order_of_scenes(lambda f: depth.rendered_nearness(net, f), clips, o.scenes),
                  lower_is_nearer=depth.order_of_scenes(depth.lower_is_nearer, clips, o.scenes), key_psnr_by_order=depth.fragility(net, frames),
                  turned_by_10_degrees=depth.turned_scenes(net, clips, o.scenes))
    print(json.dumps(result, indent=1))
    if o.out:
        pathlib.Path(o.out).write_text(json.dumps(result, indent=1))


def layer(o):
    """Writes layering and fade into an existing checkpoint."""
    net = network.open_official(o.model)
    clips = load_clips(o, net.config.resolution)
    pairs = data.Pairs(clips, o.seed, o.pairs, middle=1, procedural=0.3)
    frames = torch.from_numpy(pairs.batch(0)['rgb'][:, :2]).flatten(0, 1)
    info = layering.write_layering(net, frames)
    layering.write_fade(net, o.sharpness, o.half_life, o.learned)
    network.save_official(net, o.out, torch.float16)
    print(info)


def main(arguments=None):
    a = argparse.ArgumentParser(prog='python -m train', description='The shipped checkpoint, from nothing but clips.')
    a.add_argument('--threads', type=int, default=2)
    a.add_argument('--device', choices=('cpu', 'cuda'), default='cpu')
    commands = a.add_subparsers(dest='command', required=True)

    def command(name, function, text, run=True):
        c = commands.add_parser(name, help=text)
        c.set_defaults(function=function)
        c.add_argument('--clips', default=os.environ.get('STREAMSPLAT_CLIPS'), help='folder with train/ and val/, a folder per clip in each')
        c.add_argument('--cache', help='folder for decoded clips')
        c.add_argument('--seed', type=int, default=0)
        if run:
            c.add_argument('--run', default='runs/small', help='folder of the run')
        return c

    def network_options(c):
        c.add_argument('--width', type=int, default=256)
        c.add_argument('--window', type=int, default=64)
        c.add_argument('--resolution', type=int, nargs=2, default=(144, 256))
        c.add_argument('--from', dest='source', metavar='FILE', help='an exported checkpoint instead of the analytic start; its shapes count')
        c.add_argument('--sampling', action='store_true', help='a truncated-normal position head, sampled while training')

    def training_options(c):
        c.add_argument('--steps', type=int, default=0, help='exact length of a stage; a resumed run equals an unbroken one to the bit')
        c.add_argument('--minutes', type=float, default=0, help='time budget instead of --steps')
        c.add_argument('--until', type=int, help='stop early at this step (and resume by the same command)')
        c.add_argument('--rate', type=float, default=1.0, help='factor on all learning rates')
        c.add_argument('--gradient', type=float, default=0.0, help='weight of the gradient L1')
        c.add_argument('--depth', type=float, default=0.0, metavar='WEIGHT', help='let depth move; in `static`, by this weight of the depth loss on procedural scenes (README: what it costs)')
        c.add_argument('--mixed', action='store_true', help='bfloat16 products in upsamplers and heads')
        c.add_argument('--rasteriser', choices=('cpu', 'triton'), help='default: what the device asks for')
        c.add_argument('--workers', type=int, default=0, help='processes that make batches ahead of time (the batches are the same)')
        c.add_argument('--tf32', action='store_true', help='products of 10 bits of mantissa, on CUDA')
        c.add_argument('--mean-positions', action='store_true', help='do not sample positions')

    def static_options(c):
        c.add_argument('--crop', type=int, nargs=2, help='rows and columns in patches of 8; keep the full width when attention is trained')
        c.add_argument('--attention', action='store_true', help='train the upsampler\'s attention too')
        c.add_argument('--encoder', action='store_true', help='train the encoder too')
        c.add_argument('--magnified', type=float, default=0.0, metavar='SHARE', help='share of the frames of which a part is shown, 1.1 to 1.9 times larger: what tiles of larger frames look like')
        c.add_argument('--fit', type=float, default=0.0, metavar='WEIGHT', help='weight of the picture with fitted colours beside that of the network\'s')
        c.add_argument('--fit-steps', type=int, default=4, help='conjugate gradients of that fit')
        c.add_argument('--turned', type=float, default=0.0, metavar='WEIGHT', help='with --depth: weight of procedural scenes lifted to their depth, from their camera and from the side')
        c.add_argument('--scenes', type=int, default=1, help='procedural scenes of a step, with --depth')

    def dynamic_options(c):
        c.add_argument('--procedural', type=float, default=0.15, help='share of procedural scenes')
        c.add_argument('--gaps', type=int, nargs=2, default=(3, 8))
        c.add_argument('--middle', type=int, default=3)
        c.add_argument('--keep-zero-output', action='store_true', help='leave residual branches that add nothing as they are (they cost nothing)')
        c.add_argument('--flow', type=float, default=0.05, help='weight of the end-point error in pixels beside the pictures')

    def one_way_option(c):
        c.add_argument('--one-way', action='store_true', help='the first frame\'s Gaussians alone (for comparison)')

    def heads_options(c):
        c.add_argument('--pairs', type=int, default=120, help='pairs of frames held ready, about 7 MB each')

    def checkpoint_options(c):
        c.add_argument('--dtype', choices=('f16', 'bf16', 'f32'), default='f16')
        c.add_argument('--forward', action='store_true', help='with depth: the first frame keeps its depth and the second comes forward, so that followed points do not drift')
        c.add_argument('--zero-below', type=float, default=0.0, metavar='LEAST', help='leave out residual branches whose output projection is smaller everywhere')

    def measuring_options(c):
        c.add_argument('--split', default='val')
        c.add_argument('--gaps-measured', type=int, nargs='+', default=(5, 8))
        c.add_argument('--stride', type=int, default=10)

    c = command('pack', pack, 'all clips at the model\'s resolution in one small folder', run=False)
    c.add_argument('--out', required=True)
    c.add_argument('--size', type=int, nargs=2, default=(144, 256))
    c.add_argument('--limit-mb', type=float, default=50.0)
    c = command('start', begin, 'write the analytic start')
    network_options(c)
    c = command('static', train, 'the static half')
    c.set_defaults(stage='static')
    training_options(c)
    c.add_argument('--batch', type=int, default=2)
    static_options(c)
    c = command('dynamic', train, 'decoder, deformation upsampler and heads against pictures and flow')
    c.set_defaults(stage='dynamic')
    training_options(c)
    c.add_argument('--batch', type=int, default=1)
    dynamic_options(c)
    one_way_option(c)
    c = command('heads', train, 'the deformation heads alone, on tokens worked out once')
    c.set_defaults(stage='heads')
    training_options(c)
    dynamic_options(c)
    heads_options(c)
    c = command('flow', train, 'decoder, deformation upsampler and velocity head against flow alone')
    c.set_defaults(stage='flow')
    training_options(c)
    c.add_argument('--batch', type=int, default=1)
    dynamic_options(c)
    c = command('all', whole, 'start, static, flow, dynamic, export and eval; resumes')
    for options in (network_options, training_options, static_options, dynamic_options, one_way_option, checkpoint_options, measuring_options):
        options(c)
    c.add_argument('--batch', type=int, default=2, help='frames of a step of the static stage')
    c.add_argument('--out', required=True, help='the checkpoint')
    c.add_argument('--intervals', type=int, default=0, help='measured per clip (0: all; -1: measure nothing)')
    c = command('export', export, 'write the checkpoint in the official layout')
    c.add_argument('--out', required=True)
    checkpoint_options(c)
    c = command('eval', measure, 'held-out figures')
    c.add_argument('--model', help='a checkpoint instead of the run')
    measuring_options(c)
    one_way_option(c)
    c.add_argument('--limit', type=int, default=0, help='intervals per clip (0: all)')
    c.add_argument('--out')
    c = command('order', order, 'rendered depth on procedural scenes, and pictures composited in other orders')
    c.add_argument('--model', help='a checkpoint instead of the run')
    c.add_argument('--split', default='val', help='where textures and pictures come from')
    c.add_argument('--scenes', type=int, default=60)
    c.add_argument('--out')
    c = command('layer', layer, 'write layering and fade into a checkpoint', run=False)
    c.add_argument('--model', required=True)
    c.add_argument('--out', required=True)
    c.add_argument('--pairs', type=int, default=4)
    c.add_argument('--sharpness', type=float, default=12.0)
    c.add_argument('--half-life', type=float, default=0.8)
    c.add_argument('--learned', type=float, default=0.0)
    o = a.parse_args(arguments)
    if o.device == 'cuda' and not torch.cuda.is_available():
        raise SystemExit('--device cuda: this machine has no CUDA device that PyTorch can use')
    torch.set_num_threads(o.threads)
    torch.backends.cuda.matmul.allow_tf32 = getattr(o, 'tf32', False)
    o.function(o)


if __name__ == '__main__':
    main()
