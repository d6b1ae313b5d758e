// SPZ, as engine/src/formats/spz reads it: versions 1 to 3 in one gzip stream, version 4 with a zstd frame for each attribute.

/** Bytes of the header before version 4, and in it. */
const [SPZ_HEADER, SPZ_HEADER_4] = [16, 32];
const ATTRIBUTES = ["positions", "alphas", "colours", "scales", "rotations", "harmonics"];
/** Decompressed bytes to one of the file at most, where they are more than the second number. */
const [MOST_RATIO, SMALL] = [64, 2 ** 20];
/** Axes that each coefficient of the harmonics is odd in. */
const ODD = ["y", "z", "x", "xy", "yz", "", "xz", "", "y", "xyz", "y", "z", "x", "z", "x"];
/** The flag of anti-aliased training. */
const ANTIALIASED = 1;
/** Extension records after the attributes: the flag, the most bytes, and the type of the one that says the axes. */
const [EXTENDED, MAX_RECORDS, AXES_RECORD] = [2, 2 ** 20, 0xadbe0003];
/** Axes by SPZ's numbers from 1 on; those after them have y as depth. */
const AXES = ["LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"];
const SPZ_COLOURS = byByte((byte) => (byte / 255 - 0.5) / 0.15);

/** A header's fields, and how many bytes each attribute has. */
function spzHeader(bytes, size, most, versions) {
  const view = new DataView(bytes.buffer, bytes.byteOffset);
  const [version, count] = [view.getUint32(4, true), view.getUint32(8, true)];
  const [degree, bits, flags] = bytes.subarray(12);
  const check = (name, fits, expected, found) => {
    if (!fits) throw wrong(`header: ${name}`, expected, found);
  };
  const magic = String.fromCharCode(...bytes.subarray(0, 4));
  check("first word", magic === "NGSP", "NGSP", quoted(magic));
  check("version", version >= versions[0] && version <= versions[1], `${versions.join(" to ")} in a file of this kind`, version);
  check("degree of the harmonics", degree <= 4, "0 to 4", degree);
  check("fractional bits", bits <= 23, "0 to 23", bits);
  check("flags", flags <= 3, "none but those of anti-aliasing (1) and of extensions (2)", flags);
  checkCount("header: points", count, most);
  const sizes = [version === 1 ? 6 : 9, 1, 3, 3, version < 3 ? 3 : 4, 3 * restOf(degree)].map((each) => each * count);
  const total = sizes.reduce((sum, size) => sum + size);
  const allowed = Math.max(size * MOST_RATIO, SMALL);
  check("points", total <= allowed, `at most ${Math.floor((allowed * count) / total)} in ${size} bytes`, count);
  return { version, count, degree, bits, antialiased: Boolean(flags & ANTIALIASED), extended: Boolean(flags & EXTENDED), sizes, total };
}

/** Consecutive parts of such sizes. */
function partsOf(bytes, sizes) {
  let at = 0;
  return sizes.map((size) => bytes.subarray(at, (at += size)));
}

/** Versions 1 to 3, one gzip stream: the header's fields, the attributes, and extension records. */
async function gunzipped(file, most) {
  const reader = file.stream().pipeThrough(new DecompressionStream("gzip")).getReader();
  let [header, bytes, at] = [null, new Uint8Array(SPZ_HEADER), 0];
  const broken = (e) => {
    throw wrong("gzip stream", "a whole one", e.message);
  };
  for (let next; !(next = await reader.read().catch(broken)).done; ) {
    for (let { value } = next; value.length; ) {
      const part = value.subarray(0, bytes.length - at);
      if (!part.length) throw wrong("attributes", `${header.total} bytes`, "more");
      bytes.set(part, at);
      at += part.length;
      value = value.subarray(part.length);
      if (header || at < SPZ_HEADER) continue;
      header = spzHeader(bytes, file.size, most, [1, 3]);
      if (bytes[15]) throw wrong("header: reserved byte", "0", bytes[15]);
      const more = header.extended ? MAX_RECORDS : header.version === 1 ? 3 * header.count : 0;
      [bytes, at] = [new Uint8Array(header.total + more), 0];
    }
  }
  const { version, count, extended, sizes, total } = header ?? { total: SPZ_HEADER };
  if (at < total) throw wrong(header ? "attributes" : "header", `${total} bytes`, at);
  // Version 1 has positions of 6 bytes. @adobe/spz writes 9, which the length shows.
  const wide = version === 1 && !extended && at > total;
  if (wide && at !== total + 3 * count) throw wrong("attributes", `${total} bytes, or ${total + 3 * count} with positions in fixed point`, at);
  const own = wide ? [9 * count, ...sizes.slice(1)] : sizes;
  return { ...header, halves: version === 1 && !wide, attributes: partsOf(bytes, own), records: wide ? new Uint8Array(0) : bytes.subarray(total, at) };
}

/** Version 4: a header, extension records, a table of lengths, and a zstd frame for each attribute that is not empty. */
async function unpacked(file, most) {
  const bytes = new Uint8Array(await file.slice(0, file.size).arrayBuffer());
  if (bytes.length < SPZ_HEADER_4) throw wrong("header", `${SPZ_HEADER_4} bytes`, bytes.length);
  const header = spzHeader(bytes, file.size, most, [4, 4]);
  const view = new DataView(bytes.buffer);
  const [table, streams] = [view.getUint32(16, true), header.sizes.filter(Boolean).length];
  const fits = header.extended ? table >= SPZ_HEADER_4 && table <= bytes.length : table === SPZ_HEADER_4;
  if (!fits || bytes.subarray(20, SPZ_HEADER_4).some(Boolean)) throw wrong("header: table", `it from byte ${SPZ_HEADER_4} on, and zeros between`, `it at ${table}`);
  if (bytes[15] !== streams) throw wrong("header: streams", streams, bytes[15]);
  let [entry, at] = [table, table + 16 * streams];
  if (at > bytes.length) throw wrong("table", `${streams} entries of 16 bytes`, `${bytes.length - table} bytes`);
  const attributes = header.sizes.map((size, k) => {
    if (!size) return new Uint8Array(0);
    const [length, whole] = [0, 8].map((half) => view.getUint32(entry + half, true) + 2 ** 32 * view.getUint32(entry + half + 4, true));
    entry += 16;
    if (whole !== size) throw wrong(ATTRIBUTES[k], `${size} bytes`, whole);
    if (at + length > bytes.length) throw wrong(ATTRIBUTES[k], `${length} bytes in the file`, `${bytes.length - at} bytes`);
    const frame = bytes.subarray(at, (at += length));
    try {
      return unzstd(frame, size);
    } catch (e) {
      throw wrong(ATTRIBUTES[k], `a zstd frame of ${size} bytes`, e.message);
    }
  });
  if (at !== bytes.length) throw wrong("file", "its end after the last stream", `${bytes.length - at} more bytes`);
  return { ...header, halves: false, attributes, records: bytes.subarray(SPZ_HEADER_4, table) };
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
  const old = new Uint8Array(await file.slice(0, 1).arrayBuffer())[0] === 0x1f;
  const { version, count, degree, bits, antialiased, halves, attributes, records } = await (old ? gunzipped : unpacked)(file, most);
  const code = axesInRecords(records);
  if (code > AXES.length) throw wrong("axes", `1 to ${AXES.length}`, `${code} ${program()}`);
  const stated = AXES[code - 1] ?? (old ? await axesInComment(file) : null);
  const axes = said ?? stated ?? "RUB";
  const signs = signsOf(axes);
  const [sx, sy, sz] = signs;
  const odd = ODD.map((letters) => [...letters].reduce((sign, letter) => sign * signs["xyz".indexOf(letter)], 1));
  const [positions, alphas, colours, scales, rotations, harmonics] = attributes;
  const stored = 3 * restOf(degree);
  const writer = new StillWriter(count, Math.min(degree, 3), antialiased);
  const { row } = writer;
  for (let i = 0; i < count; i++) {
    for (let axis = 0; axis < 3; axis++) {
      const at = halves ? 6 * i + 2 * axis : 9 * i + 3 * axis;
      const fixed = () => (((positions[at] << 8) | (positions[at + 1] << 16) | (positions[at + 2] << 24)) >> 8) / 2 ** bits;
      row[axis] = signs[axis] * (halves ? half(positions[at] | (positions[at + 1] << 8)) : fixed());
      row[DEVIATIONS + axis] = scales[3 * i + axis] / 16 - 10;
      row[COLOUR + axis] = SPZ_COLOURS[colours[3 * i + axis]];
    }
    row[LOGIT] = LOGITS[alphas[i]];
    const [x, y, z, w] = version < 3 ? firstThree(rotations, 3 * i) : smallestThree(rotations, 4 * i);
    row.set([w, x * (sy * sz), y * (sx * sz), z * (sx * sy)], QUATERNION);
    for (let k = 0; k < row.length - HIGHER; k++) row[HIGHER + k] = ((harmonics[i * stored + k] - 128) / 128) * odd[Math.floor(k / 3)];
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
