"""Checks of tests/outside/onnx/run: check.py PROGRAM. Every check is a function; the first that fails ends the program."""
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import onnxruntime
from PIL import Image

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / 'fixtures' / 'depth'))
import make  # noqa: E402

PROGRAM = Path(sys.argv[1]).resolve()
MODEL = ROOT / 'fixtures' / 'parity' / 'tiny-nodino.safetensors'
DEPTH = ROOT / 'fixtures' / 'depth' / 'depth.onnx'
CAPI = Path(onnxruntime.__file__).parent / 'capi'
LIBRARY = next(CAPI.glob('libonnxruntime.so.*'))
# Nothing in the caller's environment may find a library; only the variable of tests/mutations/run is passed on.
MUTATION = {name: os.environ[name] for name in ['STREAMSPLAT_MUTATION'] if name in os.environ}
BARE = {'PATH': '/nowhere', 'HOME': os.environ.get('HOME', '/'), **MUTATION}
WITH = {**BARE, 'ORT_DYLIB_PATH': str(LIBRARY)}


def program(*arguments, env=WITH, binary=PROGRAM):
    return subprocess.run([str(binary), *map(str, arguments)], env=env, capture_output=True, text=True)


def run(clip, out, *more, env=WITH, binary=PROGRAM):
    return program('run', clip, '--model', MODEL, '--out', out, '--quiet', *more, env=env, binary=binary)


def works(done):
    assert done.returncode == 0, done.stderr
    assert done.stderr == '', f'said something: {done.stderr}'


def fails(done, *expected):
    """Exit code 1 and one line that contains all of these words."""
    assert done.returncode == 1, (done.returncode, done.stderr)
    assert done.stderr.startswith('streamsplat: ') and done.stderr.count('\n') == 1, done.stderr
    for words in expected:
        assert str(words) in done.stderr, (words, done.stderr)


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(Path(folder).rglob('*'))
            if p.is_file() and p.name not in ('run.json', 'report.md')}


def frames(folder):
    return np.stack([np.asarray(Image.open(p), np.int32) for p in sorted((Path(folder) / 'frames').iterdir())])


def write_clip(folder, width=96, height=64, count=5, repeated=()):
    folder.mkdir()
    y, x = np.mgrid[0:height, 0:width]
    for k in range(count):
        t = k - 1 if k in repeated else k
        inside = (abs(x - 20 - 6 * t) < 14) & (abs(y - 30) < 14)
        picture = np.stack([x * 2, y * 3, (x ^ y) * 2], -1)
        picture[inside] = [240, 80, 30]
        Image.fromarray(picture.astype(np.uint8)).save(folder / f'{k}.png')
    return folder


def reference_maps(network, clip, out, size, mean=(0.485, 0.456, 0.406), std=(0.229, 0.224, 0.225),
                   metric=False, output=None):
    """Maps of every frame, made here: Pillow's cubic, this package's runtime; left in the network's size."""
    session = onnxruntime.InferenceSession(str(network), providers=['CPUExecutionProvider'])
    wanted = session.get_inputs()[0]
    out.mkdir()
    for path in sorted(clip.iterdir()):
        picture = np.asarray(Image.open(path), np.float32) / 255
        planes = [np.asarray(Image.fromarray(picture[..., c]).resize(size, Image.Resampling.BICUBIC)) for c in range(3)]
        planes = [(np.clip(p, 0, 1) - m) / s for p, m, s in zip(planes, mean, std)]
        tensor = np.stack(planes).astype(np.float32).reshape([1] * (len(wanted.shape) - 3) + [3, size[1], size[0]])
        answer = session.run([output] if output else None, {wanted.name: tensor})[0]
        answer = answer.reshape(answer.shape[-2:])
        np.save(out / f'{path.stem}.npy', 1 / answer if metric else answer)
    return out


def the_same_bytes_for_any_number_of_threads(at):
    clip = write_clip(at / 'clip')
    options = ['--gap', '2', '--depth', f'onnx:{DEPTH}', '--depth-model', 'size=140', '--emit', 'rgb,depth,scene']
    expected = None
    for name, more in (('first', []), ('again', []), ('one', ['--threads', '1']), ('two', ['--threads', '2']), ('five', ['--threads', '5']),
                       ('scalar', ['--isa', 'scalar'])):
        works(run(clip, at / name, *options, *more))
        found = files(at / name)
        expected = expected or found
        assert len(found) > 10 and found == expected, name
    record = json.loads((at / 'first' / 'run.json').read_text())
    assert record['depth']['runtime'] == f'ONNX Runtime {onnxruntime.__version__}', record['depth']
    assert record['work']['depth'] == {'done': 3, 'avoided': 0, 'unit': 'frames'}, record['work']['depth']
    for threads in ('1', '2'):
        done = program('verify', at / 'first', '--threads', threads)
        assert done.returncode == 0 and 'all digests equal' in done.stdout, done.stdout + done.stderr
    works(run(clip, at / 'none', '--gap', '2', '--emit', 'rgb,depth,scene'))
    assert files(at / 'none') != expected, 'depth makes no difference'


def maps_are_those_of_the_reference(at):
    clip = write_clip(at / 'clip')
    works(run(clip, at / 'none'))
    flat = frames(at / 'none')
    kinds = [
        ('open', {}, '', (784, 518), {}),
        ('small', {}, 'size=126', (196, 126), {}),
        ('exact', {}, 'size=112x140', (112, 140), {}),
        ('fixed', dict(sides=(70, 126)), '', (126, 70), {}),
        ('half', dict(sides=(70, 'width')), '', (112, 70), {}),
        ('metric', dict(metric=True), 'size=126,metric', (196, 126), dict(metric=True)),
        ('several', dict(outputs=('other', 'depth')), 'size=126,output=depth', (196, 126), dict(output='depth')),
        ('axes', dict(leading=2), 'size=126', (196, 126), {}),
        ('levels', {}, 'size=126,mean=0.5,std=0.25/0.5/0.5', (196, 126), dict(mean=[0.5] * 3, std=[0.25, 0.5, 0.5])),
    ]
    for name, form, options, size, how in kinds:
        network = at / f'{name}.onnx'
        make.save(make.depth(**form), network)
        more = ['--depth-model', options] if options else []
        works(run(clip, at / name, '--depth', f'onnx:{network}', *more))
        maps = reference_maps(network, clip, at / f'{name}-maps', size, **how)
        works(run(clip, at / f'{name}-reference', '--depth', maps))
        ours, theirs = frames(at / name), frames(at / f'{name}-reference')
        apart, from_none = abs(ours - theirs).max(), abs(ours - flat).max()
        assert apart <= 1, f'{name}: {apart} levels from the reference'
        assert from_none > 8, f'{name}: only {from_none} levels from no depth at all'


def a_repeated_frame_is_not_looked_at_twice(at):
    clip = write_clip(at / 'clip', repeated=(2, 4))
    depth = ['--depth', f'onnx:{DEPTH}', '--depth-model', 'size=126']
    works(run(clip, at / 'out', *depth))
    work = json.loads((at / 'out' / 'run.json').read_text())['work']['depth']
    assert work == {'done': 3, 'avoided': 2, 'unit': 'frames'}, work
    works(run(clip, at / 'off', *depth, '--reuse', 'off'))
    assert files(at / 'off') == files(at / 'out')


def a_stopped_run_goes_on_to_the_same_bytes(at):
    clip = write_clip(at / 'clip', count=40)
    options = ['--gap', '2', '--depth', f'onnx:{DEPTH}', '--depth-model', 'size=70', '--emit', 'rgb,depth,scene']
    works(run(clip, at / 'whole', *options))
    command = [PROGRAM, 'run', clip, '--model', MODEL, '--out', at / 'out', '--quiet', *options]
    stopped = subprocess.Popen([str(part) for part in command], env=WITH)
    while not (at / 'out' / 'scene' / 'interval-000003.safetensors').exists():
        assert stopped.poll() is None, 'it ended before there was something to stop'
        time.sleep(0.001)
    stopped.kill()
    stopped.wait()
    assert not (at / 'out' / 'run.json').exists(), 'it ended before it was stopped'
    works(run(clip, at / 'out', *options, '--resume'))
    assert files(at / 'out') == files(at / 'whole')
    record = json.loads((at / 'out' / 'run.json').read_text())
    whole = json.loads((at / 'whole' / 'run.json').read_text())
    for part in ('outputs', 'input', 'depth'):
        assert record[part] == whole[part], part
    # Another network would compute other maps: the run is not the same.
    make.save(make.depth(sides=(70, 126)), at / 'other.onnx')
    other = [f'onnx:{at / "other.onnx"}' if part == f'onnx:{DEPTH}' else part for part in options]
    done = run(clip, at / 'out', *other[:4], *other[6:], '--resume')
    assert done.returncode != 0 and 'depth' in done.stderr, (done.returncode, done.stderr)


def the_library_is_found_in_every_place(at):
    clip = write_clip(at / 'clip', count=2)
    depth = ['--depth', f'onnx:{DEPTH}', '--depth-model', 'size=70']
    works(run(clip, at / 'named', *depth))
    venv = Path(sys.prefix)
    works(run(clip, at / 'venv', *depth, env={**BARE, 'VIRTUAL_ENV': str(venv)}))
    works(run(clip, at / 'python', *depth, env={**BARE, 'PATH': str(venv / 'bin')}))
    # Python is queried, but runs nothing that the environment or the working folder provides.
    (at / 'planted').mkdir()
    for name in ('sitecustomize.py', 'onnxruntime.py', 'importlib.py'):
        (at / 'planted' / name).write_text(f"open({str(at / 'ran')!r}, 'w')\n")
    planted = {**BARE, 'VIRTUAL_ENV': str(venv), 'PYTHONPATH': str(at / 'planted')}
    works(run(clip, at / 'isolated', *depth, env=planted))
    assert not (at / 'ran').exists(), 'a file that PYTHONPATH leads to was run'
    (at / 'beside').mkdir()
    shutil.copy(PROGRAM, at / 'beside' / 'streamsplat')
    (at / 'beside' / LIBRARY.name).symlink_to(LIBRARY)
    works(run(clip, at / 'out', *depth, env=BARE, binary=at / 'beside' / 'streamsplat'))
    assert files(at / 'named') == files(at / 'venv') == files(at / 'python') == files(at / 'out')


def libraries_that_cannot_be_used_give_one_line(at):
    clip = write_clip(at / 'clip', count=2)

    def attempt(env):
        done = run(clip, at / 'out', '--depth', f'onnx:{DEPTH}', env=env)
        assert not (at / 'out').exists(), 'a folder is left'
        return done

    def compiled(name, *flags):
        path = at / name
        source = Path(__file__).with_name('library.c')
        subprocess.run(['cc', '-shared', '-fPIC', *flags, '-o', str(path), str(source)], check=True)
        return path

    install = "python3 -m pip install 'onnxruntime>=1.24'"
    fails(attempt(BARE), 'ONNX Runtime is not installed', 'no python3', install)
    # A Python without the package: this one, isolated from its packages.
    (at / 'bin').mkdir()
    bare = at / 'bin' / 'python3'
    bare.write_text(f'#!/bin/sh\nexec {sys.executable} -S "$@"\n')
    bare.chmod(0o755)
    fails(attempt({**BARE, 'PATH': str(at / 'bin')}), 'ONNX Runtime is not installed', 'python3 has no package onnxruntime', install)

    absent = at / 'absent.so'
    fails(attempt({**BARE, 'ORT_DYLIB_PATH': str(absent)}), f'ORT_DYLIB_PATH={absent}: no such file')
    text = at / 'text.so'
    text.write_text('no library')
    cut = at / 'cut.so'
    cut.write_bytes(LIBRARY.read_bytes()[:100_000])
    for broken in (text, cut, compiled('other.so'), compiled('odd.so', '-DVERSION="none"'), compiled('hollow.so', '-DVERSION="1.99.0"')):
        fails(attempt({**BARE, 'ORT_DYLIB_PATH': str(broken)}), broken, "expected ONNX Runtime's shared library", '--force-reinstall')
    old = compiled('old.so', '-DVERSION="1.17.3"')
    fails(attempt({**BARE, 'ORT_DYLIB_PATH': str(old)}), old, 'expected ONNX Runtime 1.24 or newer, found 1.17.3', '--upgrade')


def networks_that_cannot_be_used_give_one_line(at):
    clip = write_clip(at / 'clip', count=2)
    (at / 'networks').mkdir()

    def attempt(name, *more):
        done = run(clip, at / 'out', '--depth', f'onnx:{at / "networks" / name}', *more)
        assert not (at / 'out').exists(), 'a folder is left'
        return done

    def network(name, model):
        make.save(model, at / 'networks' / name)
        return name

    whole = DEPTH.read_bytes()
    for name, content, words in (('empty.onnx', b'', 'it is empty'), ('text.onnx', b'no network', 'cannot be loaded'),
                                 ('cut.onnx', whole[:len(whole) // 2], 'cannot be loaded')):
        (at / 'networks' / name).write_bytes(content)
        fails(attempt(name), name, words)
    fails(attempt('absent.onnx'), 'absent.onnx', 'No such file')
    (at / 'networks' / 'folder').mkdir()
    fails(attempt('folder'), 'folder', 'it is no file')
    fails(attempt(network('two.onnx', make.distance(32))), 'two.onnx: its inputs: expected one image', 'a Tensor<f32>', 'b Tensor<f32>')
    half = make.TensorProto.FLOAT16
    fails(attempt(network('half.onnx', make.depth(image=half))), 'half.onnx: its input image: expected one image, float', 'Tensor<f16>')
    several = network('several.onnx', make.depth(outputs=('near', 'far')))
    fails(attempt(several), 'its outputs: expected one map, or output=NAME', 'near Tensor<f32>', 'far Tensor<f32>')
    fails(attempt(several, '--depth-model', 'output=middle'), 'its outputs: expected middle', 'near')
    fixed = network('fixed.onnx', make.depth(sides=(70, 126)))
    fails(attempt(fixed, '--depth-model', 'size=140x70'), 'expected the 140x70 asked for, found 126 by 70')
    # Half of the patches of a side do not exist: the runtime itself refuses.
    fails(attempt(network('open.onnx', make.depth()), '--depth-model', 'size=5x5'), 'open.onnx: the network failed')


def pictures_are_as_far_apart_as_the_network_says(at):
    clip = write_clip(at / 'clip', width=256, height=256, count=5)
    make.save(make.distance(256), at / 'distance.onnx')
    make.save(make.distance('side'), at / 'open.onnx')
    make.save(make.distance(64), at / 'small.onnx')

    def evaluate(name):
        out = at / f'{name}.json'
        works(program('eval', clip, '--model', MODEL, '--gap', '4', '--quiet', '--json', out, '--lpips-model', at / f'{name}.onnx'))
        return json.loads(out.read_text())

    figures = evaluate('distance')
    pictures = [np.asarray(Image.open(p), np.float64) / 255 for p in sorted(clip.iterdir())]
    # Half the mean difference of values in [-1, 1] is the mean difference of values in [0, 1].
    nearest = np.mean([abs(pictures[k] - pictures[i]).mean() for i, k in ((1, 0), (2, 0), (3, 4))])
    mixed = [pictures[0] * (1 - i / 4) + pictures[4] * i / 4 for i in (1, 2, 3)]
    crossfade = np.mean([abs(m - pictures[i]).mean() for i, m in zip((1, 2, 3), mixed)])
    baselines = figures['mean']['baselines']
    assert abs(baselines['nearest']['lpips'] - nearest) < 1e-6, (baselines, nearest)
    assert abs(baselines['crossfade']['lpips'] - crossfade) < 1e-6, (baselines, crossfade)
    for part in ('key', 'middle'):
        assert 0 < figures['mean'][part]['lpips'] < 1
    assert figures['lpips']['runtime'] == f'ONNX Runtime {onnxruntime.__version__}'
    def figures_apart_from_time(of):
        return {name: figure for name, figure in of['mean'].items() if name != 'seconds_per_frame'}

    assert figures_apart_from_time(evaluate('open')) == figures_apart_from_time(figures)
    # At 64 pixels a side: four taps of the bilinear resizing, so only close.
    small = evaluate('small')['mean']['baselines']['nearest']['lpips']
    assert small > 0 and small != nearest and abs(small - nearest) < 0.1 * nearest, (small, nearest)
    without = at / 'without.json'
    works(program('eval', clip, '--model', MODEL, '--gap', '4', '--quiet', '--json', without))
    assert 'lpips' not in without.read_text()
    for network, words in ((DEPTH, 'its inputs: expected two images'), (at / 'absent.onnx', 'absent.onnx')):
        fails(program('eval', clip, '--model', MODEL, '--gap', '4', '--quiet', '--lpips-model', network), words)


def main():
    checks = [check for check in globals().values() if callable(check) and getattr(check, '__code__', None)
              and check.__code__.co_varnames[:check.__code__.co_argcount] == ('at',)]
    assert checks
    for check in checks:
        with tempfile.TemporaryDirectory(prefix='streamsplat-onnx-') as folder:
            check(Path(folder))
        print(f'{check.__name__}: ok', flush=True)


if __name__ == '__main__':
    main()
