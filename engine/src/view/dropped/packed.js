// Compressed PLY, as engine/src/formats/compressed_ply/mod.rs reads it.

/** Least and greatest values in a chunk, by axis: of positions, of scales, of colours. */
const BOUNDS = ["x y z", "scale_x scale_y scale_z", "r g b"].map((axes) => ["min_", "max_"].flatMap((end) => axes.split(" ").map((axis) => end + axis)));
const PER_CHUNK = 256;
const PACKED_STEPS = byByte((byte) => (byte === 0 ? -4 : byte === 255 ? 4 : 8 * ((byte + 0.5) / 256 - 0.5)));

async function packedFile(file, elements, most, antialiased) {
  const [chunks, vertices, sh] = ["chunk", "vertex", "sh"].map((name) => elements.get(name));
  const [{ count }, rest] = [vertices, sh?.properties.size ?? 0];
  if (chunks.count !== Math.ceil(count / PER_CHUNK)) throw wrong("element chunk", `one for ${PER_CHUNK} of ${count} vertices`, chunks.count);
  checkCount("element vertex", count, most);
  const coloured = chunks.properties.has("min_r");
  const bounds = BOUNDS.slice(0, coloured ? 3 : 2).map((names) => names.map((name) => startOf(chunks, name, "float")));
  const words = ["position", "rotation", "scale", "color"].map((name) => startOf(vertices, `packed_${name}`, "uint"));
  const writer = new StillWriter(count, degreeOf(rest), antialiased);
  const places = Array.from({ length: rest }, (_, k) => startOf(sh, `f_rest_${placeOf(k, rest)}`, "uchar"));
  if (sh && sh.count !== count) throw wrong("element sh", `${count}, as of vertices`, sh.count);
  const { row } = writer;
  const chunk = await viewOf(file, chunks.start, chunks.count * chunks.width);
  await eachRow(file, rest ? [vertices, sh] : [vertices], count, (i, [view, harmonics], k) => {
    const at = Math.floor(i / PER_CHUNK) * chunks.width;
    const between = (group, axis, share) => {
      const least = chunk.getFloat32(at + bounds[group][axis], true);
      return least + (chunk.getFloat32(at + bounds[group][axis + 3], true) - least) * share;
    };
    const word = (n) => view.getUint32(k * vertices.width + words[n], true);
    for (const [group, packed, to] of [[0, word(0), 0], [1, word(2), DEVIATIONS]]) {
      row[to] = between(group, 0, (packed >>> 21) / 2047);
      row[to + 1] = between(group, 1, ((packed >>> 11) & 1023) / 1023);
      row[to + 2] = between(group, 2, (packed & 2047) / 2047);
    }
    const [turn, colour] = [word(1), word(3)];
    const left = turn >>> 30;
    let squares = 0;
    for (let c = 0, shift = 20; c < 4; c++) {
      if (c === left) continue;
      const q = (((turn >>> shift) & 1023) / 1023 - 0.5) * Math.SQRT2;
      row[QUATERNION + c] = q;
      squares += q * q;
      shift -= 10;
    }
    row[QUATERNION + left] = Math.sqrt(Math.max(0, 1 - squares));
    for (let c = 0; c < 3; c++) {
      const share = ((colour >>> (24 - 8 * c)) & 255) / 255;
      row[COLOUR + c] = coefficientOf(coloured ? between(2, c, share) : share);
    }
    row[LOGIT] = LOGITS[colour & 255];
    for (let n = 0; n < rest; n++) row[HIGHER + n] = PACKED_STEPS[harmonics.getUint8(k * sh.width + places[n])];
    writer.put(i);
  });
  return writer.finish();
}
