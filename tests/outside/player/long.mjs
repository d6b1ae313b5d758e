// Makes longer clips from short ones.

const [HEADER, TRAILER, INDEX, ENTRY] = [16, 48, 44, 96];

/** The index of a container: its entries, and its offset. */
export function indexOf(bytes) {
  const place = Number(bytes.readBigUInt64LE(bytes.length - TRAILER));
  const entries = Array.from({ length: bytes.readUInt32LE(place + 40) }, (_, i) => {
    const at = place + INDEX + i * ENTRY;
    const [begin, length] = [0, 8].map((field) => Number(bytes.readBigUInt64LE(at + field)));
    return { at: begin, bytes: length, start: bytes.readDoubleLE(at + 16), end: bytes.readDoubleLE(at + 24), gaussians: bytes.readUInt32LE(at + 48), back: bytes.readUInt32LE(at + 56), entry: at };
  });
  return { place, entries };
}

/** A container that lists no times of frames, repeated for at least the given seconds. Its digests are not recomputed. */
export function longer(bytes, seconds) {
  const { place, entries } = indexOf(bytes);
  const [start, end] = [entries[0].start, entries[entries.length - 1].end];
  const times = Math.ceil(seconds / (end - start));
  const chunks = bytes.subarray(HEADER, place);
  const index = Buffer.alloc(INDEX + ENTRY * entries.length * times);
  bytes.copy(index, 0, place, place + INDEX);
  index.writeUInt32LE(entries.length * times, 40);
  for (let k = 0; k < times; k++) {
    entries.forEach(({ at, entry, ...its }, i) => {
      const to = INDEX + ENTRY * (k * entries.length + i);
      bytes.copy(index, to, entry, entry + ENTRY);
      index.writeBigUInt64LE(BigInt(at + k * chunks.length), to);
      [its.start, its.end].forEach((time, side) => index.writeDoubleLE(time + k * (end - start), to + 16 + 8 * side));
    });
  }
  const trailer = Buffer.alloc(TRAILER);
  [HEADER + times * chunks.length, index.length].forEach((value, i) => trailer.writeBigUInt64LE(BigInt(value), 8 * i));
  return Buffer.concat([bytes.subarray(0, HEADER), ...Array.from({ length: times }, () => chunks), index, trailer]);
}
