// Formats recognised by the start of files, as in engine/src/formats/table.rs; only `.splat` by its name.

/** Formats that are not read here: a text in the file, where it stands, the format's name, and the command that takes it. */
const OTHERS = [
  ["{", 0, "JSON that names other files", "view"],
  ["ftyp", 4, "a video", "run"],
  ["\x1aE\xdf\xa3", 0, "a video", "run"],
  ["YUV4MPEG2", 0, "a video", "run"],
];

/** The packet of a file of at most `most` Gaussians: { buffer, format, degree, least, greatest, note }; of a scene in time its index
 * alone, as container.js has it: { scene }. `axes`: those that the user says it has. */
async function opened(file, most, axes) {
  const head = String.fromCharCode(...new Uint8Array(await file.slice(0, 16).arrayBuffer()));
  if (/^ply[\r\n]/.test(head)) return { format: "PLY", ...(await plyFile(file, most)) };
  if (head.startsWith("\x1f\x8b") || head.startsWith("NGSP")) return { format: "SPZ", ...(await spzFile(file, most, axes)) };
  if (head.startsWith("PK\x03\x04")) return { format: "SOG", ...(await sogFile(file, most)) };
  if (head.startsWith("glTF")) return { format: "glTF", ...(await glbFile(file, most)) };
  if (head.startsWith("ssplat")) return { scene: await readIndex(new BlobFile(file), most) };
  const other = OTHERS.find(([text, at]) => head.startsWith(text, at));
  if (!other && /\.splat$/i.test(file.name)) return { format: "splat", ...(await splatFile(file, most)) };
  const found = other ? `${other[2]} ${program(other[3])}` : head ? `a file that begins with ${quoted(head.slice(0, 8))}` : "an empty file";
  throw wrong("format", "PLY, compressed PLY, SPZ, SOG, glb, splat or ssz", found);
}
