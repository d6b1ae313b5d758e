// SPZ of versions 1 to 3, as engine/src/import/spz reads it: a header and the attributes in one gzip stream.

const SPZ_HEADER = 16;
/** Decompressed bytes to one of the file at most, where they are more than the second number. */
const [MOST_RATIO, SMALL] = [64, 2 ** 20];
/** Axes that each coefficient of the harmonics is odd in. */
const ODD = ["y", "z", "x", "xy", "yz", "", "xz", "", "y", "xyz", "y", "z", "x", "z", "x"];
/** Extension records after the attributes: the flag, the most bytes, and the type of the one that says the axes. */
const [EXTENDED, MAX_RECORDS, AXES_RECORD] = [2, 2 ** 20, 0xadbe0003];
/** Axes by SPZ's numbers from 1 on; those after them have y as depth. */
const AXES = ["LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"];
const SPZ_COLOURS = byByte((byte) => (byte / 255 - 0.5) / 0.15);

/** A header's fields, where each attribute starts after it, and where the last one ends. */
function spzHeader(bytes, size, most) {
  const view = new DataView(bytes.buffer);
  const [version, count] = [view.getUint32(4, true), view.getUint32(8, true)];
  const [degree, bits, flags] = bytes.subarray(12);
  const check = (name, fits, expected, found) => {
    if (!fits) throw wrong(`header: ${name}`, expected, found);
  };
  const magic = String.fromCharCode(...bytes.subarray(0, 4));
  check("first word", magic === "NGSP", "NGSP", quoted(magic));
  check("version", version >= 1 && version <= 3, "1 to 3 in a gzip stream", version);
  check("degree of the harmonics", degree <= 4, "0 to 4", degree);
  check("fractional bits", bits <= 23, "0 to 23", bits);
  check("flags", flags <= 3 && !bytes[15], "none but those of anti-aliasing (1) and of extensions (2)", flags);
  checkCount("header: points", count, most);
  const starts = [0];
  for (const each of [version === 1 ? 6 : 9, 1, 3, 3, version === 3 ? 4 : 3, 3 * restOf(degree)]) starts.push(starts[starts.length - 1] + each * count);
  const allowed = Math.max(size * MOST_RATIO, SMALL);
  check("points", starts[6] <= allowed, `at most ${Math.floor((allowed * count) / starts[6])} in ${size} bytes`, count);
  return { version, count, degree, bits, starts, more: flags & EXTENDED ? MAX_RECORDS : 0 };
}

/** A gzip stream's header, and the bytes after it: as many as that says. */
async function gunzipped(file, most) {
  const reader = file.stream().pipeThrough(new DecompressionStream("gzip")).getReader();
  let [header, bytes, at] = [null, new Uint8Array(SPZ_HEADER), 0];
  const broken = (e) => {
    throw wrong("gzip stream", "a whole one", e.message);
  };
  for (let next; !(next = await reader.read().catch(broken)).done; ) {
    for (let { value } = next; value.length; ) {
      const part = value.subarray(0, bytes.length - at);
      if (!part.length) throw wrong("attributes", `${bytes.length} bytes`, "more");
      bytes.set(part, at);
      at += part.length;
      value = value.subarray(part.length);
      if (header || at < SPZ_HEADER) continue;
      header = spzHeader(bytes, file.size, most);
      [bytes, at] = [new Uint8Array(header.starts[6] + header.more), 0];
    }
  }
  const least = header ? header.starts[6] : SPZ_HEADER;
  if (at < least) throw wrong(header ? "attributes" : "header", `${least} bytes`, at);
  return { ...header, bytes, records: bytes.subarray(least, at) };
}

/** The number of the axes in extension records, or 0. */
function axesInRecords(records) {
  const view = new DataView(records.buffer, records.byteOffset, records.byteLength);
  let code = 0;
  for (let at = 0; at < records.length; ) {
    const length = at + 8 <= records.length ? view.getUint32(at + 4, true) : Infinity;
    if (at + 8 + length > records.length) throw wrong("extension record", "whole ones", `${records.length - at} bytes`);
    if (view.getUint32(at, true) === AXES_RECORD && length === 4) code = view.getUint32(at + 8, true);
    at += 8 + length;
  }
  return code;
}

/** The axes in the comment of a gzip stream, where this program states them. */
async function axesInComment(file) {
  const head = new Uint8Array(await file.slice(0, 4096).arrayBuffer());
  const flags = head[3];
  let at = 10;
  if (flags & 4) at += 2 + head[at] + 256 * head[at + 1];
  for (const [flag, isComment] of [[8, false], [16, true]]) {
    if (!(flags & flag)) continue;
    const end = head.indexOf(0, at);
    if (end < 0) return null;
    if (isComment) return /\baxes ([A-Z]{3})\b/.exec(String.fromCharCode(...head.subarray(at, end)))?.[1] ?? null;
    at = end + 1;
  }
  return null;
}

/** Signs by which x, y and z along these axes become those of scene space. */
function signsOf(axes) {
  if (!AXES.includes(axes)) throw wrong("axes", AXES.join(", "), `${quoted(axes)} ${program()}`);
  return ["R", "D", "F"].map((letter, k) => (axes[k] === letter ? 1 : -1));
}

async function spzFile(file, most, said) {
  const { version, count, degree, bits, starts, bytes, records } = await gunzipped(file, most);
  const code = axesInRecords(records);
  if (code > AXES.length) throw wrong("axes", `1 to ${AXES.length}`, `${code} ${program()}`);
  const stated = AXES[code - 1] ?? (await axesInComment(file));
  const axes = said ?? stated ?? "RUB";
  const signs = signsOf(axes);
  const [sx, sy, sz] = signs;
  const odd = ODD.map((letters) => [...letters].reduce((sign, letter) => sign * signs["xyz".indexOf(letter)], 1));
  const [positions, alphas, colours, scales, rotations, harmonics] = starts;
  const stored = 3 * restOf(degree);
  const writer = new StillWriter(count, Math.min(degree, 3));
  const { row } = writer;
  for (let i = 0; i < count; i++) {
    for (let axis = 0; axis < 3; axis++) {
      const at = positions + (version === 1 ? 6 * i + 2 * axis : 9 * i + 3 * axis);
      const fixed = () => (((bytes[at] << 8) | (bytes[at + 1] << 16) | (bytes[at + 2] << 24)) >> 8) / 2 ** bits;
      row[axis] = signs[axis] * (version === 1 ? half(bytes[at] | (bytes[at + 1] << 8)) : fixed());
      row[DEVIATIONS + axis] = bytes[scales + 3 * i + axis] / 16 - 10;
      row[COLOUR + axis] = SPZ_COLOURS[bytes[colours + 3 * i + axis]];
    }
    row[LOGIT] = LOGITS[bytes[alphas + i]];
    const [x, y, z, w] = version < 3 ? firstThree(bytes, rotations + 3 * i) : smallestThree(bytes, rotations + 4 * i);
    row.set([w, x * (sy * sz), y * (sx * sz), z * (sx * sy)], QUATERNION);
    for (let k = 0; k < row.length - HIGHER; k++) row[HIGHER + k] = ((bytes[harmonics + i * stored + k] - 128) / 128) * odd[Math.floor(k / 3)];
    writer.put(i);
  }
  const note = said || stated ? "" : "axes taken as RUB, which the file does not say; add #axes=rdf to the address where it was written with PLY's, and open it again";
  return { ...writer.finish(), note };
}

/** x, y, z and w before version 3. */
function firstThree(bytes, at) {
  const [x, y, z] = [0, 1, 2].map((k) => bytes[at + k] / 127.5 - 1);
  return [x, y, z, Math.sqrt(Math.max(0, 1 - (x * x + y * y + z * z)))];
}

/** The same of version 3: the three smallest, a sign and nine bits each, and in the highest bits which is the largest. */
function smallestThree(bytes, at) {
  let word = bytes[at] | (bytes[at + 1] << 8) | (bytes[at + 2] << 16) | (bytes[at + 3] << 24);
  const largest = word >>> 30;
  const q = [0, 0, 0, 0];
  let squares = 0;
  for (let k = 3; k >= 0; k--) {
    if (k === largest) continue;
    const size = (Math.SQRT1_2 * (word & 511)) / 511;
    q[k] = word & 512 ? -size : size;
    squares += size * size;
    word >>>= 10;
  }
  q[largest] = Math.sqrt(Math.max(0, 1 - squares));
  return q;
}
