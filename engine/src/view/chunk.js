// Chunks of a container, as a page holds them, made into packets. Columns: docs/container.md; differences of a page's: container/images.rs.

const COLUMNS = 29;
const [KIND, LINK, CODE, IDENTITY, BIRTH, FRAME, FIRST] = [0, 1, 2, 3, 4, 5, 6];
const FRESH = 0;
const CARRIED = 1;
/** Numbers per record, and where they are. */
const VALUES = 21;
const [OPACITY_AT, SCALE_AT, GREEN_AT, VELOCITY_AT, GAMMA_AT, RATE_AT, THICKNESS_AT] = [6, 7, 9, 12, 15, 17, 20];
/** Those that the record before predicts, and those that a record of the interval before does. */
const SINCE_LAST = Array.from({ length: THICKNESS_AT - VELOCITY_AT }, (_, k) => VELOCITY_AT + k);
const SINCE_LINK = [0, 1, 2, 6, 7, 8, 9, 10, 11, THICKNESS_AT];
/** World units, scales and the others to their whole numbers. */
const LENGTH = 8192;

async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** A column's numbers; signed ones are folded. Those of more than 53 bits are rounded: no page shows them. */
function numbersOf(bytes, signed) {
  const numbers = new Float64Array(bytes.length);
  let count = 0;
  for (let at = 0; at < bytes.length; ) {
    let value = 0;
    for (let unit = 1; ; unit *= 128) {
      const byte = bytes[at++];
      value += (byte & 127) * unit;
      if (!(byte & 128)) break;
    }
    numbers[count++] = signed ? (value % 2 ? -(value + 1) / 2 : value / 2) : value;
  }
  return numbers.subarray(0, count);
}

/** The columns of a chunk. */
async function columnsOf(chunk) {
  const view = new DataView(chunk.buffer, chunk.byteOffset, chunk.byteLength);
  const columns = [];
  for (let at = 0; columns.length < COLUMNS; ) {
    const [whole, stored] = [view.getUint32(at, true), view.getUint32(at + 4, true)];
    columns.push(whole ? chunk.subarray(at + 8, at + 8 + stored) : null);
    at += 8 + stored;
  }
  const bytes = columns.map((stored) => (stored ? inflated(stored) : new Uint8Array(0)));
  return (await Promise.all(bytes)).map((bytes, column) => numbersOf(bytes, column !== KIND && column !== CODE));
}

/** The records of a chunk, as columns of numbers; `before` are those of the interval before. */
async function decode(chunk, before) {
  const columns = await columnsOf(chunk);
  const count = columns[KIND].length;
  const [identity, birth, frame] = [0, 0, 0].map(() => new Float64Array(count));
  const values = Array.from({ length: VALUES }, () => new Float64Array(count));
  const [at, next, own] = [new Uint32Array(COLUMNS), [0, 0, 0], new Float64Array(VALUES)];
  let [expected, lastFrame] = [0, 0];
  for (let i = 0; i < count; i++) {
    const kind = columns[KIND][i];
    const linked = kind === FRESH ? -1 : next[kind] + columns[LINK][at[LINK]++];
    const from = kind === CARRIED ? before : { identity, birth, frame };
    if (kind === CARRIED) frame[i] = from.frame[linked];
    else lastFrame = frame[i] = lastFrame + columns[FRAME][at[FRAME]++];
    if (kind === FRESH) {
      identity[i] = expected + columns[IDENTITY][at[IDENTITY]++];
      birth[i] = frame[i] - columns[BIRTH][at[BIRTH]++];
      expected = identity[i] + 1;
    } else {
      next[kind] = linked + 1;
      identity[i] = from.identity[linked];
      birth[i] = from.birth[linked];
    }
    for (const k of SINCE_LINK) {
      const difference = columns[FIRST + k][i] ?? 0; // thickness may have no numbers
      values[k][i] = kind === CARRIED ? before.values[k][linked] + difference : (own[k] += difference);
    }
  }
  for (const k of SINCE_LAST) {
    const differences = columns[FIRST + k];
    if (!differences.length) continue;
    for (let i = 0, last = 0; i < count; i++) last = values[k][i] = last + differences[i];
  }
  return { count, code: columns[CODE], identity, birth, frame, values };
}

/** A binary16 number for each whole number that a column holds: there are few of them. */
function halves(column, value) {
  const known = new Map();
  return (i) => {
    let bits = known.get(column[i]);
    if (bits === undefined) known.set(column[i], (bits = halfBits(value(column[i]))));
    return bits;
  };
}

/** The lowest of a column, and a step of which 65,535 reach its highest: 1, or more where that is needed. */
function gridOf(column) {
  let [low, high] = [Infinity, -Infinity];
  for (const value of column) [low, high] = [Math.min(low, value), Math.max(high, value)];
  return high < low ? [0, 1] : [low, Math.max(1, (high - low) / 65535)];
}

/** A packet (packet.rs) of a chunk's records. */
function packetOf({ count, code, identity, birth, values }, { index, start, end, coarseness }) {
  let most = 0;
  const rateUnit = [0, 1, 2].map((k) => coarseness[RATE_AT + k] / 255);
  const rates = new Float32Array(3 * count);
  for (let i = 0; i < count; i++) {
    const [green, red, blue] = rateUnit.map((unit, k) => unit * values[RATE_AT + k][i]);
    rates.set([green + red, green, green + blue], 3 * i);
    most = Math.max(most, Math.abs(green + red), Math.abs(green), Math.abs(green + blue));
  }
  const buffer = new ArrayBuffer(HEADER + count * (RECORD + 2 + (most ? 3 : 0)));
  const view = new DataView(buffer);
  view.setUint32(0, 0x7373706b);
  view.setUint32(4, 3, true);
  view.setBigUint64(8, BigInt(index), true);
  view.setFloat64(16, start, true);
  view.setFloat64(24, end, true);
  view.setUint32(32, count, true);
  const grids = [0, 1, 2, VELOCITY_AT, VELOCITY_AT + 1, VELOCITY_AT + 2].map((k) => [k, ...gridOf(values[k])]);
  grids.forEach(([k, low, step], place) => {
    const offset = 40 + (place % 3) * 4 + (place > 2 ? 24 : 0);
    view.setFloat32(offset, (low * coarseness[k]) / LENGTH, true);
    view.setFloat32(offset + 12, (step * coarseness[k]) / LENGTH, true);
  });
  view.setFloat32(88, most / 127, true);
  const words = new Uint32Array(buffer, HEADER, count * WORDS);
  const shorts = new Uint16Array(buffer, HEADER, count * SHORTS);
  const bytes = new Uint8ClampedArray(buffer, HEADER, count * RECORD);
  const ages = new Uint16Array(buffer, HEADER + count * RECORD, count);
  const steepness = halves(values[GAMMA_AT], (q) => 2 ** ((q * coarseness[GAMMA_AT]) / 32) - 1);
  const scales = [0, 1].map((k) => halves(values[SCALE_AT + k], (q) => 2 ** ((q * coarseness[SCALE_AT + k]) / 64)));
  const colourUnit = [0, 1, 2].map((k) => (coarseness[GREEN_AT + k] * 255) / 511);
  for (let i = 0; i < count; i++) {
    const [short, byte] = [i * SHORTS, i * RECORD];
    grids.forEach(([k, low, step], place) => (shorts[short + place] = Math.round((values[k][i] - low) / step)));
    shorts[short + 6] = steepness(i);
    shorts[short + 7] = Math.min(65535, Math.round((values[GAMMA_AT + 1][i] * coarseness[GAMMA_AT + 1] * 65535) / 256));
    const [green, red, blue] = colourUnit.map((unit, k) => unit * values[GREEN_AT + k][i]);
    bytes[byte + 16] = green + red;
    bytes[byte + 17] = green;
    bytes[byte + 18] = green + blue;
    bytes[byte + 19] = (values[OPACITY_AT][i] * coarseness[OPACITY_AT] * 255) / 1023;
    shorts[short + 10] = scales[0](i);
    shorts[short + 11] = scales[1](i);
    words[i * WORDS + 6] = identity[i] % 2 ** 32;
    const quarters = Math.min(15, Math.max(-16, Math.round((values[THICKNESS_AT][i] * coarseness[THICKNESS_AT]) / 16)));
    words[i * WORDS + 7] = (Math.floor(identity[i] / 2 ** 32) & 0xffffff) | (code[i] << 24) | (quarters << 27);
    ages[i] = Math.min(65535, Math.max(0, index - birth[i]));
  }
  if (most) new Int8Array(buffer, HEADER + count * (RECORD + 2)).set(rates.map((rate) => Math.round((rate * 127) / most)));
  return buffer;
}

/** Chunks one after another: each may need the one before it. */
class Chunks {
  constructor() {
    this.place = -1;
    this.records = null;
  }

  /** The packet of the last of some chunks that follow each other, texts or bytes, each after its key frame and whether it is independent. */
  async take({ place, parts, times, coarseness }) {
    let packet = null;
    for (const [k, part] of parts.entries()) {
      const bytes = typeof part === "string" ? bytesOf(part) : part;
      const index = Number(new DataView(bytes.buffer).getBigUint64(0, true));
      const alone = bytes[8] === 1;
      const i = place + k;
      if (!alone && this.place !== i - 1) throw new Error("an interval without the one before");
      this.records = await decode(bytes.subarray(9), alone ? null : this.records);
      this.place = i;
      if (k === parts.length - 1) packet = packetOf(this.records, { index, ...times, coarseness });
    }
    return packet;
  }
}
