"""A reader of containers (.ssz), written from docs/container.md alone. Needs NumPy and blake3.

    Container('clip.ssz').records(3)  # the fourth interval: arrays by name, in the units of the scene
"""

import struct
from itertools import accumulate

import numpy as np
from blake3 import blake3

NAMES = ('kind link_row link code identity birth frame mean_x mean_y mean_z offset_x offset_y offset_z opacity scale_x scale_z green red blue '
         'velocity_x velocity_y velocity_z gamma_0 gamma_1 green_rate red_rate blue_rate thickness merge merge_into merge_other').split()
MEAN, OFFSET, VELOCITY, RATES, THICKNESS = NAMES[7:10], NAMES[10:13], NAMES[19:22], NAMES[24:27], NAMES[27]
BY_LINK = [*MEAN, *NAMES[13:19], THICKNESS]  # predicted by the linked record or by the last fresh or following one
BY_LAST = [*VELOCITY, *NAMES[22:24]]  # predicted by the last record
CHANGES = dict(zip(('green', 'red', 'blue'), RATES))
CLASS = [0, 1, 2, 3, 3, 4, 4, 4, 5, 5, 5, 5, 5, 6, 6, 6, 6, 6, 6, 6, 6] + [7] * 483
FRESH, CARRIED, FOLLOWING, KEPT, LIMIT, U64 = *range(4), 1 << 46, (1 << 64) - 1


class Broken(ValueError):
    """A file that is not a container."""


def expect(holds, part, expected, found):
    if not holds:
        raise Broken(f'{part}: expected {expected}, found {found}')


def weight(code):
    return (16 + (code - 1) % 16) << (code - 1) // 16 if code else 0


def slots(name, codes):
    """(token, part, start) for each of the 4096 remainders."""
    expect(len(codes) <= 252, name, 'at most 252 weights', len(codes))
    sums = [0, *accumulate(map(weight, codes))]
    expect(sums[-1] or not codes, name, 'a weight above 0', codes)
    starts = [4096 * below // sums[-1] for below in sums] if codes else []
    return [(k, b - a, a) for k, (a, b) in enumerate(zip(starts, starts[1:])) for _ in range(b - a)]


def numbers(name, column, count, signed):
    """A column's numbers: rANS-coded tokens and extra bits."""
    length, data = column
    expect(length == count, name, f'{count} numbers', length)
    if not count:
        return np.zeros(0, np.int64 if signed else np.uint64)
    at, tables, values = 1, [], []
    expect(data[0] in (1, 8), name, '1 or 8 tables', data[0])
    for _ in range(data[0]):
        tables.append(slots(name, data[at + 1:at + 1 + data[at]]))
        at += 1 + data[at]
    words = struct.unpack_from(f'<{struct.unpack_from("<I", data, at)[0]}H', data, at + 4)
    extra = data[at + 4 + 2 * len(words):]
    state, place, taken, last, before = words[0] << 16 | words[1], 2, 0, 0, 0
    for _ in range(count):
        table = tables[0 if len(tables) == 1 else CLASS[last + before]]
        expect(table, name, 'a table for each class', 'none')
        token, part, start = table[state & 4095]
        state = part * (state >> 12) + (state & 4095) - start
        if state < 65536:
            expect(place < len(words), name, 'another word', 'its end')
            state, place = state << 16 | words[place], place + 1
        value, last, before = token, token, last
        if token >= 8:
            first, bits, taken = taken, token // 4 - 1, taken + token // 4 - 1
            some = int.from_bytes(extra[first // 8:(taken + 7) // 8], 'little') >> first % 8
            value = (4 + token % 4) << bits | some & ((1 << bits) - 1)
        values.append(value)
    expect((state, place) == (65536, len(words)), name, 'its end', 'more')
    expect(len(extra) == (taken + 7) // 8 and (not taken % 8 or extra[-1] >> taken % 8 == 0), name, f'{taken} extra bits', extra[-8:])
    values = np.array(values, np.uint64)
    return (values >> np.uint64(1)).astype(np.int64) ^ -(values & np.uint64(1)).astype(np.int64) if signed else values


class Container:
    def __init__(self, path):
        self.file = open(path, 'rb')
        size = self.file.seek(0, 2)
        expect(size >= 64, 'container', 'at least 64 bytes', size)
        header = self.read(0, 16)
        expect(header == b'ssplat\x1a\n\1' + bytes(7), 'header', 'a container of version 1', header)
        at, length, digest = struct.unpack('<2Q32s', self.read(size - 48, 48))
        expect(at + length == size - 48 and at >= 16 and 44 <= length <= 1 << 26, 'trailer', 'an index that ends where it begins', (at, length))
        index = self.read(at, length)
        expect(blake3(header + index).digest() == digest, 'index', "the trailer's digest", 'another')
        self.fps, *sides, n = struct.unpack_from('<d9I', index)
        self.source, self.model, self.offset, self.content = (tuple(sides[i:i + 2]) for i in range(0, 8, 2))
        inside = n >= 1 and 44 + 96 * n <= length and all(s and c and o + c <= m <= 1 << 31 for s, c, o, m in zip(self.source, self.content, self.offset, self.model))
        expect(0 < self.fps < np.inf and inside, 'index', 'intervals, a rate, content inside the input', (n, self.fps, sides))
        fields = 'at bytes start end index dropped gaussians merges back frames blake3'.split()
        self.intervals = [dict(zip(fields, struct.unpack_from('<2Q2d2Q4I32s', index, 44 + 96 * i))) for i in range(n)]
        expect(44 + 96 * n + 8 * sum(entry['frames'] for entry in self.intervals) == length, 'index', '8 bytes for each time', length)
        place, times, last = 16, 44 + 96 * n, -np.inf
        for i, entry in enumerate(self.intervals):
            ordered = entry['at'] == place and max(last, -1e308) <= entry['start'] <= entry['end'] < np.inf
            chained = entry['back'] in (0, self.intervals[i - 1]['back'] + 1 if i else 0) and entry['back'] < 8
            counted = max(entry['gaussians'], entry['merges']) <= 1 << 24
            expect(ordered and chained and counted, f'index: interval {i}', 'chunks and times in order', entry)
            entry['frames'] = struct.unpack_from(f'<{entry["frames"]}d', index, times)
            place, times, last = place + entry['bytes'], times + 8 * len(entry['frames']), entry['end']
        expect(place == at, 'index', 'chunks up to the index', place)
        taken = [110 * entry['gaussians'] for entry in self.intervals], [16 * entry['merges'] for entry in self.intervals]
        fits = max(taken[0]) <= max(1 << 24, 256 * size) and max(map(sum, taken)) <= max(1 << 24, 1024 * size)
        expect(fits, 'intervals', 'less memory for a file of its size', taken)

    def read(self, at, length):
        self.file.seek(at)
        data = self.file.read(length)
        expect(len(data) == length, 'file', f'{length} bytes at {at}', len(data))
        return data

    def columns(self, i):
        """The columns of an interval's chunk, by name."""
        entry, columns = self.intervals[i], {}
        chunk = self.read(entry['at'], entry['bytes'])
        expect(blake3(chunk).digest() == entry['blake3'], f'interval {i}', "the index's digest", 'another')
        for name in NAMES:
            expect(len(chunk) >= 8, name, 'two lengths', len(chunk))
            count, stored = struct.unpack_from('<2I', chunk)
            expect(count <= 1 << 25 and stored <= len(chunk) - 8 and (count or not stored), name, 'lengths that are possible', (count, stored))
            columns[name] = count, chunk[8:8 + stored]
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
        expect((kind <= 3).all() and (code <= 5).all(), 'kind and code', 'at most 3 and 5', (kind.max(initial=0), code.max(initial=0)))
        fresh, carried, following, kept = (kind == k for k in range(4))
        old = carried | kept
        rows, within = (numbers(name, raw[name], n - fresh.sum(), True) for name in ('link_row', 'link'))
        expect(((rows >= -65536) & (rows <= 65536) & (within >= -128) & (within < 128)).all(), 'link', '-128 to 127', 'another')
        link = iter((256 * rows + within).tolist())
        identities, births = (iter(numbers(name, raw[name], fresh.sum(), True).tolist()) for name in ('identity', 'birth'))
        frames = iter(numbers('frame', raw['frame'], n - carried.sum(), True).tolist())
        identity, birth, frame, linked = (np.zeros(n, kind) for kind in (np.uint64, np.uint64, np.uint64, int))
        place, frame_of, expected = [0] * 4, [0] * 4, 0
        for j, k in enumerate(kind.tolist()):
            if k != CARRIED:
                frame[j] = frame_of[k] = (frame_of[k] + next(frames)) & U64
            if k == FRESH:
                identity[j], birth[j] = (expected + next(identities)) & U64, (frame_of[k] - next(births)) & U64
                expected = int(identity[j]) + 1
                continue
            to = place[k] + next(link)
            expect(0 <= to < (j if k == FOLLOWING else len(before['kind']) if before else 0), 'link', 'a record before', to)
            place[k], linked[j] = to + 1, to
            identity[j], birth[j] = (identity[to], birth[to]) if k == FOLLOWING else (before['identity'][to], before['birth'][to])
            frame[j] = before['frame'][to] if k == CARRIED else frame_of[k]
        records = dict(kind=kind, reference=code & 1, handover=code >> np.uint64(1), identity=identity, birth=birth, frame=frame)
        empty = [name for name in (*RATES, THICKNESS) if not raw[name][0]]
        difference = {name: np.zeros(n, int) if name in empty else numbers(name, raw[name], n, True) for name in NAMES[7:28]}
        records |= {name: np.cumsum(difference[name]) for name in BY_LAST} | {name: difference[name] for name in RATES}
        for name in BY_LINK:
            records[name] = np.zeros(n, int)
            records[name][~old] = np.cumsum(difference[name][~old] + 16 * (name == 'mean_x'))
            records[name][old] = before[name][linked[old]] + difference[name][old] if old.any() else 0
        for name, change in CHANGES.items() if kept.any() else ():
            records[name][kept] += 8 * before[change][linked[kept]]
        for mean, offset, velocity, unit, step in zip(MEAN, OFFSET, VELOCITY, (8, 1, 8), (16, 128, 16)):
            values = records[offset] = difference[offset].copy()
            values[old] += before[offset][linked[old]] if old.any() else 0
            for j in np.flatnonzero(following):
                to = linked[j]
                point = unit * records[mean][to] + step * values[to] + (16 * records[velocity][to] if records['reference'][to] == 0 else 0)
                values[j] += max(-LIMIT, min(LIMIT, (point - unit * records[mean][j] + step // 2) // step))
        ranges = {'gamma_0': (0, 4092), 'gamma_1': (0, LIMIT), 'opacity': (-2416, 2032)} | dict.fromkeys(('scale_x', 'scale_z', THICKNESS), (-1208, 1016))
        for name in NAMES[7:28]:
            low, high = ranges.get(name, (-LIMIT, LIMIT))
            expect((records[name] >= low).all() and (records[name] <= high).all(), name, f'{low} to {high}', 'others')
        places = [np.cumsum(numbers(name, raw[name], entry['merges'], True)).tolist() for name in ('merge', 'merge_into')]
        other, others = 0, iter(numbers('merge_other', raw['merge_other'], sum(place == n for pair in places for place in pair), True).tolist())
        records['merges'] = np.zeros((entry['merges'], 2), np.uint64)
        for j, pair in enumerate(zip(*places)):
            for k, place in enumerate(pair):
                expect(0 <= place <= n, 'merge', 'a record', place)
                other = (other + next(others)) & U64 if place == n else other
                records['merges'][j, k] = other if place == n else identity[place]
        return records

    def records(self, i):
        """An interval's records: `mean`, `velocity`, `offset`, `gamma`, `opacity`, `scale`, `thickness`, `rgb`, `rgb_rate`, and stored fields as they are."""
        q = self.whole(i)
        stack = lambda names, unit: np.stack([q[name] for name in names], 1) / unit
        colour = lambda g, r, b, unit: np.stack([q[r] + q[g], q[g], q[b] + q[g]], 1) / unit
        exponent = lambda names, steps=8: np.where((e := stack(names, steps)) == -151, 0, 2.0 ** e)
        kept = {name: q[name] for name in ('reference', 'handover', 'identity', 'birth', 'frame', 'merges')}
        gamma = np.stack([2.0 ** (q['gamma_0'] / 32) - 1, q['gamma_1'] / 256], 1)
        places = dict(mean=stack(MEAN, (2048, 16384, 2048)), velocity=stack(VELOCITY, 1024), offset=stack(OFFSET, (1024, 128, 1024)))
        shapes = dict(opacity=exponent(('opacity',), 16)[:, 0], scale=exponent(('scale_x', 'scale_z')), thickness=exponent((THICKNESS,))[:, 0])
        return places | shapes | kept | dict(gamma=gamma, rgb=colour('green', 'red', 'blue', 128), rgb_rate=colour('green_rate', 'red_rate', 'blue_rate', 16))
