"""A reader of containers (.ssz), written from docs/container.md alone. Needs NumPy.

    Container('clip.ssz').records(3)  # the fourth interval: arrays by name, in the units of the scene
"""

import struct
import zlib

import numpy as np

NAMES = ('kind link code identity birth frame mean_x mean_y mean_z offset_x offset_y offset_z opacity scale_x scale_z green red blue '
         'velocity_x velocity_y velocity_z gamma_0 gamma_1 green_rate red_rate blue_rate thickness merge merge_into').split()
MEAN, OFFSET, VELOCITY, RATES, THICKNESS = NAMES[6:9], NAMES[9:12], NAMES[18:21], NAMES[23:26], NAMES[26]
BY_LINK = [*MEAN, *NAMES[12:18], THICKNESS]  # predicted by the linked record or by the last one of the other kinds
BY_LAST = [*VELOCITY, *NAMES[21:26]]  # predicted by the last record
FRESH, CARRIED, FOLLOWING = 0, 1, 2
LIMIT, U64 = 1 << 46, (1 << 64) - 1


class Broken(ValueError):
    """A file that is not a container."""


def expect(holds, part, expected, found):
    if not holds:
        raise Broken(f'{part}: expected {expected}, found {found}')


# BLAKE3, by its authors' specification.
IV = np.array([0x6A09E667, 0xBB67AE85, 0x3C6EF372, 0xA54FF53A, 0x510E527F, 0x9B05688C, 0x1F83D9AB, 0x5BE0CD19], np.uint32)
ORDER = [2, 6, 3, 10, 7, 0, 4, 13, 1, 11, 12, 5, 9, 14, 15, 8]
START, END, PARENT, ROOT = 1, 2, 4, 8


def compress(key, words, counter, length, flags):
    """BLAKE3's compression of many blocks at once, one per column. Counters below 2^32 serve files below 4 TiB."""
    v = [*key, *(np.broadcast_to(np.asarray(x, np.uint32), words.shape[1]) for x in (*IV[:4], counter, 0, length, flags))]
    m = list(words)
    turn = lambda x, bits: (x >> np.uint32(bits)) | (x << np.uint32(32 - bits))

    def g(a, b, c, d, x, y):
        for more, first, second in ((x, 16, 12), (y, 8, 7)):
            v[a] = v[a] + v[b] + more
            v[d] = turn(v[d] ^ v[a], first)
            v[c] = v[c] + v[d]
            v[b] = turn(v[b] ^ v[c], second)

    for _ in range(7):
        for i in range(8):
            shift = i // 4  # columns, then diagonals
            g(i % 4, 4 + (i + shift) % 4, 8 + (i + 2 * shift) % 4, 12 + (i + 3 * shift) % 4, m[2 * i], m[2 * i + 1])
        m = [m[i] for i in ORDER]
    return np.array([v[i] ^ v[i + 8] for i in range(8)])


def blake3(data):
    """BLAKE3 of some bytes: chunks of 1024 bytes side by side, then a tree of their values."""
    count = max(1, -(-len(data) // 1024))
    words = np.frombuffer(data.ljust(1024 * count, b'\0'), '<u4').reshape(count, 16, 16)
    lengths = np.full((count, 16), 64)
    lengths[-1] = np.clip(len(data) - 1024 * (count - 1) - 64 * np.arange(16), 0, 64)
    last = np.maximum(0, (lengths > 0).sum(1) - 1)
    value = np.repeat(IV[:, None], count, 1)
    for block in range(16):
        flags = START * (block == 0) + END * (last == block) + ROOT * ((last == block) & (count == 1))
        new = compress(value, words[:, block].T, np.arange(count), lengths[:, block], flags)
        value = np.where(block <= last, new, value)
    while (count := value.shape[1]) > 1:
        pairs = value[:, : count // 2 * 2].T.reshape(-1, 16).T
        parents = compress(np.repeat(IV[:, None], count // 2, 1), pairs, 0, 64, PARENT + ROOT * (count == 2))
        value = np.concatenate([parents, value[:, count // 2 * 2:]], 1)
    return value[:, 0].astype('<u4').tobytes()


def numbers(name, data, count, signed):
    """LEB128 as unsigned 64-bit numbers, or as folded signed ones."""
    data = np.frombuffer(data, np.uint8)
    ends = np.flatnonzero(data < 128)
    expect(len(ends) == count and (not len(data) or ends[-1] == len(data) - 1), name, f'{count} numbers', len(ends))
    starts, lengths = np.append(0, ends[:-1] + 1)[:count].astype(int), np.diff(ends, prepend=-1)
    long = (lengths > 10) | ((lengths == 10) & (data[ends] > 1)) | ((lengths > 1) & (data[ends] == 0))
    expect(not long.any(), name, 'numbers below 2^64 without superfluous bytes', 'one too long')
    shifts = 7 * (np.arange(len(data)) - np.repeat(starts, lengths))
    values = np.add.reduceat((data & 127).astype(np.uint64) << shifts.astype(np.uint64), starts) if count else np.zeros(0, np.uint64)
    return (values >> np.uint64(1)).astype(np.int64) ^ -(values & np.uint64(1)).astype(np.int64) if signed else values


class Container:
    def __init__(self, path):
        self.file = open(path, 'rb')
        size = self.file.seek(0, 2)
        expect(size >= 64, 'container', 'at least 64 bytes', size)
        header = self.read(0, 16)
        expect(header == b'ssplat\x1a\n\1' + bytes(7), 'header', 'a container of version 1', header)
        at, length, digest = struct.unpack('<2Q32s', self.read(size - 48, 48))
        expect(at + length == size - 48 and at >= 16 and 44 <= length < 1 << 26, 'trailer', 'an index that ends where it begins', (at, length))
        index = self.read(at, length)
        expect(blake3(header + index) == digest, 'index', "the trailer's digest", 'another')
        self.fps, *sides, n = struct.unpack_from('<d9I', index)
        self.source, self.model, self.offset, self.content = (tuple(sides[i:i + 2]) for i in range(0, 8, 2))
        expect(n >= 1 and 44 + 96 * n <= length, 'index', 'room for its intervals', n)
        fields = 'at bytes start end index dropped gaussians merges back frames blake3'.split()
        self.intervals = [dict(zip(fields, struct.unpack_from('<2Q2d2Q4I32s', index, 44 + 96 * i))) for i in range(n)]
        expect(44 + 96 * n + 8 * sum(entry['frames'] for entry in self.intervals) == length, 'index', '8 bytes for each time', length)
        place, times, last = 16, 44 + 96 * n, -np.inf
        for i, entry in enumerate(self.intervals):
            ordered = entry['at'] == place and last <= entry['start'] <= entry['end'] < np.inf
            chained = entry['back'] in (0, self.intervals[i - 1]['back'] + 1 if i else 0) and entry['back'] < 8
            counted = max(entry['gaussians'], entry['merges']) <= 1 << 24
            expect(ordered and chained and counted, f'index: interval {i}', 'chunks and times in order', entry)
            entry['frames'] = struct.unpack_from(f'<{entry["frames"]}d', index, times)
            place, times, last = place + entry['bytes'], times + 8 * len(entry['frames']), entry['end']
        expect(place == at, 'index', 'chunks up to the index', place)

    def read(self, at, length):
        self.file.seek(at)
        data = self.file.read(length)
        expect(len(data) == length, 'file', f'{length} bytes at {at}', len(data))
        return data

    def columns(self, i):
        """The columns of an interval's chunk, by name."""
        entry, columns = self.intervals[i], {}
        chunk = self.read(entry['at'], entry['bytes'])
        expect(blake3(chunk) == entry['blake3'], f'interval {i}', "the index's digest", 'another')
        for name in NAMES:
            expect(len(chunk) >= 8, name, 'two lengths', len(chunk))
            whole, stored = struct.unpack_from('<2I', chunk)
            expect(whole <= min(1032 * stored, 1 << 28) and stored <= len(chunk) - 8, name, 'lengths that are possible', (whole, stored))
            columns[name] = zlib.decompressobj(-15).decompress(chunk[8:8 + stored], whole + 1)
            expect(len(columns[name]) == whole, name, f'{whole} bytes', len(columns[name]))
            chunk = chunk[8 + stored:]
        expect(not chunk, f'interval {i}', 'its end', len(chunk))
        return columns

    def whole(self, i):
        """An interval's records in whole numbers, by name."""
        entry = self.intervals[i]
        before = self.whole(i - 1) if entry['back'] else None
        n, raw = entry['gaussians'], self.columns(i)
        kind = numbers('kind', raw['kind'], n, False)
        code = numbers('code', raw['code'], n, False)
        expect((kind <= 2).all() and (code <= 5).all(), 'kind and code', 'at most 2 and 5', (kind.max(initial=0), code.max(initial=0)))
        fresh, carried, following = (kind == k for k in (FRESH, CARRIED, FOLLOWING))
        link = iter(numbers('link', raw['link'], n - fresh.sum(), True).tolist())
        identities, births = (iter(numbers(name, raw[name], fresh.sum(), True).tolist()) for name in ('identity', 'birth'))
        frames = iter(numbers('frame', raw['frame'], n - carried.sum(), True).tolist())
        identity, birth, frame, linked = (np.zeros(n, kind) for kind in (np.uint64, np.uint64, np.uint64, int))
        place, last_frame, expected = [0, 0, 0], 0, 0
        for j, k in enumerate(kind.tolist()):
            if k != CARRIED:
                frame[j] = last_frame = (last_frame + next(frames)) & U64
            if k == FRESH:
                identity[j], birth[j] = (expected + next(identities)) & U64, (last_frame - next(births)) & U64
                expected = int(identity[j]) + 1
                continue
            to = place[k] + next(link)
            expect(0 <= to < (len(before['kind']) if k == CARRIED and before else j if k == FOLLOWING else 0), 'link', 'a record before', to)
            place[k], linked[j] = to + 1, to
            identity[j], birth[j] = (before['identity'][to], before['birth'][to]) if k == CARRIED else (identity[to], birth[to])
            frame[j] = before['frame'][to] if k == CARRIED else last_frame
        records = dict(kind=kind, reference=code & 1, handover=code >> np.uint64(1), identity=identity, birth=birth, frame=frame)
        empty = [name for name in (*RATES, THICKNESS) if not raw[name]]
        difference = {name: np.zeros(n, int) if name in empty else numbers(name, raw[name], n, True) for name in NAMES[6:27]}
        for name in BY_LAST:
            records[name] = np.cumsum(difference[name])
        for name in BY_LINK:
            records[name] = np.zeros(n, int)
            records[name][~carried] = np.cumsum(difference[name][~carried])
            records[name][carried] = before[name][linked[carried]] + difference[name][carried] if carried.any() else 0
        for mean, offset, velocity in zip(MEAN, OFFSET, VELOCITY):
            values = records[offset] = difference[offset].copy()
            values[carried] += before[offset][linked[carried]] if carried.any() else 0
            for j in np.flatnonzero(following):
                to = linked[j]
                point = records[mean][to] + values[to] + (records[velocity][to] if records['reference'][to] == 0 else 0)
                values[j] += max(-LIMIT, min(LIMIT, point - records[mean][j]))
        ranges = {'opacity': (0, LIMIT), 'gamma_0': (0, 4092), 'gamma_1': (0, LIMIT)} | dict.fromkeys(('scale_x', 'scale_z', THICKNESS), (-9664, 8128))
        for name in NAMES[6:27]:
            low, high = ranges.get(name, (-LIMIT, LIMIT))
            expect((records[name] >= low).all() and (records[name] <= high).all(), name, f'{low} to {high}', 'others')
        merges = [numbers(name, raw[name], entry['merges'], True) for name in ('merge', 'merge_into')]
        records['merges'] = np.stack([np.cumsum(m).astype(np.uint64) for m in merges], 1)
        return records

    def records(self, i):
        """An interval's records: `mean`, `velocity`, `offset`, `gamma`, `opacity`, `scale`, `thickness`, `rgb`, `rgb_rate`, and stored fields as they are."""
        q = self.whole(i)
        stack = lambda names, unit: np.stack([q[name] for name in names], 1) / unit
        colour = lambda g, r, b, unit: np.stack([q[r] + q[g], q[g], q[b] + q[g]], 1) / unit
        exponent = lambda names: np.where((e := stack(names, 64)) == -9664 / 64, 0, 2.0 ** e)
        kept = {name: q[name] for name in ('reference', 'handover', 'identity', 'birth', 'frame', 'merges')}
        gamma = np.stack([2.0 ** (q['gamma_0'] / 32) - 1, q['gamma_1'] / 256], 1)
        places = dict(mean=stack(MEAN, 8192), velocity=stack(VELOCITY, 8192), offset=stack(OFFSET, 8192))
        shapes = dict(opacity=q['opacity'] / 1023, scale=exponent(('scale_x', 'scale_z')), thickness=exponent((THICKNESS,))[:, 0])
        return places | shapes | kept | dict(gamma=gamma, rgb=colour('green', 'red', 'blue', 511), rgb_rate=colour('green_rate', 'red_rate', 'blue_rate', 255))
