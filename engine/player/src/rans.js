// The entropy coder of a chunk's columns: docs/container.md, "A column".

import { wrong } from "./errors.js";

const BITS = 12;
const SUM = 1 << BITS;
const LEAST = 65536;
const TOKENS = 252;
/** The class of the sum of the two tokens before. */
const CLASS = Uint8Array.from({ length: 2 * TOKENS }, (_, sum) => [0, 1, 2, 3, 3, 4, 4, 4, 5, 5, 5, 5, 5, 6, 6, 6, 6, 6, 6, 6, 6][sum] ?? 7);
/** The least token of numbers that need more than 32 bits. */
const WIDE = 124;

const weightOf = (code) => (code ? (16 + ((code - 1) & 15)) * 2 ** ((code - 1) >> 4) : 0);

/** Returns for each remainder its token, its distance from the token's start (shifted by 8) and the token's part less one (by 20). */
function slotsOf(codes, name) {
  if (codes.length > TOKENS) throw wrong(name, `at most ${TOKENS} weights in a table`, codes.length);
  const slots = new Int32Array(codes.length ? SUM : 0);
  const sum = codes.reduce((sum, code) => sum + weightOf(code), 0);
  if (codes.length && !sum) throw wrong(name, "a table with a weight above 0", "none");
  let [below, from] = [0, 0];
  for (const [token, code] of codes.entries()) {
    below += weightOf(code);
    const to = Math.floor((below * SUM) / sum);
    for (let at = 0; at < to - from; at++) slots[from + at] = token | (at << 8) | ((to - from - 1) << 20);
    from = to;
  }
  return slots;
}

/** Bits, the lowest of a byte first. */
class Bits {
  constructor(bytes, name) {
    [this.bytes, this.name, this.at] = [bytes, name, 0];
  }

  /** Returns the next `count` bits, at most 24. */
  few(count) {
    const { bytes, at } = this;
    const first = at >>> 3;
    this.at = at + count;
    if (this.at > 8 * bytes.length) throw wrong(this.name, "as many extra bits as its tokens require", "fewer");
    // Bytes after the last are undefined, which counts as 0 here.
    const word = bytes[first] | (bytes[first + 1] << 8) | (bytes[first + 2] << 16) | (bytes[first + 3] << 24);
    return (word >>> (at & 7)) & ((1 << count) - 1);
  }

  /** Returns the next `count` bits, at most 32. */
  take(count) {
    if (count <= 24) return this.few(count);
    const low = this.few(16);
    return (low | (this.few(count - 16) << 16)) >>> 0;
  }

  /** Returns true if what is left are the zeros that fill the last byte. */
  isSpent() {
    const left = 8 * this.bytes.length - this.at;
    return left < 8 && (left === 0 || this.bytes[this.bytes.length - 1] >>> (8 - left) === 0);
  }
}

/** Returns the `count` numbers of a column's bytes as words: the low ones, and the high ones or null where all are 0. */
export function wordsOf(bytes, count, name) {
  let at = 0;
  const taken = (length) => {
    if (at + length > bytes.length) throw wrong(name, "tables, a count, words and extra bits", `${bytes.length} bytes`);
    at += length;
    return bytes.subarray(at - length, at);
  };
  const [classes] = taken(1);
  if (classes !== 1 && classes !== 8) throw wrong(name, "1 or 8 tables", classes);
  let tokens = 0;
  const tables = Array.from({ length: classes }, () => {
    const codes = taken(taken(1)[0]);
    tokens = Math.max(tokens, codes.length);
    return slotsOf(codes, name);
  });
  const [a, b, c, d] = taken(4);
  const coded = taken(2 * (a + 256 * b + 65536 * c + 16777216 * d));
  const extra = new Bits(bytes.subarray(at), name);
  let place = 0;
  const word = () => {
    if (place >= coded.length) throw wrong(name, "another word", "the last one");
    place += 2;
    return coded[place - 2] | (coded[place - 1] << 8);
  };
  const first = word();
  let state = ((first << 16) | word()) >>> 0;
  const low = new Uint32Array(count);
  const high = tokens > WIDE ? new Uint32Array(count) : null;
  for (let i = 0, last = 0, before = 0; i < count; i++) {
    const table = tables[classes === 1 ? 0 : CLASS[last + before]];
    if (!table.length) throw wrong(name, "a table for each class that occurs", "none");
    const slot = table[state & (SUM - 1)];
    state = (Math.imul((slot >>> 20) + 1, state >>> BITS) + ((slot >>> 8) & (SUM - 1))) >>> 0;
    if (state < LEAST) state = ((state << 16) | word()) >>> 0;
    const token = slot & 255;
    before = last;
    last = token;
    if (token < 8) {
      low[i] = token;
      continue;
    }
    const bits = (token >> 2) - 1;
    const head = 4 + (token & 3);
    if (bits < 32) {
      low[i] = (head << bits) | extra.take(bits);
      if (high && bits > 29) high[i] = head >>> (32 - bits);
    } else {
      low[i] = extra.take(32);
      high[i] = (head << (bits - 32)) | extra.take(bits - 32);
    }
  }
  if (state !== LEAST || place !== coded.length || !extra.isSpent()) throw wrong(name, "words and bits that end with its numbers", "others");
  return { low, high };
}
