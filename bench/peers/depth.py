"""The backbone of a depth network, a DINOv2 ViT: ours against ONNX Runtime, on the same seeded weights, in one run.

`python3 bench/peers/depth.py` builds the release program, writes the weights as a DINOv2 file and as ONNX graphs, checks that the patch
tokens agree, then times all runners in turn, round after round, and writes bench/record/depth-DATE-CPU.json.

`python3 bench/peers/depth.py --write FOLDER` only writes the inputs of a run at the paper's size, with seeded weights: model.safetensors (the official layout),
dinov2.safetensors (ViT-B/14 with registers) and depth.onnx (a ViT-S for frames of 924×518, with one layer on top that turns its tokens into a map).
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
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
ENVIRONMENT = ROOT / 'target' / 'outside' / 'python-depth-peers'
PACKAGES = ['numpy==2.4.6', 'safetensors==0.8.0', 'onnx==1.23.2', 'onnxruntime==1.31.1', 'pillow==13.0.0']
# Width and blocks; heads have 64 channels, the hidden layers four times the width.
MODELS = {'vit-s': (384, 12), 'vit-b': (768, 12)}
# Largest relative L2 distance of two runners that count as the same function.
TOLERANCE = 1e-4


def enter_environment():
    python, stamp = ENVIRONMENT / 'bin' / 'python', ENVIRONMENT / 'wanted'
    if not stamp.exists() or stamp.read_text() != '\n'.join(PACKAGES):
        subprocess.run([sys.executable, '-m', 'venv', ENVIRONMENT], check=True)
        subprocess.run([python, '-m', 'pip', 'install', '--quiet', '--disable-pip-version-check', *PACKAGES], check=True)
        stamp.write_text('\n'.join(PACKAGES))
    if Path(sys.prefix).resolve() != ENVIRONMENT.resolve():
        os.execv(python, [python, *sys.argv])


def arguments():
    a = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    a.add_argument('--models', default='vit-s,vit-b')
    a.add_argument('--sizes', default='518x518,448x252', help='WIDTHxHEIGHT, multiples of 14')
    a.add_argument('--threads', type=int, default=2)
    a.add_argument('--rounds', type=int, default=5)
    a.add_argument('--clock', choices=('wall', 'cpu'), default='wall', help='cpu: processor time, which other work on the machine does not add to; with --threads 1')
    a.add_argument('--note', default='', help='what else ran on the machine, for the record')
    a.add_argument('--no-record', action='store_true')
    a.add_argument('--write', type=Path, metavar='FOLDER', help='write the files of a run of the paper\'s size instead')
    return a.parse_args()


def weights(width, depth):
    """Seeded weights under DINOv2's own names: ViT with patches of 14, four registers, positions on a 37×37 grid."""
    import numpy as np
    rng = np.random.default_rng(5)

    def normal(*shape, scale):
        return (scale * rng.standard_normal(shape)).astype(np.float32)

    w = {'cls_token': normal(1, 1, width, scale=0.2), 'register_tokens': normal(1, 4, width, scale=0.2),
         'pos_embed': normal(1, 1 + 37 * 37, width, scale=0.2),
         'patch_embed.proj.weight': normal(width, 3, 14, 14, scale=1.2 / (3 * 196) ** 0.5), 'patch_embed.proj.bias': normal(width, scale=0.1)}

    def norm(name):
        w[f'{name}.weight'], w[f'{name}.bias'] = 1 + normal(width, scale=0.1), normal(width, scale=0.1)

    def linear(name, out, into):
        w[f'{name}.weight'], w[f'{name}.bias'] = normal(out, into, scale=1.2 / into ** 0.5), normal(out, scale=0.1)

    for i in range(depth):
        b = f'blocks.{i}'
        norm(f'{b}.norm1')
        linear(f'{b}.attn.qkv', 3 * width, width)
        linear(f'{b}.attn.proj', width, width)
        w[f'{b}.ls1.gamma'] = 0.3 + normal(width, scale=0.05)
        norm(f'{b}.norm2')
        linear(f'{b}.mlp.fc1', 4 * width, width)
        linear(f'{b}.mlp.fc2', width, 4 * width)
        w[f'{b}.ls2.gamma'] = 0.3 + normal(width, scale=0.05)
    norm('norm')
    return w


def positions(table, rows, columns):
    """The 37×37 grid at another size: Pillow's cubic (−½) with antialiasing, the width first."""
    import numpy as np
    from PIL import Image
    if (rows, columns) == (37, 37):
        return table
    grid = table.reshape(37, 37, -1)
    planes = [np.asarray(Image.fromarray(np.ascontiguousarray(grid[..., c])).resize((columns, rows), Image.Resampling.BICUBIC))
              for c in range(grid.shape[-1])]
    return np.stack(planes, -1).reshape(rows * columns, -1)


def graph(w, width, depth, height, length, fused, head=False):
    """Frame [1, 3, H, W] → patch tokens [M, D], or with a head a map [1, H/14, W/14]. Attention is written out, or the runtime's own operator."""
    import numpy as np
    from onnx import TensorProto, helper, numpy_helper
    heads, m = width // 64, height * length // 196
    n, nodes, constants, count = m + 5, [], {}, iter(range(10 ** 6))

    def constant(name, value, kind=np.float32):
        constants.setdefault(name, np.asarray(value, kind))
        return name

    def op(kind, *inputs, domain='', **attributes):
        out = f'v{next(count)}'
        nodes.append(helper.make_node(kind, list(inputs), [out], domain=domain, **attributes))
        return out

    def linear(x, name):
        product = op('MatMul', x, constant(f'{name}.matrix', w[f'{name}.weight'].T.copy()))
        return op('Add', product, constant(f'{name}.bias', w[f'{name}.bias']))

    def norm(x, name):
        return op('LayerNormalization', x, constant(f'{name}.weight', w[f'{name}.weight']), constant(f'{name}.bias', w[f'{name}.bias']),
                  axis=-1, epsilon=1e-6)

    def attention(x, name):
        qkv = linear(x, f'{name}.qkv')
        if fused:
            q, k, v = (op('Slice', qkv, constant(f'from {p}', [p * width], np.int64), constant(f'to {p}', [(p + 1) * width], np.int64),
                          constant('channels', [2], np.int64)) for p in range(3))
            mixed = op('MultiHeadAttention', q, k, v, domain='com.microsoft', num_heads=heads)
        else:
            split = op('Reshape', qkv, constant('split', [1, n, 3, heads, 64], np.int64))
            turned = op('Transpose', split, perm=[2, 0, 3, 1, 4])
            q, k, v = (op('Gather', turned, constant(f'part {p}', p, np.int64), axis=0) for p in range(3))
            scores = op('MatMul', op('Mul', q, constant('scale', 0.125)), op('Transpose', k, perm=[0, 1, 3, 2]))
            mixed = op('MatMul', op('Softmax', scores, axis=-1), v)
            mixed = op('Reshape', op('Transpose', mixed, perm=[0, 2, 1, 3]), constant('joined', [1, n, width], np.int64))
        return linear(mixed, f'{name}.proj')

    patches = op('Conv', 'frame', constant('kernel', w['patch_embed.proj.weight']), constant('kernel bias', w['patch_embed.proj.bias']),
                 strides=[14, 14])
    tokens = op('Transpose', op('Reshape', patches, constant('flat', [1, width, m], np.int64)), perm=[0, 2, 1])
    table = w['pos_embed'][0]
    tokens = op('Add', tokens, constant('positions', positions(table[1:], height // 14, length // 14)[None]))
    first = np.concatenate([w['cls_token'] + table[None, :1], w['register_tokens']], 1)
    x = op('Concat', constant('first', first), tokens, axis=1)
    for i in range(depth):
        b = f'blocks.{i}'
        x = op('Add', x, op('Mul', attention(norm(x, f'{b}.norm1'), f'{b}.attn'), constant(f'{b}.ls1', w[f'{b}.ls1.gamma'])))
        hidden = op('Gelu', linear(norm(x, f'{b}.norm2'), f'{b}.mlp.fc1'))
        x = op('Add', x, op('Mul', linear(hidden, f'{b}.mlp.fc2'), constant(f'{b}.ls2', w[f'{b}.ls2.gamma'])))
    x = norm(x, 'norm')
    x = op('Slice', x, constant('after', [5], np.int64), constant('end', [n], np.int64), constant('tokens', [1], np.int64))
    shape = [m, width]
    if head:
        x = op('Sigmoid', op('MatMul', x, constant('head', np.sin(np.arange(width))[:, None] / width ** 0.5)))
        shape = [1, height // 14, length // 14]
    nodes.append(helper.make_node('Reshape', [x, constant('table', shape, np.int64)], ['out']))
    made = helper.make_graph(nodes, 'vit', [helper.make_tensor_value_info('frame', TensorProto.FLOAT, [1, 3, height, length])],
                             [helper.make_tensor_value_info('out', TensorProto.FLOAT, shape)],
                             [numpy_helper.from_array(value, name) for name, value in constants.items()])
    opsets = [helper.make_opsetid('', 20), helper.make_opsetid('com.microsoft', 1)]
    model = helper.make_model(made, opset_imports=opsets)
    model.ir_version = 9
    return model.SerializeToString()


class Ours:
    name = 'streamsplat'

    def __init__(self, program, file, inputs, threads, clock):
        command = [program, 'serve', '--dinov2', file, '--input', inputs, '--threads', str(threads)]
        self.clock = clock
        self.server = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def ask(self, **request):
        self.server.stdin.write(json.dumps(dict(request, stage='dinov2')) + '\n')
        self.server.stdin.flush()
        line = self.server.stdout.readline()
        if not line:
            raise SystemExit('streamsplat-bench serve ended')
        return json.loads(line)

    def output(self, folder):
        from safetensors.numpy import load_file
        self.ask(write=str(folder / 'ours.safetensors'))
        return load_file(folder / 'ours.safetensors')['out']

    def processor_time(self):
        """Processor time of the server so far, of all its threads, in steps of 10 ms."""
        fields = Path(f'/proc/{self.server.pid}/stat').read_text().rsplit(')', 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')

    def seconds(self):
        if self.clock == 'wall':
            return self.ask()['seconds']
        start = self.processor_time()
        self.ask()
        return self.processor_time() - start

    def close(self):
        self.server.stdin.close()
        self.server.wait()


class OnnxRuntime:
    def __init__(self, name, model, frame, threads, clock='wall'):
        import onnxruntime
        self.clock = time.perf_counter if clock == 'wall' else time.process_time
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads, options.inter_op_num_threads, options.log_severity_level = threads, 1, 3
        self.name, self.feed = name, {'frame': frame[None]}
        self.session = onnxruntime.InferenceSession(model, options, providers=['CPUExecutionProvider'])

    def output(self, _folder):
        return self.session.run(None, self.feed)[0]

    def seconds(self):
        start = self.clock()
        self.session.run(None, self.feed)
        return self.clock() - start

    def close(self):
        del self.session


def compare(o, name, size, program, folder):
    import numpy as np
    from safetensors.numpy import save_file
    width, depth = MODELS[name]
    length, height = map(int, size.split('x'))
    w = weights(width, depth)
    file, inputs = folder / 'dinov2.safetensors', folder / 'inputs.safetensors'
    save_file(w, file)
    file.with_suffix('.json').write_text(json.dumps({'resized_to': [height, length]}))
    frame = np.random.default_rng(8).random((3, height, length), np.float32)
    save_file({'frame': frame}, inputs)
    runners = [Ours(program, str(file), str(inputs), o.threads, o.clock)]
    runners += [OnnxRuntime(f'onnxruntime, {kind} attention', graph(w, width, depth, height, length, fused), frame, o.threads, o.clock)
                for kind, fused in (('written out', False), ('fused', True))]
    outputs = [runner.output(folder).astype(np.float64) for runner in runners]
    apart = [float(np.linalg.norm(x - outputs[0]) / np.linalg.norm(outputs[0])) for x in outputs]
    if not max(apart) <= TOLERANCE:
        raise SystemExit(f'{name} {size}: the runners are {apart} from ours, at most {TOLERANCE} expected')
    times = [[] for _ in runners]
    for _ in range(o.rounds):
        for runner, t in zip(runners, times):
            t.append(runner.seconds())
    rows = []
    for runner, distance, t in zip(runners, apart, times):
        ratios = [a / b for a, b in zip(times[0], t)]
        spread = lambda x: dict(min=min(x), median=statistics.median(x), max=max(x))  # noqa: E731
        rows.append(dict(model=name, size=size, tokens=height * length // 196 + 5, runner=runner.name, relative_l2_from_ours=distance,
                         seconds=spread(t), ours_over_this=spread(ratios)))
        print(json.dumps(rows[-1]), flush=True)
        runner.close()
    return rows


def report(o, results):
    cpu = next((line.split(':', 1)[1].strip() for line in open('/proc/cpuinfo') if line.startswith('model name')), 'unknown')
    commit = subprocess.run(['git', 'rev-parse', '--short', 'HEAD'], cwd=ROOT, capture_output=True, text=True).stdout.strip()
    date = datetime.date.today().isoformat()
    head = dict(date=date, commit=commit, cpu=cpu, threads=o.threads, rounds=o.rounds, clock=o.clock, packages=PACKAGES, note=o.note, load=os.getloadavg()[0])
    lines = [f'# Backbones of depth networks, {date}', '',
             f'{cpu}, {o.threads} threads, commit {commit}, {o.rounds} rounds in turn, {o.clock} time, load {head["load"]:.1f}. {o.note}'.strip(), '',
             '| model | input | tokens | runner | seconds: median (min–max) | ours / this: median (min–max) | relative L2 from ours |',
             '|---|---|---|---|---|---|---|']
    for r in results:
        s, q = r['seconds'], r['ours_over_this']
        lines.append(f"| {r['model']} | {r['size']} | {r['tokens']} | {r['runner']} | {s['median']:.3f} ({s['min']:.3f}–{s['max']:.3f}) | "
                     f"{q['median']:.3f} ({q['min']:.3f}–{q['max']:.3f}) | {r['relative_l2_from_ours']:.1e} |")
    text = '\n'.join(lines) + '\n'
    print(text)
    if not o.no_record:
        stem = ROOT / 'bench' / 'record' / f"depth-{date}-{re.sub(r'[^a-z0-9]+', '-', cpu.lower()).strip('-')}"
        stem.with_suffix('.json').write_text(json.dumps(dict(head, results=results), indent=1) + '\n')


def write(folder):
    from safetensors.numpy import save_file
    folder.mkdir(parents=True, exist_ok=True)
    parity = ROOT / 'fixtures' / 'parity'
    subprocess.run([sys.executable, parity / 'make_weights.py', parity / 'paper-dino.json', folder / 'model.safetensors'], check=True)
    save_file(weights(*MODELS['vit-b']), folder / 'dinov2.safetensors')
    width, depth = MODELS['vit-s']
    (folder / 'depth.onnx').write_bytes(graph(weights(width, depth), width, depth, 518, 924, fused=False, head=True))


def main():
    o = arguments()
    enter_environment()
    if o.write:
        return write(o.write)
    subprocess.run(['cargo', 'build', '--release', '--quiet', '-p', 'streamsplat-bench'], cwd=ROOT, check=True)
    target = Path(os.environ.get('CARGO_TARGET_DIR', ROOT / 'target'))
    results = []
    with tempfile.TemporaryDirectory(prefix='depth-peers-') as folder:
        for name in o.models.split(','):
            for size in o.sizes.split(','):
                results += compare(o, name, size, str(target / 'release' / 'streamsplat-bench'), Path(folder))
    report(o, results)


if __name__ == '__main__':
    main()
