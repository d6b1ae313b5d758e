// Files of still scenes read by the page itself. engine/src/formats documents the meaning of their numbers and which files are errors.

/** Bytes of a block. */
const BLOCK = 4 * 2 ** 20;
const Y0 = 0.28209479177387814;

/** Text as it can be shown in a message of one line. */
const quoted = (text) => JSON.stringify(text.slice(0, 40));

/** A value of JSON for such a message; what lies too deep for that is named. */
function shown(value) {
  try {
    return quoted(JSON.stringify(value) ?? "none");
  } catch {
    return "a value of many levels";
  }
}

/** The name of a part of a file, as it is where that is plain. */
const partNamed = (name) => (/^[\w.-]{1,40}$/.test(name) ? name : quoted(name));

/** Room for bytes of a part of a file. */
function roomFor(length, part) {
  try {
    return new Uint8Array(length);
  } catch {
    throw wrong(part, `room for ${length} bytes`, "less");
  }
}

/** A hint at the program, where that reads more than the page does. */
const program = (command = "view") => `(${command === "view" ? "open it" : "make a scene of it"} with: streamsplat ${command} FILE)`;

/** A table of numbers by bytes. */
const byByte = (value) => Float32Array.from({ length: 256 }, (_, byte) => value(byte));
const logitOf = (opacity) => Math.log(opacity) - Math.log(1 - opacity);
const LOGITS = byByte((byte) => logitOf(clamp(byte / 255, 1e-12, 1 - 1e-12)));

/** The first coefficient of a colour from 0 to 1. */
const coefficientOf = (colour) => (colour - 0.5) / Y0;

function checkCount(part, count, most) {
  if (count > most) throw wrong(part, `at most ${most} Gaussians in this browser`, count);
}

/** `length` bytes of a file. */
async function viewOf(file, start, length) {
  if (start + length > file.size) throw wrong("file", `${length} bytes from byte ${start} on`, Math.max(0, file.size - start));
  const buffer = await file.slice(start, start + length).arrayBuffer();
  if (buffer.byteLength !== length) throw wrong("file", `${length} bytes from byte ${start} on`, buffer.byteLength);
  return new DataView(buffer);
}

/** Calls `take(i, views, k)` for each of `count` rows: row i of each part, { start, width }, is row k of its view. */
async function eachRow(file, parts, count, take) {
  const most = Math.max(1, Math.floor(BLOCK / parts[0].width));
  for (let from = 0; from < count; from += most) {
    const rows = Math.min(most, count - from);
    const views = await Promise.all(parts.map(({ start, width }) => viewOf(file, start + from * width, rows * width)));
    for (let k = 0; k < rows; k++) take(from + k, views, k);
  }
}
