// The 32-byte records of web viewers, as engine/src/formats/splat/mod.rs reads them.

const SPLAT = 32;
const SPLAT_COLOURS = byByte((byte) => coefficientOf(byte / 255));

async function splatFile(file, most) {
  const count = file.size / SPLAT;
  if (file.size % SPLAT) throw wrong("file", `records of ${SPLAT} bytes`, `${file.size} bytes`);
  checkCount("records", count, most);
  const writer = new StillWriter(count, 0, false);
  const { row } = writer;
  await eachRow(file, [{ start: 0, width: SPLAT }], count, (i, [view], k) => {
    const at = k * SPLAT;
    for (let axis = 0; axis < 3; axis++) {
      row[axis] = view.getFloat32(at + 4 * axis, true);
      const deviation = view.getFloat32(at + 12 + 4 * axis, true);
      if (deviation < 0) throw wrong(`record ${i}`, "standard deviations of 0 or more", deviation);
      row[DEVIATIONS + axis] = Math.log(Math.max(deviation, 1e-12));
      row[COLOUR + axis] = SPLAT_COLOURS[view.getUint8(at + 24 + axis)];
    }
    row[LOGIT] = LOGITS[view.getUint8(at + 27)];
    for (let c = 0; c < 4; c++) row[QUATERNION + c] = (view.getUint8(at + 28 + c) - 128) / 128;
    writer.put(i);
  });
  return writer.finish();
}
