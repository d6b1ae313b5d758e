// Still scenes: one packet of Gaussians without time. still/packet.rs describes the layout.

const STILL_MAGIC = 0x73737374;
const STILL_HEADER = 16;
/** Bytes of a row of harmonics per degree. */
const STILL_ROW = 16;

/** The Gaussians of a still scene. */
class StillPacket {
  constructor(buffer) {
    const view = new DataView(buffer);
    if (buffer.byteLength < STILL_HEADER || view.getUint32(4, true) !== 1) throw new Error("not a still scene of a version this page reads");
    const [count, degree] = [view.getUint32(8, true), view.getUint16(12, true)];
    const length = STILL_HEADER + count * (RECORD + degree * STILL_ROW + 4);
    if (degree > 3 || buffer.byteLength !== length) throw new Error("a still scene of the wrong length");
    this.still = true;
    this.size = length;
    this.count = count;
    this.degree = degree;
    /** Whether Gaussians smaller than a pixel are drawn fainter, not wider. */
    this.antialiased = view.getUint16(14, true) === 1;
    [this.index, this.start, this.end] = [0, 0, 0];
    const rows = STILL_HEADER + count * RECORD;
    const numbers = rows + count * degree * STILL_ROW;
    this.words = new Uint32Array(buffer, STILL_HEADER, count * WORDS);
    this.floats = new Float32Array(buffer, STILL_HEADER, count * WORDS);
    this.shorts = new Uint16Array(buffer, STILL_HEADER, count * SHORTS);
    /** Harmonics as the graphics processor takes them, and by coefficient. */
    this.rows = new Uint32Array(buffer, rows, (count * degree * STILL_ROW) / 4);
    this.steps = new Int8Array(buffer, rows, count * degree * STILL_ROW);
    this.numbers = new Uint32Array(buffer, numbers, count);
  }

  place(i) {
    return Array.from(this.floats.subarray(i * WORDS, i * WORDS + 3));
  }

  /** Standard deviations along the Gaussian's own axes. */
  deviation(i) {
    return Array.from(this.shorts.subarray(i * SHORTS + 6, i * SHORTS + 9), (q) => Math.exp((48 * q) / 65535 - 24));
  }

  opacity(i) {
    return this.shorts[i * SHORTS + 9] / 65535;
  }

  /** The Gaussian's own axes. */
  axes(i) {
    const words = this.shorts.subarray(i * SHORTS + 13, i * SHORTS + 16);
    const left = (words[0] >> 15) | ((words[1] >> 15) << 1);
    const q = Array.from(words, (word) => Math.SQRT1_2 * ((word & 0x7fff) / 16383.5 - 1));
    q.splice(left, 0, Math.sqrt(Math.max(0, 1 - dot(q, q))));
    const [w, x, y, z] = q;
    return [
      [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
      [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
      [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
    ];
  }

  /** Red, green and blue in [0, 255], seen along the unit vector d. */
  colour(i, d) {
    const basis = harmonicsOf(d).slice(0, (this.degree + 1) ** 2 - 1);
    const at = i * this.degree * STILL_ROW;
    const step = this.degree ? half(new DataView(this.steps.buffer, this.steps.byteOffset + at + this.degree * STILL_ROW - 2).getUint16(0, true)) : 0;
    return [0, 1, 2].map((channel) => {
      const first = half(this.shorts[i * SHORTS + 10 + channel]);
      const rest = basis.reduce((sum, y, k) => sum + y * this.steps[at + 3 * k + channel], 0);
      return Math.round(255 * clamp(first + step * rest, 0, 1));
    });
  }

  /** The Gaussian's place in its file. */
  identity(i) {
    return BigInt(this.numbers[i]);
  }
}

/** Y₁ … Y₁₅ of a direction, as kernels/src/harmonics has them. */
function harmonicsOf([x, y, z]) {
  const [xx, yy, zz] = [x * x, y * y, z * z];
  const around = 4 * zz - xx - yy;
  const first = [-y, z, -x].map((v) => 0.4886025119029199 * v);
  const second = [1.0925484305920792 * x * y, -1.0925484305920792 * y * z, 0.31539156525252005 * (2 * zz - xx - yy), -1.0925484305920792 * x * z, 0.5462742152960396 * (xx - yy)];
  return [
    ...first,
    ...second,
    -0.5900435899266435 * y * (3 * xx - yy),
    2.890611442640554 * x * y * z,
    -0.4570457994644658 * y * around,
    0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
    -0.4570457994644658 * x * around,
    1.445305721320277 * z * (xx - yy),
    -0.5900435899266435 * x * (xx - 3 * yy),
  ];
}

/** The packet in a buffer, of whichever kind. */
function packetIn(buffer) {
  const still = buffer.byteLength >= 4 && new DataView(buffer).getUint32(0) === STILL_MAGIC;
  return still ? new StillPacket(buffer) : new Packet(buffer);
}
