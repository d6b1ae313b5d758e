// Gaussians of a file made into a packet, as still/packet.rs does it, with the box that still/framing.rs finds.
//
// A Gaussian is a row of binary32 numbers: the centre, the logit, logarithms of deviations, the quaternion (w first), the first coefficients,
// and the others with channels innermost.

const [LOGIT, DEVIATIONS, QUATERNION, COLOUR, HIGHER] = [3, 4, 7, 11, 14];
const VISIBLE = Math.fround(1 / 255);
/** Logit of the least opacity that counts for the box; share of centres beyond either end that may be floaters; the margin. */
const [OPAQUE, FLOATERS, AROUND] = [Math.fround(-2.2), 0.05, 0.15];

/** Coefficients above the first, per channel. */
const restOf = (degree) => (degree + 1) ** 2 - 1;

/** The nearest whole number, halves away from zero, within bounds. */
const whole = (x, low, high) => clamp(x < 0 ? -Math.floor(0.5 - x) : Math.floor(x + 0.5), low, high);

class StillWriter {
  /** Room for `count` Gaussians, of which those that no image shows are left out. `antialiased`: the file's mark of such training. */
  constructor(count, degree, antialiased) {
    this.degree = degree;
    this.antialiased = antialiased;
    this.room = count;
    this.count = 0;
    this.rows = STILL_HEADER + count * RECORD;
    this.ends = this.rows + count * degree * STILL_ROW;
    try {
      this.buffer = new ArrayBuffer(this.ends + 4 * count);
      // By axis: centres that count for the box from the front on, other finite ones from the end.
      this.centres = [0, 1, 2].map(() => new Float32Array(count));
    } catch {
      throw wrong("memory", `room for ${count} Gaussians`, "less");
    }
    [this.solid, this.faint] = [0, count];
    this.floats = new Float32Array(this.buffer);
    this.shorts = new Uint16Array(this.buffer);
    this.steps = new Int8Array(this.buffer);
    this.words = new Uint32Array(this.buffer);
    /** The row that `put` takes. */
    this.row = new Float32Array(HIGHER + 3 * restOf(degree));
  }

  /** Takes the row as Gaussian `i` of the file. */
  put(i) {
    const { row, shorts } = this;
    if (Number.isFinite(row[0]) && Number.isFinite(row[1]) && Number.isFinite(row[2])) {
      const at = row[LOGIT] >= OPAQUE ? this.solid++ : --this.faint;
      for (let axis = 0; axis < 3; axis++) this.centres[axis][at] = row[axis];
    }
    // As in still/sound.rs, for drawn Gaussians. A logit may be infinite, and so may be the logarithm of a thickness of 0.
    if (Number.isNaN(row[LOGIT])) return;
    for (let k = DEVIATIONS; k < QUATERNION; k++) if (!(Math.fround(Math.exp(row[k])) < Infinity)) return;
    for (let k = 0; k < row.length; k++) if (!Number.isFinite(row[k]) && (k < LOGIT || k >= QUATERNION)) return;
    const opacity = Math.fround(1 / (1 + Math.exp(-clamp(row[LOGIT], -200, 200))));
    const at = (STILL_HEADER + this.count * RECORD) / 2;
    if (opacity < VISIBLE || !this.turn(at + 13)) return;
    for (let axis = 0; axis < 3; axis++) {
      this.floats[at / 2 + axis] = row[axis];
      shorts[at + 6 + axis] = whole(65535 * clamp((row[DEVIATIONS + axis] / 24 + 1) / 2, 0, 1), 0, 65535);
      shorts[at + 10 + axis] = halfBits(Math.fround(0.5 + row[COLOUR + axis] * Y0));
    }
    shorts[at + 9] = whole(65535 * opacity, 0, 65535);
    if (this.degree) this.harmonics();
    this.words[this.ends / 4 + this.count++] = i;
  }

  /** Writes three components of the row's quaternion, and which is left out; false where it has no length. */
  turn(at) {
    const { row, shorts } = this;
    let left = 0;
    for (let k = 1; k < 4; k++) if (Math.abs(row[QUATERNION + k]) > Math.abs(row[QUATERNION + left])) left = k;
    const most = Math.abs(row[QUATERNION + left]);
    let squares = 0;
    for (let k = QUATERNION; k < COLOUR; k++) squares += (row[k] / most) * (row[k] / most);
    const norm = Math.sqrt(squares) * Math.sign(row[QUATERNION + left]);
    for (let k = 0, place = 0; k < 4; k++) {
      if (k === left) continue;
      const steps = (row[QUATERNION + k] / most / norm) * Math.SQRT2;
      shorts[at + place] = whole((steps + 1) * 16383.5, 0, 0x7fff) | (((left >> place) & 1) << 15);
      place++;
    }
    return most > 0;
  }

  /** Writes the row's harmonics in steps. */
  harmonics() {
    const { row, steps, degree } = this;
    let largest = 0;
    for (let k = HIGHER; k < row.length; k++) largest = Math.max(largest, Math.abs(row[k]));
    // The next binary16 number up, so that the largest coefficient has no more than 127 steps.
    let bits = halfBits(Math.fround(largest / 127));
    if (half(bits) * 127 < largest && bits < 0x7bff) bits++;
    const step = half(bits) || Infinity;
    const at = this.rows + this.count * degree * STILL_ROW;
    for (let k = HIGHER; k < row.length; k++) steps[at + k - HIGHER] = whole(Math.fround(row[k] / step), -128, 127);
    this.shorts[(at + degree * STILL_ROW) / 2 - 1] = bits;
  }

  /** The packet, and the box that holds most of it. */
  finish() {
    const { room, count, degree, solid, faint, rows, ends } = this;
    const some = solid ? [0, solid] : [faint, room];
    if (some[0] === some[1]) throw wrong("centres", "Gaussians at finite places", "none to look at");
    const box = this.centres.map((centres) => {
      const along = centres.subarray(...some).sort();
      const [first, low, high, last] = [0, FLOATERS, 1 - FLOATERS, 1].map((share) => along[whole(share * (along.length - 1), 0, room)]);
      const around = AROUND * (high - low);
      return [Math.max(first, low - around), Math.min(last, high + around)];
    });
    const length = STILL_HEADER + count * (RECORD + degree * STILL_ROW + 4);
    const numbers = length - 4 * count;
    this.steps.copyWithin(STILL_HEADER + count * RECORD, rows, rows + count * degree * STILL_ROW);
    this.steps.copyWithin(numbers, ends, ends + 4 * count);
    const header = new DataView(this.buffer);
    header.setUint32(0, STILL_MAGIC);
    [1, count, degree | (this.antialiased ? 1 << 16 : 0)].forEach((value, k) => header.setUint32(4 + 4 * k, value, true));
    const buffer = count === room ? this.buffer : this.buffer.slice(0, length);
    return { buffer, degree, least: box.map(([low]) => low), greatest: box.map(([, high]) => high) };
  }
}
