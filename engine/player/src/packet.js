// Packets: one interval's Gaussians as the server sends them. packet.rs describes the layout.

export const HEADER = 96;
export const RECORD = 32;
export const WORDS = RECORD / 4;
export const SHORTS = RECORD / 2;

/** Converts 16 bits of IEEE binary16 to a number. */
export function half(bits) {
  const sign = bits & 0x8000 ? -1 : 1;
  const exponent = (bits >> 10) & 31;
  const fraction = bits & 1023;
  if (exponent === 0) return sign * fraction * 2 ** -24;
  if (exponent === 31) return fraction ? NaN : sign * Infinity;
  return sign * (1 + fraction / 1024) * 2 ** (exponent - 15);
}

/** Returns the bits of the nearest binary16 number, halves to even, clamped to the largest. */
export function halfBits(value) {
  const size = Math.min(Math.abs(value), 65504);
  const exponent = Math.max(-14, Math.floor(Math.log2(size)));
  const steps = size / 2 ** (exponent - 10) + 2 ** 52 - 2 ** 52;
  return (value < 0 ? 0x8000 : 0) + ((exponent + 14) << 10) + steps;
}

/** One interval. `words`, `shorts` and `bytes` are views of the same records. */
export class Packet {
  constructor(buffer) {
    const view = new DataView(buffer);
    const magic = buffer.byteLength >= HEADER ? view.getUint32(0) : 0;
    if (magic !== 0x7373706b || view.getUint32(4, true) !== 1) throw new Error("not an interval of a version this page reads");
    const count = view.getUint32(32, true);
    this.rateStep = view.getFloat32(88, true);
    this.beyond = view.getFloat32(92, true);
    const rates = this.rateStep > 0 ? count : 0;
    if (buffer.byteLength !== HEADER + count * (RECORD + 2) + 3 * rates) throw new Error("an interval of the wrong length");
    const vector = (at) => [0, 4, 8].map((offset) => view.getFloat32(at + offset, true));
    this.size = buffer.byteLength;
    this.index = Number(view.getBigUint64(8, true));
    this.start = view.getFloat64(16, true);
    this.end = view.getFloat64(24, true);
    this.count = count;
    this.positionLow = vector(40);
    this.positionStep = vector(52);
    this.velocityLow = vector(64);
    this.velocityStep = vector(76);
    this.words = new Uint32Array(buffer, HEADER, count * WORDS);
    this.shorts = new Uint16Array(buffer, HEADER, count * SHORTS);
    this.bytes = new Uint8Array(buffer, HEADER, count * RECORD);
    this.ages = new Uint16Array(buffer, HEADER + count * RECORD, count);
    /** Three per record, `rateStep * q * |q|` each; empty if colours do not change. */
    this.rates = new Int8Array(buffer, HEADER + count * (RECORD + 2), 3 * rates);
  }

  /** Returns 0 if record i belongs to the interval's start, 1 if it belongs to its end. */
  reference(i) {
    return this.bytes[i * RECORD + 31] & 1;
  }

  /** Returns the key frame in which record i first appeared. */
  birth(i) {
    return this.index - this.ages[i];
  }

  /** Returns 0: stays; 1: fades in after the start; 2: fades out before the end. */
  handover(i) {
    return (this.bytes[i * RECORD + 31] >> 1) & 3;
  }

  identity(i) {
    const low = this.words[i * WORDS + 6];
    const high = this.words[i * WORDS + 7] & 0xffffff;
    return (BigInt(high) << 32n) | BigInt(low);
  }

  /** Returns red, green and blue at the reference time, 255 for one; some lie `255 * beyond` under 0 or above 255. */
  colour(i) {
    const value = (byte) => (1 + 2 * this.beyond) * byte - 255 * this.beyond;
    return Array.from(this.bytes.subarray(i * RECORD + 16, i * RECORD + 19), value);
  }

  opacity(i) {
    return this.bytes[i * RECORD + 19] / 255;
  }

  gamma(i) {
    return [half(this.shorts[i * SHORTS + 6]), this.shorts[i * SHORTS + 7] / 65535];
  }

  /** Returns the standard deviation along scene-space z over the mean of the other two. */
  thickness(i) {
    return 2 ** (((this.words[i * WORDS + 7] | 0) >> 27) / 4);
  }

  /** Returns the standard deviations along scene-space x, y and z. */
  deviation(i) {
    const x = half(this.shorts[i * SHORTS + 10]);
    const y = half(this.shorts[i * SHORTS + 11]);
    return [x, y, 0.5 * (x + y) * this.thickness(i)];
  }
}
