"""Encoder, upsampler and decoder: ours against PyTorch, ONNX Runtime and OpenVINO, on the same weights, in one run.

`python3 bench/peers/peers.py` creates its own environment (bench/peers/.venv, pinned in requirements.txt), builds the release program, writes seeded weights
and checks every runner's output against PyTorch in float64. Then it times all runners in turn, round after round, and writes bench/record/peers-DATE-CPU.json.
"""
import argparse
import datetime
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
STAGES = ('encoder', 'upsampler', 'decoder')
PRECISIONS = ('f32', 'bf16', 'int8')
# The largest relative L2 distance from float64 at which outputs count as the same function.
TOLERANCE = {'f32': 1e-4, 'bf16': 0.1, 'int8': 0.5}
CONFIGS = {
    'paper': dict(hidden_dim=768, encoder_layers=10, decoder_layers=10, resolution=[288, 512], patch_size=8, upsampler_window=2304, use_dino=True),
    'small': dict(hidden_dim=192, encoder_layers=1, decoder_layers=3, resolution=[144, 256], patch_size=8, upsampler_window=128, use_dino=False),
}


def enter_environment():
    """Restarts the script inside the pinned environment."""
    python = HERE / '.venv' / 'bin' / 'python'
    wanted = (HERE / 'requirements.txt').read_text()
    stamp = HERE / '.venv' / 'requirements.installed'
    if not stamp.exists() or stamp.read_text() != wanted:
        subprocess.run([sys.executable, '-m', 'venv', HERE / '.venv'], check=True)
        subprocess.run([python, '-m', 'pip', 'install', '--quiet', '-r', HERE / 'requirements.txt'], check=True)
        stamp.write_text(wanted)
    if Path(sys.prefix).resolve() != (HERE / '.venv').resolve():
        os.execv(python, [python, *sys.argv])


def arguments():
    a = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    a.add_argument('--size', choices=CONFIGS, default='paper')
    a.add_argument('--stages', default=','.join(STAGES))
    a.add_argument('--precisions', default=','.join(PRECISIONS))
    a.add_argument('--peers', default='torch,onnxruntime,openvino')
    a.add_argument('--threads', type=int, default=2)
    a.add_argument('--rounds', type=int, default=5)
    a.add_argument('--no-record', action='store_true', help='print, but leave bench/record alone')
    return a.parse_args()


def write_model(config, path):
    """Writes seeded weights in the official layout, with the configuration next to them."""
    sys.path.insert(0, str(ROOT / 'fixtures' / 'parity'))
    from make_weights import fill
    from safetensors.numpy import save_file
    weights = fill(config, seed=31, gain=1.2)
    save_file({'model.' + k: v for k, v in weights.items()}, path)
    path.with_suffix('.json').write_text(json.dumps(config))
    return weights


def main():
    o = arguments()
    enter_environment()
    import numpy as np
    import torch
    from safetensors.numpy import save_file

    import modules
    from runners import OnnxRuntime, OpenVino, Ours, Torch, Unavailable, seconds

    subprocess.run(['cargo', 'build', '--release', '--quiet', '-p', 'streamsplat-bench'], cwd=ROOT, check=True)
    target = Path(os.environ.get('CARGO_TARGET_DIR', ROOT / 'target'))
    program = str(target / 'release' / 'streamsplat-bench')
    config = CONFIGS[o.size]
    d, (h, w) = config['hidden_dim'], config['resolution']
    n = h * w // 64
    with tempfile.TemporaryDirectory(prefix='peers-') as folder:
        folder = Path(folder)
        model = folder / 'model.safetensors'
        parts = modules.build(config, write_model(config, model))
        rng = np.random.default_rng(7)
        condition = 576 if config['use_dino'] else n
        tokens = rng.standard_normal((n, d), np.float32)
        pair = rng.standard_normal((2 * n, d), np.float32)
        features = rng.standard_normal((2, condition, d), np.float32) if config['use_dino'] else pair.reshape(2, n, d)
        inputs = {'encoder': [tokens], 'upsampler': [pair[:n].copy()], 'decoder': [pair, features]}
        file = folder / 'inputs.safetensors'
        save_file({'encoder': tokens, 'upsampler': pair[:n].copy(), 'decoder': pair, 'condition': features}, file)
        results = []
        for stage in o.stages.split(','):
            double = modules.build(config, {k: v for k, v in load(model).items()})[stage].double()
            with torch.inference_mode():
                truth = double(*[torch.from_numpy(x).double() for x in inputs[stage]]).numpy()
            del double
            for precision in o.precisions.split(','):
                results += compare(o, stage, precision, parts[stage], inputs[stage], truth, program, str(model), str(file),
                                   [p for p in (Torch, OnnxRuntime, OpenVino) if p.name in o.peers.split(',')], Ours, Unavailable, seconds)
    report(o, results)


def load(path):
    from safetensors.numpy import load_file
    return {k.removeprefix('model.'): v for k, v in load_file(path).items()}


def compare(o, stage, precision, module, inputs, truth, program, model, file, peers, Ours, Unavailable, seconds):
    """Checks and times one stage in one precision on all runners, in turn."""
    import numpy as np
    runners = [Ours(stage, precision, program, model, file, o.threads)]
    for peer in peers:
        if stage not in peer.modes.get(precision, ()):
            continue
        try:
            runners.append(peer(stage, precision, module, inputs, o.threads))
        except Unavailable as why:
            print(f'{stage} {precision} {peer.name}: left out, {why}', flush=True)
    errors = []
    for runner in runners:
        out = runner.run().astype(np.float64)
        error = float(np.linalg.norm(out - truth) / np.linalg.norm(truth))
        errors.append(error)
        if not error <= TOLERANCE[precision]:
            raise SystemExit(f'{stage} {precision}: {runner.name} is {error:.2e} from float64, at most {TOLERANCE[precision]} expected')
    times = [[] for _ in runners]
    for _ in range(o.rounds):
        for runner, t in zip(runners, times):
            t.append(seconds(runner))
    rows = []
    def summary(values):
        return dict(min=min(values), median=statistics.median(values), max=max(values))

    for runner, error, t in zip(runners, errors, times):
        (clock, processor), ours = zip(*t), list(zip(*times[0]))
        ratios = [[a / b for a, b in zip(ours[i], theirs)] for i, theirs in enumerate((clock, processor))]
        rows.append(dict(stage=stage, precision=precision, runner=runner.name, relative_l2=error,
                         seconds=summary(clock), ours_over_this=summary(ratios[0]),
                         processor=summary(processor), processor_ours_over_this=summary(ratios[1])))
        print('{stage:10} {precision:5} {runner:12} error {relative_l2:.1e}'.format(**rows[-1]),
              'median {median:8.4f} s'.format(**rows[-1]['seconds']), 'ours/this {median:.3f} ({min:.3f}–{max:.3f})'.format(**rows[-1]['ours_over_this']),
              'processor {median:8.4f} s'.format(**rows[-1]['processor']), 'ours/this {median:.3f} ({min:.3f}–{max:.3f})'.format(**rows[-1]['processor_ours_over_this']), flush=True)
    return rows


def report(o, results):
    cpu = next((line.split(':', 1)[1].strip() for line in open('/proc/cpuinfo') if line.startswith('model name')), 'unknown')
    flags = next((line.split() for line in open('/proc/cpuinfo') if line.startswith('flags')), [])
    commit = subprocess.run(['git', 'rev-parse', '--short', 'HEAD'], cwd=ROOT, capture_output=True, text=True).stdout.strip()
    isa = [f for f in ('avx2', 'fma', 'avx512f', 'avx512_bf16', 'avx512_vnni') if f in flags]
    date = datetime.date.today().isoformat()
    head = dict(date=date, commit=commit, cpu=cpu, isa=isa, threads=o.threads, size=o.size, rounds=o.rounds,
                peers=(HERE / 'requirements.txt').read_text().split('\n')[1:-1])
    lines = [f'# Peers, {o.size} size, {date}', '', f'{cpu} ({", ".join(isa)}), {o.threads} threads, commit {commit}, {o.rounds} rounds in turn.', '',
             '| stage | precision | runner | seconds: median (min–max) | ours / this: median (min–max) | relative L2 from float64 |', '|---|---|---|---|---|---|']
    for r in results:
        s, q = r['seconds'], r['ours_over_this']
        lines.append(f"| {r['stage']} | {r['precision']} | {r['runner']} | {s['median']:.3f} ({s['min']:.3f}–{s['max']:.3f}) | "
                     f"{q['median']:.3f} ({q['min']:.3f}–{q['max']:.3f}) | {r['relative_l2']:.1e} |")
    text = '\n'.join(lines) + '\n'
    print(text)
    if not o.no_record:
        record = ROOT / 'bench' / 'record'
        record.mkdir(exist_ok=True)
        machine = re.sub(r'[^a-z0-9]+', '-', f"{cpu} {'avx512' if 'avx512f' in isa else 'avx2'}".lower()).strip('-')
        stem = record / f'peers-{o.size}-{date}-{machine}'
        stem.with_suffix('.json').write_text(json.dumps(dict(head, results=results), indent=1) + '\n')


if __name__ == '__main__':
    main()
