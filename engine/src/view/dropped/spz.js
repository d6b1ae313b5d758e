// SPZ of versions 2 and 3, as engine/src/import/spz reads it: a header and the attributes in one gzip stream.

const SPZ_HEADER = 16;
/** Decompressed bytes to one of the file at most, where they are more than the second number. */
const [MOST_RATIO, SMALL] = [64, 2 ** 20];
/** Signs of the harmonics where y and z change theirs. */
const SIGNS = [-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1];
const SPZ_LOGITS = byByte((byte) => logitOf(clamp(byte, 1, 254) / 255));
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
  check("version", version === 2 || version === 3, "2 or 3 in a gzip stream", version);
  check("degree of the harmonics", degree <= 4, "0 to 4", degree);
  check("fractional bits", bits <= 23, "0 to 23", bits);
  check("flags", flags <= 1 && !bytes[15], "none but anti-aliasing: no extensions", flags);
  checkCount("header: points", count, most);
  const starts = [0];
  for (const each of [9, 1, 3, 3, version + 1, 3 * restOf(degree)]) starts.push(starts[starts.length - 1] + each * count);
  const allowed = Math.max(size * MOST_RATIO, SMALL);
  check("points", starts[6] <= allowed, `at most ${Math.floor((allowed * count) / starts[6])} in ${size} bytes`, count);
  return { version, count, degree, bits, starts };
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
      [bytes, at] = [new Uint8Array(header.starts[6]), 0];
    }
  }
  if (!header || at < bytes.length) throw wrong(header ? "attributes" : "header", `${bytes.length} bytes`, at);
  return { ...header, bytes };
}

async function spzFile(file, most) {
  const { version, count, degree, bits, starts, bytes } = await gunzipped(file, most);
  const [positions, alphas, colours, scales, rotations, harmonics] = starts;
  const stored = 3 * restOf(degree);
  const writer = new StillWriter(count, Math.min(degree, 3));
  const { row } = writer;
  for (let i = 0; i < count; i++) {
    for (let axis = 0; axis < 3; axis++) {
      const at = positions + 9 * i + 3 * axis;
      const place = (((bytes[at] << 8) | (bytes[at + 1] << 16) | (bytes[at + 2] << 24)) >> 8) / 2 ** bits;
      row[axis] = axis ? -place : place;
      row[DEVIATIONS + axis] = bytes[scales + 3 * i + axis] / 16 - 10;
      row[COLOUR + axis] = SPZ_COLOURS[bytes[colours + 3 * i + axis]];
    }
    row[LOGIT] = SPZ_LOGITS[bytes[alphas + i]];
    const [x, y, z, w] = version === 2 ? firstThree(bytes, rotations + 3 * i) : smallestThree(bytes, rotations + 4 * i);
    row.set([w, x, -y, -z], QUATERNION);
    for (let k = 0; k < row.length - HIGHER; k++) row[HIGHER + k] = ((bytes[harmonics + i * stored + k] - 128) / 128) * SIGNS[Math.floor(k / 3)];
    writer.put(i);
  }
  return writer.finish();
}

/** x, y, z and w of version 2. */
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
