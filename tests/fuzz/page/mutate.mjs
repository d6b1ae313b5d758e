// Mutations of bytes, each a function of a number.

/** Whole numbers under n: mulberry32. */
export function random(seed) {
  let state = Math.imul(seed + 1, 0x9e3779b1) >>> 0;
  return (n) => {
    state = (state + 0x6d2b79f5) >>> 0;
    let x = Math.imul(state ^ (state >>> 15), state | 1);
    x ^= x + Math.imul(x ^ (x >>> 7), x | 61);
    return Math.floor((((x ^ (x >>> 14)) >>> 0) / 2 ** 32) * n);
  };
}

const NUMBERS = [0, 1, 2, 3, 4, 5, 8, 9, 16, 24, 45, 127, 128, 255, 256, 65535, 65536, 0xffffff, 2 ** 24, 2 ** 31 - 1, 2 ** 31, 2 ** 32 - 2, 2 ** 32 - 1];
const FLOATS = [0, -0, 1e-45, 1e-30, 1, -1, 88, -88, 1e30, 3.4e38, Infinity, -Infinity, NaN];
const WORDS = ["0", "1", "-1", "2", "1e9", "4294967296", "9".repeat(20), "9".repeat(400), "", " ", "\n", "\r\n", "element", "property", "float", "list", "uchar", "double", "vertex", "chunk", "sh", "end_header\n", "__proto__", "constructor"];

const CHANGES = [
  (bytes, _, chance) => {
    if (bytes.length) bytes[chance(bytes.length)] ^= 1 << chance(8);
    return bytes;
  },
  (bytes, _, chance) => {
    if (bytes.length) bytes[chance(bytes.length)] = NUMBERS[chance(NUMBERS.length)] & 255;
    return bytes;
  },
  (bytes, _, chance) => {
    if (bytes.length >= 4) bytes.writeUInt32LE(NUMBERS[chance(NUMBERS.length)], chance(Math.floor(bytes.length / 4)) * 4);
    return bytes;
  },
  (bytes, _, chance) => {
    if (bytes.length >= 4) bytes.writeFloatLE(FLOATS[chance(FLOATS.length)], chance(bytes.length - 3));
    return bytes;
  },
  (bytes, _, chance) => bytes.subarray(0, chance(bytes.length + 1)),
  (bytes, _, chance) => bytes.subarray(chance(bytes.length + 1)),
  (bytes, _, chance) => Buffer.concat([bytes, Buffer.alloc(1 + chance(64), chance(256))]),
  (bytes, _, chance) => {
    const [from, to] = [chance(bytes.length + 1), chance(bytes.length + 1)].sort((a, b) => a - b);
    return Buffer.concat([bytes.subarray(0, to), bytes.subarray(from)]);
  },
  (bytes, _, chance) => {
    const [from, to] = [chance(bytes.length + 1), chance(bytes.length + 1)].sort((a, b) => a - b);
    return Buffer.concat([bytes.subarray(0, from), bytes.subarray(to)]);
  },
  (bytes, seeds, chance) => {
    const other = seeds[chance(seeds.length)];
    return Buffer.concat([bytes.subarray(0, chance(bytes.length + 1)), other.subarray(chance(other.length + 1))]);
  },
  // A word of the text with which a file may begin.
  (bytes, _, chance) => {
    const text = bytes.subarray(0, 1500).toString("latin1");
    const words = [...text.matchAll(/\S+/g)];
    const { index, 0: word } = words[chance(words.length)] ?? { index: 0, 0: "" };
    const other = Buffer.from(WORDS[chance(WORDS.length)]);
    return Buffer.concat([bytes.subarray(0, index), other, bytes.subarray(index + word.length)]);
  },
];

/** Of the changes, those that keep the length. */
const KEEPING = 4;

/** A seed with one or a few changes, most of which keep its length. */
export function mutated(seed, seeds, chance) {
  let bytes = Buffer.from(seed);
  for (let left = 1 + chance(4); left > 0; left--) {
    const change = CHANGES[chance(chance(4) ? KEEPING : CHANGES.length)];
    bytes = Buffer.from(change(bytes, seeds, chance));
  }
  return bytes;
}
