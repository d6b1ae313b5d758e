// SOG of version 2 in one zip file, as engine/src/formats/sog reads it: lossless WebP images with a value per Gaussian, and meta.json.

const MAX_META = 2 ** 20;
/** Rows of coefficients per line of the centroids' image, and at most. */
const [SOG_ROWS, MOST_ROWS_OF_SOG] = [64, 65536];
/** The alpha of a rotation whose first component is the largest. */
const SOG_LARGEST = 252;
/** Bytes in memory per byte of a file of Gaussians at most, and those that any may take, as engine/src/formats/limits.rs has them. */
const [MOST_MEMORY, SOME_MEMORY] = [256, 2 ** 24];

/** Checks that Gaussians take no more memory than a file of this size may. */
function checkMemory(part, count, degree, size) {
  const [each, room] = [56 + 12 * restOf(degree), Math.max(MOST_MEMORY * size, SOME_MEMORY)];
  if (count * each > room) throw wrong(part, `at most ${Math.floor(room / each)} in ${size} bytes`, count);
}

/** JSON from bytes. */
function jsonOf(bytes, part) {
  try {
    return JSON.parse(new TextDecoder().decode(bytes));
  } catch (e) {
    throw wrong(part, "JSON", quoted(e.message));
  }
}

/** A value of meta.json, which must be a list of `count` numbers or texts. */
function listOf(meta, path, count, kind) {
  const value = path.split(".").reduce((found, key) => found?.[key], meta);
  const fits = Array.isArray(value) && value.length === count && value.every((one) => typeof one === kind && (kind !== "number" || Number.isFinite(one)));
  if (!fits) throw wrong(`meta.json: ${path}`, `${count} of the type ${kind}`, shown(value));
  return value;
}

/** A whole number of meta.json within bounds. */
function numberOf(value, path, low, high) {
  if (!Number.isInteger(value) || value < low || value > high) throw wrong(`meta.json: ${path}`, `${low} to ${high}`, shown(value));
  return value;
}

/** The description of a scene, checked. */
function metaOf(bytes, most) {
  const meta = jsonOf(bytes, "meta.json");
  if (meta?.version !== 2) throw wrong("meta.json: version", "2", `${shown(meta?.version)} ${program()}`);
  const table = (path) => Float32Array.from(listOf(meta, `${path}.codebook`, 256, "number"));
  const { count, shN, model } = meta;
  numberOf(count, "count", 0, Number.MAX_SAFE_INTEGER);
  checkCount("meta.json: count", count, most);
  const higher = shN != null && {
    rows: numberOf(shN.count, "shN.count", 1, MOST_ROWS_OF_SOG),
    degree: numberOf(shN.bands, "shN.bands", 1, 3),
    table: table("shN"),
    files: listOf(meta, "shN.files", 2, "string"),
  };
  const known = [undefined, null, "default", "2dgs", "antialiased"].includes(model);
  return {
    count,
    higher,
    means: { low: listOf(meta, "means.mins", 3, "number"), high: listOf(meta, "means.maxs", 3, "number"), files: listOf(meta, "means.files", 2, "string") },
    scales: { table: table("scales"), files: listOf(meta, "scales.files", 1, "string") },
    turns: { files: listOf(meta, "quats.files", 1, "string") },
    colours: { table: table("sh0"), files: listOf(meta, "sh0.files", 1, "string") },
    antialiased: model === "antialiased",
    note: known ? "" : `meta.json: model ${quoted(typeof model === "string" ? model : "?")} is not known: taken as "default"`,
  };
}

/** An image of at least `least` pixels, or of an unknown number where that is 0: { width, height, pixels }. */
async function imageOf(file, entries, name, least) {
  const most = least ? Math.max(2 * least, 2 ** 16) : 2 ** 20;
  const bytes = await unzipped(file, entries, name, 8 * most);
  name = partNamed(name);
  const head = String.fromCharCode(...bytes.subarray(0, 16));
  if (bytes.length < 25 || !/^RIFF....WEBPVP8L$/s.test(head)) throw wrong(name, "a lossless WebP image", `${quoted(head)} ${program()}`);
  const word = new DataView(bytes.buffer, bytes.byteOffset).getUint32(21, true);
  const [width, height] = [(word & 16383) + 1, ((word >>> 14) & 16383) + 1];
  if (width * height < least || width * height > most) throw wrong(name, `an image of ${least} to ${most} pixels`, `${width}×${height}`);
  return { width, height, pixels: await pixelsOf(bytes, width, height, name) };
}

async function sogFile(file, most) {
  const entries = await zipOf(file);
  const { count, higher, means, scales, turns, colours, antialiased, note } = metaOf(await unzipped(file, entries, "meta.json", MAX_META), most);
  const degree = higher?.degree ?? 0;
  checkMemory("meta.json: count", count, degree, file.size);
  const images = [];
  for (const name of [...means.files, ...scales.files, ...turns.files, ...colours.files]) images.push((await imageOf(file, entries, name, count)).pixels);
  const [low, high, widths, rotations, first] = images;
  const width = restOf(degree);
  let [centroids, labels] = [null, null];
  if (higher) {
    centroids = await imageOf(file, entries, higher.files[0], 0);
    const lines = Math.ceil(higher.rows / SOG_ROWS);
    const found = `${centroids.width}×${centroids.height}`;
    if (centroids.width < SOG_ROWS * width || centroids.height < lines) throw wrong(partNamed(higher.files[0]), `${SOG_ROWS * width}×${lines} pixels at least`, found);
    labels = (await imageOf(file, entries, higher.files[1], count)).pixels;
  }
  const writer = new StillWriter(count, degree, antialiased);
  const { row } = writer;
  for (let i = 0, at = 0; i < count; i++, at += 4) {
    for (let axis = 0; axis < 3; axis++) {
      const m = means.low[axis] + (means.high[axis] - means.low[axis]) * ((low[at + axis] | (high[at + axis] << 8)) / 65535);
      const size = Math.exp(Math.min(Math.abs(m), 100)) - 1;
      row[axis] = m < 0 ? -size : size;
      row[DEVIATIONS + axis] = scales.table[widths[at + axis]];
      row[COLOUR + axis] = colours.table[first[at + axis]];
    }
    row[LOGIT] = LOGITS[first[at + 3]];
    row.set(sogRotation(rotations, at, i), QUATERNION);
    if (higher) {
      const label = labels[at] | (labels[at + 1] << 8);
      if (label >= higher.rows) throw wrong(`${partNamed(higher.files[1])}: label ${i}`, `one of ${higher.rows} rows`, label);
      const from = 4 * (Math.floor(label / SOG_ROWS) * centroids.width + (label % SOG_ROWS) * width);
      for (let k = 0; k < 3 * width; k++) row[HIGHER + k] = higher.table[centroids.pixels[from + 4 * Math.floor(k / 3) + (k % 3)]];
    }
    writer.put(i);
  }
  return { ...writer.finish(), note };
}

/** A quaternion, w first: the three smallest, and which is the largest. */
function sogRotation(pixels, at, i) {
  const largest = pixels[at + 3] - SOG_LARGEST;
  if (largest < 0) throw wrong(`quats: alpha of ${i}`, "252 to 255", pixels[at + 3]);
  const q = [0, 0, 0, 0];
  for (let place = 0, k = 0, squares = 0; place < 4; place++) {
    if (place !== largest) {
      q[place] = (pixels[at + k++] / 255 - 0.5) * Math.SQRT2;
      squares += q[place] * q[place];
    }
    if (k === 3) q[largest] = Math.sqrt(Math.max(0, 1 - squares));
  }
  return q;
}
