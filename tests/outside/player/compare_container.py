"""compare_container.py STREAMSPLAT SCENE-FOLDER CONTAINER [CONTAINER…]: the result of read_container.py, compared with the scene's own files; and a picture of
it with the program's. Other containers, which list times of frames, are read completely."""

import json
import struct
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

import numpy as np
from read_container import Broken, Container

KINDS = {'F32': '<f4', 'F64': '<f8', 'U64': '<u8', 'U8': 'u1'}


def safetensors(path):
    """The tensors of a file, by name."""
    data = path.read_bytes()
    (length,) = struct.unpack_from('<Q', data)
    header = json.loads(data[8:8 + length])
    body = data[8 + length:]
    tensors = {name: t for name, t in header.items() if name != '__metadata__'}
    return {name: np.frombuffer(body[slice(*t['data_offsets'])], KINDS[t['dtype']]).reshape(t['shape']) for name, t in tensors.items()}


def whole(values, steps):
    """Rounded to the nearest, ties to even."""
    return np.rint(values.astype(np.float64) * steps).astype(int)


def down(values):
    """⌊|x| + 0.35⌋ with the sign of x."""
    return (np.sign(values) * np.floor(np.abs(values) + 0.35)).astype(int)


def logarithm(values, steps=8):
    with np.errstate(divide='ignore'):
        return np.clip(np.rint(steps * np.log2(values.astype(np.float64))), -151 * steps, 127 * steps).astype(int)


def quantised(t):
    """The whole numbers of a scene's tensors, as in docs/container.md."""
    n = len(t['opacity'])
    out = {}
    for name, steps in (('mean', (2048, 16384, 2048)), ('offset', (1024, 128, 1024)), ('velocity', (1024,) * 3)):
        out |= {f'{name}_{axis}': whole(t[name][:, k], steps[k]) for k, axis in enumerate('xyz')}
    red, green, blue = whole(t['rgb'], 128).T
    out |= {'green': green, 'red': red - green, 'blue': blue - green}
    red, green, blue = 16 * t.get('rgb_rate', np.zeros((n, 3))).astype(np.float64).T
    out |= {'green_rate': down(green), 'red_rate': down(red - down(green)), 'blue_rate': down(blue - down(green))}
    out |= {'scale_x': logarithm(t['scale'][:, 0]), 'scale_z': logarithm(t['scale'][:, 1]), 'thickness': logarithm(t.get('thickness', np.ones(n)))}
    gamma_0 = np.minimum(4092, np.rint(32 * np.log1p(t['gamma'][:, 0].astype(np.float64)) / np.log(2)))
    return out | {'opacity': logarithm(t['opacity'], 16), 'gamma_0': gamma_0.astype(int), 'gamma_1': whole(t['gamma'][:, 1], 256)}


def drawn(container, time, width, height):
    """The source's view at a time, on black: docs/container.md, "What the numbers mean"."""
    i = next(i for i, entry in enumerate(container.intervals) if time <= entry['end'])
    entry, r = container.intervals[i], container.records(i)
    t = (time - entry['start']) / (entry['end'] - entry['start'])
    tau = t - r['reference']
    place = r['mean'] + r['velocity'] * tau[:, None]
    fading = (1 + np.exp(-r['gamma'][:, 0] * r['gamma'][:, 1])) / (1 + np.exp(np.minimum(600, r['gamma'][:, 0] * (np.abs(tau) - r['gamma'][:, 1]))))
    handover = np.select([r['handover'] == 1, r['handover'] == 2], [np.minimum(1, 8 * t), np.minimum(1, 8 * (1 - t))], 1.0)
    opacity = r['opacity'] * np.minimum(1, fading) * handover
    colour = r['rgb'] + r['rgb_rate'] * tau[:, None]
    (source, model, offset, content) = (np.array(pair, float) for pair in (container.source, container.model, container.offset, container.content))
    unit = source[1] / source[0] * content[0] * model[1] / (content[1] * model[0])
    middle = np.array([unit * ((2 * offset[1] + content[1]) / model[1] - 1), (2 * offset[0] + content[0]) / model[0] - 1])
    focal = np.array([width * model[1] / (2 * unit * content[1]), height * model[0] / (2 * content[0])])
    own = np.array([model[1] / (2 * unit), model[0] / 2])
    centre = np.array([width, height]) / 2 + focal * (np.stack([unit * place[:, 0], -place[:, 2]], 1) - middle)
    more = 0.3 * np.maximum(0, 1 / own**2 - 1 / focal**2)
    variance = focal**2 * ((np.array([unit, 1]) * r['scale']) ** 2 + more) + 0.3
    depth = 1 / (9.8 * place[:, 1] + 0.200001)
    picture, left = np.zeros((height, width, 3)), np.ones((height, width))
    for j in np.argsort(depth, kind='stable'):
        if not 0 <= place[j, 1] <= 1 or opacity[j] < 1 / 255:
            continue
        reach = np.sqrt(2 * np.log(255 * opacity[j]) * variance[j])
        (x0, y0), (x1, y1) = np.maximum(0, np.floor(centre[j] - reach)).astype(int), np.ceil(centre[j] + reach).astype(int) + 1
        rows, columns = np.arange(y0, min(y1, height)), np.arange(x0, min(x1, width))
        exponent = ((columns + 0.5 - centre[j, 0]) ** 2 / variance[j, 0])[None] + ((rows + 0.5 - centre[j, 1]) ** 2 / variance[j, 1])[:, None]
        alpha = np.minimum(0.99, opacity[j] * np.exp(-0.5 * exponent))
        alpha[alpha < 1 / 255] = 0
        part = left[y0:y1, x0:x1]
        picture[y0:y1, x0:x1] += (part * alpha)[..., None] * colour[j]
        part *= 1 - alpha
    return np.clip(picture, 0, 1)


def rendered(streamsplat, path, time, width, height):
    """The program's picture, from a PNG without filters that need more than the rows before."""
    with tempfile.TemporaryDirectory() as folder:
        size = ['--size', f'{width}x{height}', '--times', str(time), '--quiet', '--out', f'{folder}/out']
        subprocess.run([streamsplat, 'render', path, *size], check=True)
        data = Path(f'{folder}/out/frames/000000.png').read_bytes()
    at, deflated = 8, b''
    while at < len(data):
        (length,) = struct.unpack_from('>I', data, at)
        deflated += data[at + 8:at + 8 + length] if data[at + 4:at + 8] == b'IDAT' else b''
        at += 12 + length
    rows = np.frombuffer(zlib.decompress(deflated), np.uint8).reshape(height, 1 + 3 * width).astype(int)
    picture = np.zeros((height + 1, 3 * width + 3), int)
    for y, (kind, *row) in enumerate(rows):
        for x, value in enumerate(row):
            a, b, c = picture[y + 1, x], picture[y, x + 3], picture[y, x]
            paeth = min((abs(b - c), 0, a), (abs(a - c), 1, b), (abs(a + b - 2 * c), 2, c))[2]
            picture[y + 1, x + 3] = (value + (0, a, b, (a + b) // 2, paeth)[kind]) & 255
    return picture[1:, 3:].reshape(height, width, 3) / 255


def check(holds, what):
    if not holds:
        sys.exit(what)


def main(streamsplat, folder, path, *others):
    folder = Path(folder)
    index = json.loads((folder / 'scene.json').read_text())
    container = Container(path)
    check(len(container.intervals) == len(index['intervals']) and container.fps == index['fps'], 'the index: expected as many intervals and the rate')
    for name in ('source', 'model', 'offset', 'content'):
        check(list(getattr(container, name)) == index['placement'][name], f'{name}: expected {index["placement"][name]}, found {getattr(container, name)}')
    numbers = 0
    for i, entry in enumerate(index['intervals']):
        theirs, q, ours = safetensors(folder / entry['file']), container.whole(i), container.records(i)
        mine = container.intervals[i]
        check([mine['start'], mine['end']] == theirs['time'].tolist() and mine['index'] == theirs['index'][0], f'interval {i}: times and key frame')
        check(np.array_equal(np.array(mine['frames']), entry.get('frames', [])), f'interval {i}: times of frames')
        for name in ('identity', 'birth', 'frame', 'reference', 'handover', 'merges'):
            check(np.array_equal(ours[name], theirs[name]), f'interval {i}: {name}')
        for name, values in quantised(theirs).items():
            differ = np.flatnonzero(q[name] != values)
            check(not len(differ), f'interval {i}: {name}: {len(differ)} of {len(values)} differ, the first at {differ[:1]}')
            numbers += len(values)
        steps = {'mean': np.array([2048, 16384, 2048]), 'velocity': 1024, 'offset': np.array([1024, 128, 1024]), 'rgb': 128, 'rgb_rate': 16}
        for name, unit in steps.items():
            far = (np.abs(ours[name] - theirs.get(name, np.zeros_like(ours[name]))) * unit).max(initial=0)
            check(far <= (0.65 if name == 'rgb_rate' else 0.5) + 1e-6, f'interval {i}: {name}: {far} steps off')
        for name, steps in (('scale', 8), ('thickness', 8), ('opacity', 16)):
            ratio = np.abs(np.log2(np.maximum(ours[name], 1e-30) / np.maximum(theirs.get(name, np.ones_like(ours[name])), 1e-30))).max(initial=0) * steps
            check(ratio <= 0.5 + 1e-4, f'interval {i}: {name}: {ratio} steps off')
    size = (128, 72)
    off = ((drawn(container, 0.3, *size) - rendered(streamsplat, path, 0.3, *size)) ** 2).mean()
    check(off < 10 ** -4.5, f'a picture: expected 45 dB from our render, found {-10 * np.log10(off):.1f}')
    # Refusals: a changed bit anywhere that counts, and a file truncated anywhere.
    data = Path(path).read_bytes()
    damaged = Path(path).with_name('damaged.ssz')
    for at in (0, 8, 40, len(data) // 2, len(data) - 40, len(data) - 200):
        for bytes_ in (data[:at] + bytes([data[at] ^ 1]) + data[at + 1:], data[:at]):
            damaged.write_bytes(bytes_)
            try:
                broken = Container(damaged)
                for i in range(len(broken.intervals)):
                    broken.columns(i)
            except Broken:
                continue
            sys.exit(f'byte {at}: expected an error, found none')
    for other in map(Container, others):
        for i, entry in enumerate(other.intervals):
            check(len(other.records(i)['opacity']) == entry['gaussians'], f'{other.file.name}: interval {i}')
        check(any(entry['frames'] for entry in other.intervals), f'{other.file.name}: expected times of frames')
    lines = len(Path(__file__).with_name('read_container.py').read_text().splitlines())
    check(lines <= 200, f'read_container.py: expected at most 200 lines, found {lines}')
    print(f'a reader of {lines} lines in Python: {numbers} numbers of {len(index["intervals"])} intervals as in the folder, a picture at {-10 * np.log10(off):.1f} dB')


main(*sys.argv[1:])
