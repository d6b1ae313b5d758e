// Binary PLY files of floats, as engine/src/formats/ply reads them.

const MAX_HEADER = 1 << 22;
/** Bytes after the last element that are passed over at most: line ends and zeros. */
const MAX_AFTER = 16;
/** Bytes of the scalar types. */
const TYPES = { char: 1, int8: 1, uchar: 1, uint8: 1, short: 2, int16: 2, ushort: 2, uint16: 2, half: 2, float16: 2, int: 4, int32: 4, uint: 4, uint32: 4, float: 4, float32: 4, double: 8, float64: 8 };
/** Types that are read, by their other names. */
const SAME = { float32: "float", uint32: "uint", uint8: "uchar" };
/** Properties in the order of a Gaussian's row. */
const WANTED = ["x", "y", "z", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3", "f_dc_0", "f_dc_1", "f_dc_2"];

/** Comments that mark a scene as trained with anti-aliasing or without, as engine/src/formats/ply/comments.rs reads them; null for others. */
function markOf([key, value, ...more]) {
  if (more.length || value === undefined) return null;
  const marks = { "splatrendermode: mip": true, "splatrendermode: default": false, "splatrendermode: 2dgs": false, "antialiased 1": true, "antialiased 0": false };
  return marks[`${key} ${value}`.toLowerCase()] ?? null;
}

/** A header's lines, split into words, where they end, and the last mark among its comments. */
function linesOf(bytes) {
  const lines = [];
  let antialiased = false;
  for (let at = 0; ; ) {
    const end = bytes.indexOf(10, at);
    if (end < 0) throw wrong("header", `end_header within the first ${MAX_HEADER} bytes`, "none");
    const words = String.fromCharCode(...bytes.subarray(at, Math.min(end, at + 200))).trim().split(/\s+/);
    at = end + 1;
    if (words[0] === "end_header") return { lines, end: at, antialiased };
    // Comments are in any encoding, and there may be many.
    if (words[0] === "comment") antialiased = markOf(words.slice(1)) ?? antialiased;
    else if (words[0] !== "obj_info") lines.push(words);
  }
}

/** The elements of a file of `size` bytes, by name, each with where it starts and how wide its rows are. */
function elementsOf(bytes, size) {
  const { lines, end, antialiased } = linesOf(bytes);
  const elements = new Map();
  let last = null;
  for (const [key, a, b] of lines.slice(1)) {
    if (key === "format" && a !== "binary_little_endian") throw wrong("format", "binary_little_endian", `${quoted(a ?? "")} ${program()}`);
    if (key === "element") {
      if (elements.has(a) || !/^\d+$/.test(b)) throw wrong(`element ${a}`, "it once, and how many there are", elements.has(a) ? "it twice" : quoted(b ?? ""));
      last = { name: a, count: Number(b), width: 0, properties: new Map() };
      elements.set(a, last);
    } else if (key === "property") {
      // Without rows there are no lists.
      if (a === "list" && last?.count === 0) continue;
      if (!last || b === undefined || !Object.hasOwn(TYPES, a) || last.properties.has(b)) throw wrong(`property ${b ?? a}`, "a number of an element, once", quoted(a ?? ""));
      last.properties.set(b, { type: SAME[a] ?? a, start: last.width });
      last.width += TYPES[a];
    } else if (key !== "format") {
      throw wrong("header", "format, then elements with their properties, then end_header", quoted(key));
    }
  }
  if (!lines.some(([key]) => key === "format")) throw wrong("format", "a line before end_header", "none");
  if (!elements.has("vertex")) throw wrong("element vertex", "a line before end_header", "none");
  let at = end;
  for (const element of elements.values()) {
    element.start = at;
    at += element.count * element.width;
    if (at > size) throw wrong(`element ${element.name}`, `${element.count} of ${element.width} bytes each`, `${size - element.start} bytes`);
  }
  if (size - at > MAX_AFTER) throw wrong("file", "its end after the last element", `${size - at} more bytes`);
  return { elements, end: at, antialiased };
}

/** Where a property of one type stands in a row of an element. */
function startOf({ name, properties }, property, type) {
  const { type: found = "none", start } = properties.get(property) ?? {};
  if (found !== type) throw wrong(`property ${property} of ${name}`, type, found);
  return start;
}

/** An error where bytes after the last element are not line ends or zeros. */
async function checkAfter(file, end) {
  const after = new Uint8Array(await file.slice(end).arrayBuffer());
  if (after.some((byte) => ![0, 10, 13, 32].includes(byte))) throw wrong("file", "its end after the last element", `${after.length} more bytes`);
}

/** Degree of the harmonics that so many coefficients above the first are; of degree 4 those up to degree 3 are read. */
function degreeOf(rest) {
  const degree = [0, 9, 24, 45, 72].indexOf(rest);
  if (degree < 0) throw wrong("properties f_rest_*", "none, 9, 24, 45 or 72 of them", rest);
  return Math.min(degree, 3);
}

/** Number k of a row's higher coefficients in a file, where channels are outermost. */
const placeOf = (k, rest) => (k % 3) * (rest / 3) + Math.floor(k / 3);

async function plyFile(file, most) {
  const { elements, end, antialiased } = elementsOf(new Uint8Array(await file.slice(0, MAX_HEADER).arrayBuffer()), file.size);
  await checkAfter(file, end);
  const vertices = elements.get("vertex");
  if (elements.has("chunk") && vertices.properties.has("packed_position")) return packedFile(file, elements, most, antialiased);
  const rest = [...vertices.properties.keys()].filter((name) => name.startsWith("f_rest_")).length;
  const degree = degreeOf(rest);
  // Without a third scale, as of 2D Gaussian splatting, Gaussians have no thickness.
  const flat = vertices.properties.has("scale_1") && !vertices.properties.has("scale_2");
  const wanted = WANTED.map((name) => (flat && name === "scale_2" ? "scale_1" : name));
  const names = [...wanted, ...Array.from({ length: 3 * restOf(degree) }, (_, k) => `f_rest_${placeOf(k, rest)}`)];
  const starts = names.map((name) => startOf(vertices, name, "float"));
  checkCount("element vertex", vertices.count, most);
  const writer = new StillWriter(vertices.count, degree, antialiased);
  await eachRow(file, [vertices], vertices.count, (i, [view], k) => {
    for (let n = 0; n < starts.length; n++) writer.row[n] = view.getFloat32(k * vertices.width + starts[n], true);
    if (flat) writer.row[DEVIATIONS + 2] = -Infinity;
    writer.put(i);
  });
  return writer.finish();
}
