// Zstandard frames (RFC 8878) without a dictionary, of contents of known length.

const ZSTD_MAGIC = 0xfd2fb528;
/** Bytes of a block's content at most. */
const MAX_BLOCK = 1 << 17;
/** Bits of a Huffman code at most. */
const LONGEST_CODE = 11;
const damaged = (what) => new Error(`damaged: ${what}`);
const log2 = (x) => 31 - Math.clz32(x);
const ones = (count, value) => new Array(count).fill(value);

/** Codes of a kind: bits of a table's states by default and at most, default counts, and by code the first value and how many bits are added to it. */
const kindOf = (bits, most, counts, first, more) => ({ bits, most, counts, more, first: more.reduce((all, n, k) => (all.push(k ? all[k - 1] + 2 ** more[k - 1] : first), all), []) });
const LITERALS = kindOf(6, 9, [4, 3, ...ones(11, 2), 1, 1, 1, ...ones(9, 2), 3, 2, ...ones(5, 1), ...ones(4, -1)], 0, [...ones(16, 0), 1, 1, 1, 1, 2, 2, 3, 3, 4, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16]);
const MATCHES = kindOf(6, 9, [1, 4, 3, ...ones(6, 2), ...ones(37, 1), ...ones(7, -1)], 3, [...ones(32, 0), 1, 1, 1, 1, 2, 2, 3, 3, 4, 4, 5, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16]);
const OFFSETS = kindOf(5, 8, [...ones(6, 1), 2, 2, 2, ...ones(15, 1), ...ones(5, -1)], 1, Array.from({ length: 31 }, (_, k) => k));

/** `count` bits, 32 at most, of little-endian bytes from bit `at` on; what lies before them and after them is 0. */
function bitsAt(bytes, at, count) {
  if (at < 0) return at + count <= 0 ? 0 : bitsAt(bytes, 0, at + count) * 2 ** -at;
  const from = at >>> 3;
  const shift = at & 7;
  const low = (bytes[from] | (bytes[from + 1] << 8) | (bytes[from + 2] << 16) | (bytes[from + 3] << 24)) >>> shift;
  const all = count + shift > 32 ? low | (bytes[from + 4] << (32 - shift)) : low;
  return count === 32 ? all >>> 0 : all & ((1 << count) - 1);
}

/** The same bytes with four more behind them, so that a word can be read at each. */
function padded(bytes) {
  const more = new Uint8Array(bytes.length + 4);
  more.set(bytes);
  return more;
}

/** Bits of a stream that is read from its end. */
class Backwards {
  constructor(bytes) {
    const last = bytes[bytes.length - 1];
    if (!last) throw damaged("a stream without an end");
    this.bytes = padded(bytes);
    this.at = 8 * (bytes.length - 1) + log2(last);
  }

  /** The next bits; before the stream's beginning they are 0. */
  read(count) {
    this.at -= count;
    return count ? bitsAt(this.bytes, this.at, count) : 0;
  }
}

/** The states of finite-state entropy: symbol, bits to read, and the base of the next state, by state. */
function statesOf(counts, bits) {
  const size = 1 << bits;
  const [symbols, lengths, bases] = [new Uint8Array(size), new Uint8Array(size), new Uint16Array(size)];
  const next = counts.map((count) => Math.abs(count));
  let high = size;
  counts.forEach((count, symbol) => count < 0 && (symbols[--high] = symbol));
  let at = 0;
  counts.forEach((count, symbol) => {
    for (let k = 0; k < count; k++) {
      symbols[at] = symbol;
      do at = (at + (size >> 1) + (size >> 3) + 3) & (size - 1);
      while (at >= high);
    }
  });
  if (at) throw damaged("a table of another length");
  for (let state = 0; state < size; state++) {
    const number = next[symbols[state]]++;
    lengths[state] = bits - log2(number);
    bases[state] = (number << lengths[state]) - size;
  }
  return { symbols, lengths, bases, bits };
}

/** A table's counts, from the beginning of `bytes`: its states, and how many bytes they took. */
function readStates(bytes, mostBits, mostSymbols) {
  const bits = 5 + (bytes[0] & 15);
  if (bits > mostBits) throw damaged("a table that is too large");
  const counts = [];
  let [left, at] = [1 << bits, 4];
  while (left > 0) {
    if (counts.length >= mostSymbols || at > 8 * bytes.length) throw damaged("a table without an end");
    const width = log2(left + 1) + 1;
    const short = 2 ** width - 1 - (left + 1);
    let value = bitsAt(bytes, at, width);
    const low = value & (2 ** (width - 1) - 1);
    at += width;
    if (low < short) [value, at] = [low, at - 1];
    else if (value !== low) value -= short;
    counts.push(value - 1);
    left -= Math.abs(value - 1);
    if (value !== 1) continue;
    for (let zeros = 3; zeros === 3; ) {
      zeros = bitsAt(bytes, at, 2);
      at += 2;
      if (counts.length + zeros > mostSymbols || at > 8 * bytes.length) throw damaged("a table without an end");
      for (let k = 0; k < zeros; k++) counts.push(0);
    }
  }
  const used = (at + 7) >> 3;
  if (left < 0 || used > bytes.length) throw damaged("a table of another length");
  return { states: statesOf(counts, bits), used };
}

/** A state of such a table that moves on along a stream. */
class State {
  constructor(table, stream) {
    Object.assign(this, table);
    this.stream = stream;
    this.state = stream.read(table.bits);
  }

  get symbol() {
    return this.symbols[this.state];
  }

  move() {
    this.state = this.bases[this.state] + this.stream.read(this.lengths[this.state]);
  }
}

/** Weights of a Huffman code that two states took turns with. */
function weightsOf(bytes) {
  const { states, used } = readStates(bytes, 6, 256);
  const stream = new Backwards(bytes.subarray(used));
  let [now, other] = [new State(states, stream), null];
  other = new State(states, stream);
  const weights = [];
  for (; weights.length < 255; [now, other] = [other, now]) {
    weights.push(now.symbol);
    now.move();
    if (stream.at < 0) return [...weights, other.symbol];
  }
  throw damaged("a code without an end");
}

/** A Huffman code at the beginning of `bytes`: symbol and length by as many bits as the longest has. */
function readCode(bytes) {
  const head = bytes[0];
  const direct = head >= 128;
  const used = 1 + (direct ? (head - 126) >> 1 : head);
  if (used > bytes.length) throw damaged("a code without an end");
  const weights = direct
    ? Array.from({ length: head - 127 }, (_, k) => (k & 1 ? bytes[1 + (k >> 1)] & 15 : bytes[1 + (k >> 1)] >> 4))
    : weightsOf(bytes.subarray(1, used));
  const sum = weights.reduce((sum, weight) => sum + (weight ? 2 ** (weight - 1) : 0), 0);
  const bits = sum ? log2(sum) + 1 : 0;
  const left = 2 ** bits - sum;
  if (!sum || bits > LONGEST_CODE || left & (left - 1)) throw damaged("a code of other weights");
  weights.push(log2(left) + 1);
  const [symbols, lengths] = [new Uint8Array(1 << bits), new Uint8Array(1 << bits)];
  // Longest codes first, of one length by symbol.
  for (let weight = 1, at = 0; weight <= bits; weight++) {
    weights.forEach((each, symbol) => {
      if (each !== weight) return;
      symbols.fill(symbol, at, at + 2 ** (weight - 1));
      lengths.fill(bits + 1 - weight, at, (at += 2 ** (weight - 1)));
    });
  }
  return { code: { symbols, lengths, bits }, used };
}

/** Fills `out` with the symbols of a stream. */
function decodeInto(out, bytes, { symbols, lengths, bits }) {
  const stream = new Backwards(bytes);
  const { bytes: own } = stream;
  const mask = (1 << bits) - 1;
  let at = stream.at - bits;
  for (let k = 0; k < out.length; k++) {
    const from = at >> 3;
    const next = at < 0 ? bitsAt(own, at, bits) : ((own[from] | (own[from + 1] << 8) | (own[from + 2] << 16)) >> (at & 7)) & mask;
    out[k] = symbols[next];
    at -= lengths[next];
  }
  at += bits;
  if (at !== 0) throw damaged("literals of another length");
}

/** What blocks hand on: the code, the three tables, the last three offsets. */
class Content {
  constructor(size) {
    this.out = new Uint8Array(size);
    this.at = 0;
    this.code = null;
    this.tables = [null, null, null];
    this.last = [1, 4, 8];
  }

  /** Room for so many bytes. */
  take(count) {
    if (count > this.out.length - this.at) throw damaged("more than its length");
    return this.out.subarray(this.at, (this.at += count));
  }

  /** The literals at the beginning of a block, and how many bytes they took. */
  literals(block) {
    const [kind, format] = [block[0] & 3, (block[0] >> 2) & 3];
    const word = bitsAt(block, 0, 32);
    if (kind < 2) {
      const head = format === 1 ? 2 : format === 3 ? 3 : 1;
      const size = head === 1 ? block[0] >> 3 : (word & (2 ** (8 * head) - 1)) >>> 4;
      const used = head + (kind ? 1 : size);
      if (used > block.length || size > MAX_BLOCK) throw damaged("literals of another length");
      return { bytes: kind ? new Uint8Array(size).fill(block[head]) : block.subarray(head, used), used };
    }
    const width = [10, 10, 14, 18][format];
    const head = [3, 3, 4, 5][format];
    const [size, length] = [bitsAt(block, 4, width), bitsAt(block, 4 + width, width)];
    if (head + length > block.length || size > MAX_BLOCK) throw damaged("literals of another length");
    let rest = block.subarray(head, head + length);
    if (kind === 2) {
      const { code, used } = readCode(rest);
      this.code = code;
      rest = rest.subarray(used);
    }
    if (!this.code) throw damaged("literals without a code");
    const bytes = new Uint8Array(size);
    if (!format) {
      decodeInto(bytes, rest, this.code);
    } else {
      const lengths = [0, 2, 4].map((k) => rest[k] | (rest[k + 1] << 8));
      const each = (size + 3) >> 2;
      let at = 6;
      lengths.push(rest.length - at - lengths[0] - lengths[1] - lengths[2]);
      if (!(lengths[3] > 0) || 3 * each > size) throw damaged("literals of another length");
      lengths.forEach((length, k) => {
        decodeInto(bytes.subarray(k * each, k === 3 ? size : (k + 1) * each), rest.subarray(at, at + length), this.code);
        at += length;
      });
    }
    return { bytes, used: head + length };
  }

  /** A block: literals, and what is repeated between them. */
  block(block) {
    const { bytes: literals, used } = this.literals(block);
    let rest = block.subarray(used);
    const head = rest[0] < 128 ? 1 : rest[0] < 255 ? 2 : 3;
    if (rest.length < head) throw damaged("a block without an end");
    const count = head === 1 ? rest[0] : head === 2 ? ((rest[0] - 128) << 8) + rest[1] : rest[1] + (rest[2] << 8) + 0x7f00;
    let from = 0;
    if (count) {
      const modes = rest[head];
      rest = rest.subarray(head + 1);
      [LITERALS, OFFSETS, MATCHES].forEach((kind, k) => {
        const mode = (modes >> (6 - 2 * k)) & 3;
        if (mode === 0) this.tables[k] = kind.states ??= statesOf(kind.counts, kind.bits);
        if (mode === 1) {
          this.tables[k] = { symbols: rest.slice(0, 1), lengths: [0], bases: [0], bits: 0 };
          rest = rest.subarray(1);
        }
        if (mode === 2) {
          const { states, used } = readStates(rest, kind.most, kind.more.length);
          this.tables[k] = states;
          rest = rest.subarray(used);
        }
        if (!this.tables[k]) throw damaged("a table that was never given");
      });
      const stream = new Backwards(rest);
      const [literal, offset, match] = this.tables.map((table) => new State(table, stream));
      const value = ({ first, more }, symbol) => {
        if (!(symbol < more.length)) throw damaged("an unknown code");
        return first[symbol] + stream.read(more[symbol]);
      };
      for (let k = 0; k < count; k++) {
        const far = value(OFFSETS, offset.symbol);
        const length = value(MATCHES, match.symbol);
        const before = value(LITERALS, literal.symbol);
        if (k < count - 1) for (const state of [literal, match, offset]) state.move();
        if (stream.at < 0 || from + before > literals.length) throw damaged("a block of another length");
        this.take(before).set(literals.subarray(from, (from += before)));
        this.repeat(this.offset(far, before), length);
      }
      if (stream.at !== 0) throw damaged("a block of another length");
    } else if (rest.length !== head) {
      throw damaged("a block of another length");
    }
    this.take(literals.length - from).set(literals.subarray(from));
  }

  /** How far back a match lies; small numbers name one of the last three. */
  offset(value, literals) {
    const { last } = this;
    const which = value > 3 ? 3 : value - 1 + (literals ? 0 : 1);
    const offset = value > 3 ? value - 3 : which < 3 ? last[which] : last[0] - 1;
    if (which > 1) last[2] = last[1];
    if (which > 0) [last[1], last[0]] = [last[0], offset];
    return offset;
  }

  repeat(offset, length) {
    const from = this.at - offset;
    if (!(offset > 0) || from < 0) throw damaged("a match before the beginning");
    const to = this.take(length);
    const { out } = this;
    if (offset >= length) to.set(out.subarray(from, from + length));
    else for (let k = 0; k < length; k++) to[k] = out[from + k];
  }
}

/** The content of a frame, `size` bytes. */
function unzstd(bytes, size) {
  if (bytes.length < 6 || bitsAt(bytes, 0, 32) !== ZSTD_MAGIC) throw damaged("no frame");
  const head = bytes[4];
  const single = Boolean(head & 32);
  if (head & 8 || head & 3) throw damaged("a frame with a dictionary");
  let at = 5 + (single ? 0 : 1) + [single ? 1 : 0, 2, 4, 8][head >> 6];
  const content = new Content(size);
  for (let last = false; !last; ) {
    if (at + 3 > bytes.length) throw damaged("a frame without an end");
    const word = bitsAt(bytes, 8 * at, 24);
    const [kind, length] = [(word >> 1) & 3, word >> 3];
    last = Boolean(word & 1);
    const part = bytes.subarray(at + 3, at + 3 + (kind === 1 ? 1 : length));
    at += 3 + part.length;
    if (part.length < (kind === 1 ? 1 : length) || kind === 3) throw damaged("a frame without an end");
    if (kind === 0) content.take(length).set(part);
    else if (kind === 1) content.take(length).fill(part[0]);
    else content.block(part);
  }
  // A checksum may follow.
  if (at + (head & 4 ? 4 : 0) !== bytes.length || content.at !== size) throw damaged("a content of another length");
  return content.out;
}
