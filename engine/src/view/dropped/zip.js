// Files inside a zip file: stored, or compressed by deflate.

/** Bytes of the end of a zip file, of an entry in its directory, of a file's own header, and of the longest comment. */
const [ZIP_END, ZIP_ENTRY, ZIP_LOCAL, ZIP_COMMENT] = [22, 46, 30, 65535];
const [STORED, DEFLATED] = [0, 8];
/** Bytes of a directory at most, and bytes that a deflate stream may have above 1.01 times those of its content. */
const [MAX_DIRECTORY, MORE_STORED] = [2 ** 24, 1024];
/** Remainders of bytes: CRC-32 as of zip files, lowest bit first. */
const REMAINDERS = Int32Array.from({ length: 256 }, (_, byte) => {
  for (let bit = 0; bit < 8; bit++) byte = byte & 1 ? (byte >>> 1) ^ 0xedb88320 : byte >>> 1;
  return byte;
});
const crcOf = (bytes) => ~bytes.reduce((crc, byte) => (crc >>> 8) ^ REMAINDERS[(crc ^ byte) & 255], -1) >>> 0;

/** The directory of a zip file: how each file is stored, how long, and where, by name. */
async function zipOf(file) {
  const from = Math.max(0, file.size - ZIP_END - ZIP_COMMENT);
  const tail = await viewOf(file, from, file.size - from);
  let end = tail.byteLength - ZIP_END;
  while (end >= 0 && tail.getUint32(end, true) !== 0x06054b50) end--;
  if (end < 0) throw wrong("zip file", "its directory's end", "none");
  const [count, length, start] = [tail.getUint16(end + 10, true), tail.getUint32(end + 12, true), tail.getUint32(end + 16, true)];
  if (start + length > file.size) throw wrong("zip file", `its directory within ${file.size} bytes`, `it up to byte ${start + length}`);
  if (length > MAX_DIRECTORY) throw wrong("zip file", `a directory of at most ${MAX_DIRECTORY} bytes`, length);
  const directory = await viewOf(file, start, length);
  const entries = new Map();
  for (let k = 0, at = 0; k < count; k++) {
    const word = (field) => directory.getUint32(at + field, true);
    const short = (field) => directory.getUint16(at + field, true);
    const whole = at + ZIP_ENTRY <= length && word(0) === 0x02014b50;
    const next = whole ? at + ZIP_ENTRY + short(28) + short(30) + short(32) : Infinity;
    if (next > length) throw wrong("zip file", `${count} entries in its directory`, k);
    const name = new TextDecoder().decode(new Uint8Array(directory.buffer, at + ZIP_ENTRY, short(28)));
    entries.set(name, { method: short(10), crc: word(16), packed: word(20), size: word(24), start: word(42) });
    at = next;
  }
  return entries;
}

/** The bytes of a file of at most `most` bytes in a zip file. */
async function unzipped(file, entries, name, most) {
  const entry = entries.get(name);
  name = partNamed(name);
  if (!entry) throw wrong(name, "a file in the zip file", "none");
  const { method, crc, packed, size, start } = entry;
  const allowed = Math.min(most, Math.max(packed * MOST_RATIO, SMALL));
  if (size > allowed) throw wrong(name, `at most ${allowed} bytes`, size);
  if (method !== STORED && method !== DEFLATED) throw wrong(name, "a stored or deflated file", `method ${method} ${program()}`);
  const largest = method === STORED ? size : 1.01 * size + MORE_STORED;
  if (packed > largest || (method === STORED && packed < size)) throw wrong(name, `${size} bytes`, `${packed} stored`);
  const header = await viewOf(file, start, ZIP_LOCAL);
  const from = start + ZIP_LOCAL + header.getUint16(26, true) + header.getUint16(28, true);
  const stored = new Uint8Array((await viewOf(file, from, packed)).buffer);
  const bytes = method === DEFLATED ? await inflated(stored, size, name) : stored;
  if (crcOf(bytes) !== crc) throw wrong(name, "the checksum of its bytes", "another");
  return bytes;
}

/** The `size` bytes that a deflate stream has. */
async function inflated(bytes, size, name) {
  const out = roomFor(size, name);
  let [at, more] = [0, false];
  try {
    const reader = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw")).getReader();
    for (let next; !more && !(next = await reader.read()).done; at += next.value.length) {
      more = next.value.length > size - at;
      if (!more) out.set(next.value, at);
    }
    if (more) await reader.cancel();
  } catch (e) {
    throw wrong(name, "a whole deflate stream", quoted(e.message));
  }
  if (more || at < size) throw wrong(name, `${size} bytes`, more ? "more" : at);
  return out;
}
