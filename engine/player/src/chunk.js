// Decoder of chunks of a container, or of a page, to packets. Columns: docs/container.md; differences in a page: scene/container/images.rs.

import { wrong } from "./errors.js";
import { HEADER, RECORD, SHORTS, WORDS, halfBits } from "./packet.js";
import { wordsOf } from "./rans.js";

const NAMES = (
  "kind link_row link code identity birth frame mean_x mean_y mean_z offset_x offset_y offset_z opacity scale_x scale_z green red blue " +
  "velocity_x velocity_y velocity_z gamma_0 gamma_1 green_rate red_rate blue_rate thickness merge merge_into merge_other"
).split(" ");
const [KIND, LINK_ROW, LINK, CODE, IDENTITY, BIRTH, FRAME, FIRST, MERGE] = [0, 1, 2, 3, 4, 5, 6, 7, 28];
/** Cells of a row of the embedded model's grid, and the width of one in integers of mean_x. */
const [ROW, CELL] = [256, 16];
const MOST_ROWS = 65536;
const [FRESH, CARRIED, KEPT] = [0, 1, 3];
/** Number of values per record, and their positions. */
export const VALUES = 21;
const [OFFSET_AT, OPACITY_AT, SCALE_AT, GREEN_AT, VELOCITY_AT, GAMMA_AT, RATE_AT, THICKNESS_AT] = [3, 6, 7, 9, 12, 15, 17, 20];
/** Values predicted from the previous record, from a record of the previous interval, and not at all. Offsets are in no packet. */
const SINCE_LAST = Array.from({ length: RATE_AT - VELOCITY_AT }, (_, k) => VELOCITY_AT + k);
const SINCE_LINK = [0, 1, 2, 6, 7, 8, 9, 10, 11, THICKNESS_AT];
const SINCE_NOTHING = Array.from({ length: THICKNESS_AT - RATE_AT }, (_, k) => RATE_AT + k);
/** Columns that are empty if all their differences are 0. */
const isRare = (column) => column >= FIRST + RATE_AT && column < MERGE;
/** Columns with numbers for some of the records. */
const isForSome = (column) => column === LINK_ROW || column === LINK || (column >= IDENTITY && column <= FRAME);
/** Columns of which only the lengths are read. */
const isSkipped = (column) => column >= MERGE || (column >= FIRST + OFFSET_AT && column < FIRST + OPACITY_AT);
/** Integers per world unit of means and of velocities, per octave of opacities and of sizes, and per unit of colours and of their changes. */
const STEPS = { across: 2048, depth: 16384, motion: 1024, opacity: 16, size: 8, colour: 128, rate: 16 };
/** The largest magnitude of the integers, and the ranges of logarithms. */
const LIMIT = 2 ** 46;
const [LEAST_OPACITY, MOST_OPACITY, LEAST_SIZE, MOST_SIZE, MOST_GAMMA] = [-2416, 2032, -1208, 1016, 4092];
/** Maximum number of Gaussians of an interval. */
export const MOST_GAUSSIANS = 2 ** 24;
const SEEN_AT = Math.fround(1 / 255);

/** Decodes the numbers of a column. Magnitudes above 2⁵³ are rounded; valid values are smaller. */
function numbersOf({ bytes, count }, name, signed) {
  const numbers = new Float64Array(count);
  if (!count) return numbers;
  const { low, high } = wordsOf(bytes, count, name);
  for (let i = 0; i < count; i++) {
    if (!high || !high[i]) {
      const value = low[i];
      numbers[i] = signed ? (value & 1 ? -(value >>> 1) - 1 : value >>> 1) : value;
    } else {
      const value = high[i] * 2 ** 32 + low[i];
      numbers[i] = signed ? (low[i] & 1 ? -(value + 1) / 2 : value / 2) : value;
    }
  }
  return numbers;
}

/** Numbers of a column of signed 64-bit ones, one by one, in `low` and `high`. */
class Wide {
  constructor({ bytes, count }, name) {
    [this.words, this.count, this.name, this.at] = [count ? wordsOf(bytes, count, name) : null, count, name, 0];
    [this.low, this.high] = [0, 0];
  }

  next() {
    if (this.at >= this.count) throw wrong(this.name, "another number", "its end");
    const low = this.words.low[this.at];
    const high = this.words.high?.[this.at] ?? 0;
    const sign = -(low & 1);
    this.low = (((low >>> 1) | (high << 31)) ^ sign) >>> 0;
    this.high = ((high >>> 1) ^ sign) >>> 0;
    this.at++;
    return this;
  }

  /** The current number; magnitudes above 2⁵³ are rounded. */
  number() {
    return this.low + (this.high | 0) * 2 ** 32;
  }

  end() {
    if (this.at !== this.count) throw wrong(this.name, "its end", `${this.count - this.at} more numbers`);
  }
}

/** Writes a + sign·b, modulo 2⁶⁴, to index i of `out`, which holds two words per number. */
function putSum(out, i, low, high, { low: l, high: h }, sign) {
  const sum = low + sign * l;
  out[2 * i] = sum;
  out[2 * i + 1] = high + sign * h + Math.floor(sum / 2 ** 32);
}

/** Returns the columns of a chunk: the bytes of each and the number of its numbers; skipped columns are empty. */
function columnsOf(chunk, counted) {
  const most = counted ?? MOST_GAUSSIANS;
  const view = new DataView(chunk.buffer, chunk.byteOffset, chunk.byteLength);
  let at = 0;
  const columns = NAMES.map((short, column) => {
    const name = `column ${short}`;
    const room = chunk.length - at - 8;
    const [count, stored] = room < 0 ? [0, 0] : [view.getUint32(at, true), view.getUint32(at + 4, true)];
    if (room < stored) throw wrong(name, "two lengths and as many bytes", `${chunk.length - at} bytes`);
    if (column < MERGE && count > most) throw wrong(name, `at most ${most} numbers`, count);
    if (!count && stored) throw wrong(name, "no bytes without numbers", `${stored} bytes`);
    at += 8 + stored;
    return isSkipped(column) ? { bytes: null, count: 0 } : { bytes: chunk.subarray(at - stored, at), count };
  });
  const { count } = columns[KIND];
  for (const [column, one] of columns.entries()) {
    if (isSkipped(column) || isForSome(column) || (isRare(column) && !one.count)) continue;
    if (one.count !== (counted ?? count)) throw wrong(`column ${NAMES[column]}`, `${counted ?? count} numbers`, one.count);
  }
  // The text of a page's chunk may end in a byte of zero from its last digits.
  const more = chunk.length - at;
  if (more && (counted !== null || more > 1 || chunk[at])) throw wrong("chunk", "its end after the last column", `${more} more bytes`);
  return columns;
}

/** The previous records of an independent interval: none. */
const NONE = { count: 0 };

/**
 * Returns the records of a chunk, as columns of numbers. `before` are the records of the previous interval, null for an independent one. `count` is
 * the number in the index, or null for a chunk of a page, whose values have other steps (`coarseness`).
 */
export function decode(chunk, before, { count = null, coarseness = null } = {}) {
  const stored = columnsOf(chunk, count);
  count ??= stored[KIND].count;
  before ??= NONE;
  const named = (column) => `column ${NAMES[column]}`;
  const numbers = (column, signed) => numbersOf(stored[column], named(column), signed);
  const [kinds, code] = [numbers(KIND, false), numbers(CODE, false)];
  /** Differences are decoded column by column, so that few are in memory at once; a rare column may have none. */
  const differencesOf = (k) => (stored[FIRST + k].count ? numbers(FIRST + k, true) : null);
  const [linkRow, link, identities, births, frames] = [LINK_ROW, LINK, IDENTITY, BIRTH, FRAME].map((column) => new Wide(stored[column], named(column)));
  const [identity, birth, frame] = [0, 0, 0].map(() => new Uint32Array(2 * count));
  const linked = new Int32Array(count);
  const next = [0, 0, 0, 0];
  // The key frames of the last record of each kind.
  const last = new Uint32Array(8);
  const expected = new Uint32Array(2);
  const copy = (to, i, from, j) => ([to[2 * i], to[2 * i + 1]] = [from[2 * j], from[2 * j + 1]]);
  for (let i = 0; i < count; i++) {
    const kind = kinds[i];
    if (kind > KEPT) throw wrong(named(KIND), "0 to 3", kind);
    if (code[i] > 5) throw wrong(named(CODE), "0 to 5", code[i]);
    if (kind !== CARRIED) {
      putSum(frame, i, last[2 * kind], last[2 * kind + 1], frames.next(), 1);
      copy(last, kind, frame, i);
    }
    if (kind === FRESH) {
      putSum(identity, i, expected[0], expected[1], identities.next(), 1);
      putSum(birth, i, frame[2 * i], frame[2 * i + 1], births.next(), -1);
      putSum(expected, 0, identity[2 * i], identity[2 * i + 1], { low: 1, high: 0 }, 1);
      continue;
    }
    const [row, within] = [linkRow.next().number(), link.next().number()];
    if (Math.abs(row) > MOST_ROWS || within < -ROW / 2 || within >= ROW / 2) {
      throw wrong("columns link_row, link", "at most 65536 rows either way, and -128 to 127", `${row}, ${within}`);
    }
    const j = next[kind] + ROW * row + within;
    const from = kind === CARRIED || kind === KEPT ? before : { count: i, identity, birth };
    if (!(j >= 0 && j < from.count)) throw wrong(named(LINK), "a record before", j);
    linked[i] = j;
    next[kind] = j + 1;
    copy(identity, i, from.identity, j);
    copy(birth, i, from.birth, j);
    if (kind === CARRIED) copy(frame, i, from.frame, j);
  }
  for (const column of [linkRow, link, identities, births, frames]) column.end();
  const values = Array.from({ length: VALUES }, () => null);
  for (const k of [...SINCE_LINK, ...SINCE_LAST]) values[k] = new Float64Array(count);
  for (const k of SINCE_LINK) {
    const [differences, mine, theirs] = [differencesOf(k), values[k], before.values?.[k]];
    // A kept record's colour has grown by its change.
    const rate = k >= GREEN_AT && k < GREEN_AT + 3 ? k + RATE_AT - GREEN_AT : null;
    const growth = rate === null ? 0 : ((STEPS.colour / STEPS.rate) * (coarseness?.[rate] ?? 1)) / (coarseness?.[k] ?? 1);
    const ahead = k === 0 ? CELL / (coarseness?.[k] ?? 1) : 0;
    for (let i = 0, own = 0; i < count; i++) {
      const difference = differences ? differences[i] : 0;
      if (kinds[i] === CARRIED) mine[i] = theirs[linked[i]] + difference;
      else if (kinds[i] === KEPT) mine[i] = theirs[linked[i]] + (growth ? growth * before.values[rate][linked[i]] : 0) + difference;
      else mine[i] = own += difference + ahead;
    }
  }
  for (const k of SINCE_LAST) {
    const differences = differencesOf(k);
    if (differences) for (let i = 0, last = 0; i < count; i++) last = values[k][i] = last + differences[i];
  }
  for (const k of SINCE_NOTHING) values[k] = differencesOf(k) ?? new Float64Array(count);
  for (const [k, column] of values.entries()) if (column) checkRange(column, k, coarseness?.[k] ?? 1);
  return { count, code, identity, birth, frame, values };
}

/** Throws for integers outside the valid range of a column. */
function checkRange(column, k, unit) {
  let [low, high] = [0, 0];
  for (const value of column) {
    if (value < low) low = value;
    else if (value > high) high = value;
  }
  const name = `column ${NAMES[FIRST + k]}`;
  if (low * unit < -LIMIT || high * unit > LIMIT) throw wrong(name, "magnitudes up to 2^46", "a larger one");
  const isSize = k === SCALE_AT || k === SCALE_AT + 1 || k === THICKNESS_AT;
  let [least, most] = isSize ? [LEAST_SIZE, MOST_SIZE] : [-Infinity, Infinity];
  if (k === OPACITY_AT) [least, most] = [LEAST_OPACITY, MOST_OPACITY];
  if (k === GAMMA_AT || k === GAMMA_AT + 1) [least, most] = [0, k === GAMMA_AT ? MOST_GAMMA : Infinity];
  if (low * unit < least) throw wrong(name, `at least ${least}`, low * unit);
  if (high * unit > most) throw wrong(name, `at most ${most}`, high * unit);
}

/** Caches a function of a column's integers, of which few are different. */
function byNumber(column, value) {
  const known = new Map();
  return (i) => {
    let found = known.get(column[i]);
    if (found === undefined) known.set(column[i], (found = value(column[i])));
    return found;
  };
}

/** Quantises a value of [0, 1] to steps, rounded half up; other values are clamped. */
const unit = (value, steps) => Math.floor(Math.min(1, Math.max(0, value)) * steps + 0.5);

/** Rounds half away from zero. */
const nearestTo = (x) => (x < 0 ? -Math.round(-x) : Math.round(x));

/** Returns the lowest value, and a step of which 65,535 reach the highest. */
function gridOf(values, shown) {
  let [low, high] = [Infinity, -Infinity];
  for (const i of shown) {
    const value = values[i];
    if (value < low) low = value;
    if (value > high) high = value;
  }
  return high < low ? [0, 0] : [low, Math.fround((high - low) / 65535)];
}

/** Returns the packet of a chunk's records, as packet.rs makes it from the interval. `index`: the key frame at its end, as a BigInt. */
export function packetOf({ count, code, identity, birth, values }, { index, start, end, coarseness }) {
  const step = (k) => coarseness?.[k] ?? 1;
  /** Returns a column, or the sum of two, in binary32. */
  const scaled = (steps, k, other = null) => {
    const [out, a, b, first] = [new Float32Array(count), values[k], other === null ? null : values[other], step(k)];
    const second = b ? step(other) : 0;
    for (let i = 0; i < count; i++) out[i] = (a[i] * first + (b ? b[i] * second : 0)) / steps;
    return out;
  };
  const coloured = (at, steps) => [scaled(steps, at + 1, at), scaled(steps, at), scaled(steps, at + 2, at)];
  const octaves = (steps) => (q) => Math.exp((q / steps) * Math.LN2);
  const [opaque, sizes] = [octaves(STEPS.opacity), octaves(STEPS.size)];
  const lengths = [STEPS.across, STEPS.depth, STEPS.across].map((steps, k) => scaled(steps, k)).concat([0, 1, 2].map((k) => scaled(STEPS.motion, VELOCITY_AT + k)));
  const [colours, rates] = [coloured(GREEN_AT, STEPS.colour), coloured(RATE_AT, STEPS.rate)];
  const opacityOf = byNumber(values[OPACITY_AT], (q) => Math.fround(opaque(q * step(OPACITY_AT))));
  const opacity = Float32Array.from({ length: count }, (_, i) => opacityOf(i));
  const [y, vy] = [lengths[1], lengths[4]];
  const shown = [];
  for (let i = 0; i < count; i++) {
    const other = Math.fround(code[i] & 1 ? y[i] - vy[i] : y[i] + vy[i]);
    if (opacity[i] >= SEEN_AT && Math.max(y[i], other) >= 0 && Math.min(y[i], other) <= 1) shown.push(i);
  }
  let most = 0;
  for (const channel of rates) for (const i of shown) most = Math.max(most, Math.abs(channel[i]));
  const rateStep = Math.fround(most / (127 * 127));
  let beyond = 0;
  for (const channel of colours) for (const i of shown) beyond = Math.max(beyond, Math.fround(channel[i] - 1), -channel[i]);
  beyond = Math.min(0.25, beyond);
  const total = shown.length;
  const buffer = new ArrayBuffer(HEADER + total * (RECORD + 2 + (rateStep > 0 ? 3 : 0)));
  const view = new DataView(buffer);
  view.setUint32(0, 0x7373706b);
  view.setUint32(4, 1, true);
  view.setBigUint64(8, index, true);
  view.setFloat64(16, start, true);
  view.setFloat64(24, end, true);
  view.setUint32(32, total, true);
  const grids = lengths.map((values) => [values, ...gridOf(values, shown)]);
  grids.forEach(([, low, step], place) => {
    const offset = 40 + (place % 3) * 4 + (place > 2 ? 24 : 0);
    view.setFloat32(offset, low, true);
    view.setFloat32(offset + 12, step, true);
  });
  view.setFloat32(88, rateStep, true);
  view.setFloat32(92, beyond, true);
  const words = new Uint32Array(buffer, HEADER, total * WORDS);
  const shorts = new Uint16Array(buffer, HEADER, total * SHORTS);
  const bytes = new Uint8Array(buffer, HEADER, total * RECORD);
  const ages = new Uint16Array(buffer, HEADER + total * RECORD, total);
  const binary16 = (k, value) => byNumber(values[k], (q) => halfBits(Math.fround(value(q * step(k)))));
  const steepness = binary16(GAMMA_AT, (q) => Math.expm1((q / 32) * Math.LN2));
  const widths = byNumber(values[GAMMA_AT + 1], (q) => unit(Math.fround((q * step(GAMMA_AT + 1)) / 256), 65535));
  const scales = [0, 1].map((k) => binary16(SCALE_AT + k, sizes));
  const thickness = byNumber(values[THICKNESS_AT], (q) => {
    const quarters = nearestTo(4 * (Math.log(Math.fround(sizes(q * step(THICKNESS_AT)))) * Math.LOG2E));
    return Math.min(15, Math.max(-16, quarters)) & 31;
  });
  const [indexLow, indexHigh] = [Number(index & 0xffffffffn), Number(index >> 32n)];
  shown.forEach((i, place) => {
    const [word, short, byte] = [place * WORDS, place * SHORTS, place * RECORD];
    for (let k = 0; k < 6; k++) {
      const [values, low, step] = grids[k];
      shorts[short + k] = step > 0 ? Math.min(65535, Math.round((values[i] - low) / step)) : 0;
    }
    shorts[short + 6] = steepness(i);
    shorts[short + 7] = widths(i);
    for (let k = 0; k < 3; k++) bytes[byte + 16 + k] = unit((colours[k][i] + beyond) / (1 + 2 * beyond), 255);
    bytes[byte + 19] = unit(opacity[i], 255);
    shorts[short + 10] = scales[0](i);
    shorts[short + 11] = scales[1](i);
    words[word + 6] = identity[2 * i];
    words[word + 7] = (identity[2 * i + 1] & 0xffffff) | (code[i] << 24) | (thickness(i) << 27);
    const age = (indexHigh - birth[2 * i + 1]) * 2 ** 32 + indexLow - birth[2 * i];
    ages[place] = Math.min(65535, Math.max(0, age));
    if (!(rateStep > 0)) return;
    for (let k = 0; k < 3; k++) {
      const steps = Math.min(127, Math.round(Math.sqrt(Math.abs(rates[k][i]) / rateStep)));
      view.setInt8(HEADER + total * (RECORD + 2) + 3 * place + k, rates[k][i] < 0 ? -steps : steps);
    }
  });
  return buffer;
}

/** Decoder of consecutive chunks: each may need the previous one. */
export class Chunks {
  constructor() {
    this.place = -1;
    this.records = null;
  }

  /**
   * Returns the packet of the last of some consecutive chunks, { bytes, index, alone, count } each; null if the chunk before them is not available.
   */
  take({ place, parts, times, coarseness }) {
    let packet = null;
    for (const [k, { bytes, index, alone, count }] of parts.entries()) {
      const i = place + k;
      if (!alone && this.place !== i - 1) return null;
      try {
        this.records = decode(bytes, alone ? null : this.records, { count, coarseness });
      } catch (e) {
        throw new Error(`interval ${i}: ${e.message}`);
      }
      this.place = i;
      if (k === parts.length - 1) packet = packetOf(this.records, { index, ...times, coarseness });
    }
    return packet;
  }
}
