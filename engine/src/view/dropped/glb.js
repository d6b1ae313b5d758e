// glTF with Gaussians in one binary file (`.glb`): one node with one primitive of binary32 numbers, as engine/src/formats/gltf writes it. Others are named.

const GAUSSIANS = "KHR_gaussian_splatting";
/** Extensions in use that are read here, or checked by what they change, or without effect on Gaussians. */
const WITHOUT_EFFECT = /^(KHR_gaussian_splatting(_compression_spz_2)?$|KHR_mesh_quantization$|(KHR|EXT)_materials_|KHR_texture_|KHR_lights_|KHR_xmp)/;
const [MAX_JSON, MAX_CHUNKS] = [2 ** 24, 64];
/** A binary32 number in an accessor, and the numbers of its shapes. */
const FLOAT = 5126;
const SHAPES = { SCALAR: 1, VEC3: 3, VEC4: 4 };
/** From this on a node's translation is the scene's offset, to which centres are relative. */
const FAR = 4096;

/** An error about what the program reads and the page does not. */
const unread = (part, expected, found) => wrong(part, expected, `${shown(found)} ${program()}`);

/** The document, and where the bytes of its buffer start and end. */
async function documentOf(file) {
  if (file.size < 12) throw wrong("header", "12 bytes", file.size);
  const header = await viewOf(file, 0, 12);
  if (header.getUint32(4, true) !== 2) throw wrong("header: version", "2", header.getUint32(4, true));
  if (header.getUint32(8, true) !== file.size) throw wrong("header: length", `${file.size} bytes`, header.getUint32(8, true));
  const chunks = new Map();
  for (let [at, count] = [12, 0]; at < file.size; count++) {
    if (count === MAX_CHUNKS) throw wrong("chunks", `at most ${MAX_CHUNKS}`, "more");
    const head = await viewOf(file, at, Math.min(8, file.size - at));
    const length = head.byteLength === 8 ? head.getUint32(0, true) : Infinity;
    if (at + 8 + length > file.size) throw wrong("chunk", "a whole one", `${file.size - at} bytes`);
    const kind = head.getUint32(4, true);
    if (!chunks.has(kind)) chunks.set(kind, [at + 8, at + 8 + length]);
    at += 8 + length;
  }
  const [from, to] = chunks.get(0x4e4f534a) ?? [0, 0];
  if (to - from > MAX_JSON || to === from) throw wrong("JSON", `1 to ${MAX_JSON} bytes`, to - from);
  const text = new Uint8Array((await viewOf(file, from, to - from)).buffer);
  return { document: jsonOf(text, "JSON"), buffer: chunks.get(0x004e4942) ?? [0, 0] };
}

/** One of a list's objects. */
function one(list, index, part) {
  const found = Array.isArray(list) && Number.isInteger(index) ? list[index] : null;
  if (typeof found !== "object" || found === null) throw unread(part, "one in the file", index ?? null);
  return found;
}

/** The only primitive of the document's scene, and its translation in scene space. */
function primitiveOf(document) {
  if (document?.asset?.version !== "2.0") throw unread("asset: version", "2.0", document?.asset?.version);
  const other = [document.extensionsRequired ?? []].flat().find((name) => name !== GAUSSIANS);
  if (other !== undefined) throw unread("extensionsRequired", GAUSSIANS, other);
  const { nodes } = one(document.scenes, document.scene ?? 0, "scene");
  if (!Array.isArray(nodes) || nodes.length !== 1) throw unread("scene: nodes", "one", nodes);
  const node = one(document.nodes, nodes[0], "node");
  const moved = ["rotation", "scale", "matrix", "children"].find((key) => node[key] !== undefined);
  if (moved) throw unread(`node: ${moved}`, "none", node[moved]);
  const { primitives } = one(document.meshes, node.mesh, "mesh");
  const primitive = one(primitives, 0, "primitive");
  const extension = primitive.extensions?.[GAUSSIANS];
  const isWhole = typeof extension === "object" && extension !== null && primitive.mode === 0 && primitive.indices == null;
  if (primitives.length !== 1 || !isWhole) throw unread("mesh: primitives", `one of points with ${GAUSSIANS}, without indices`, primitives);
  for (const [key, usual] of [["colorSpace", "srgb_rec709_display"], ["kernel", "ellipse"], ["projection", "perspective"], ["extensions", undefined]]) {
    if (extension[key] !== undefined && extension[key] !== usual) throw unread(`${GAUSSIANS}: ${key}`, usual ?? "none", extension[key]);
  }
  const translation = node.translation ?? [0, 0, 0];
  const isPlace = Array.isArray(translation) && translation.length === 3 && translation.every(Number.isFinite);
  if (!isPlace) throw wrong("node: translation", "three numbers", shown(translation));
  const [x, y, z] = translation;
  const far = [x, y, z].some((part) => Math.abs(part) >= FAR);
  return { primitive, moved: [0 - x, 0 - y, z].map((part) => part - (far ? roundedAway(part) : 0)) };
}

/** The nearest whole number, halves away from zero. */
const roundedAway = (x) => Math.sign(x) * Math.floor(Math.abs(x) + 0.5);

/** Where the numbers of an attribute are in the file, and how wide they are for each Gaussian. */
function partOf(document, [low, high], primitive, name, shape, count) {
  const accessor = one(document.accessors, primitive.attributes[name], `attribute ${name}`);
  const fits = accessor.componentType === FLOAT && accessor.type === shape && !accessor.sparse;
  if (!fits) throw unread(`attribute ${name}`, `binary32 numbers of the type ${shape}`, accessor);
  const view = one(document.bufferViews, accessor.bufferView, `attribute ${name}`);
  const width = 4 * SHAPES[shape];
  const tight = view.buffer === 0 && (view.byteStride ?? width) === width && !view.extensions && !document.buffers?.[0]?.uri;
  if (!tight) throw unread(`attribute ${name}`, "numbers one after another in the file", view);
  if (accessor.count !== count) throw wrong(`attribute ${name}`, `${count} as of POSITION`, shown(accessor.count));
  const places = [view.byteOffset ?? 0, accessor.byteOffset ?? 0, view.byteLength];
  const inside = places.every((place) => Number.isSafeInteger(place) && place >= 0) && places[1] + count * width <= places[2] && low + places[0] + places[2] <= high;
  if (!inside) throw wrong(`attribute ${name}`, `${count * width} bytes in the file's buffer`, places.join(", "));
  return { start: low + places[0] + places[1], width };
}

async function glbFile(file, most) {
  const { document, buffer } = await documentOf(file);
  const { primitive, moved } = primitiveOf(document);
  const { attributes } = primitive;
  if (typeof attributes !== "object" || attributes === null) throw wrong("primitive: attributes", "those of Gaussians", shown(attributes));
  const { count } = one(document.accessors, attributes.POSITION, "attribute POSITION");
  if (!Number.isSafeInteger(count) || count < 0) throw wrong("attribute POSITION", "an accessor with a count", shown(count));
  checkCount("attribute POSITION", count, most);
  const own = (name) => `${GAUSSIANS}:${name}`;
  const coefficient = (degree, k) => own(`SH_DEGREE_${degree}_COEF_${k}`);
  const degree = [3, 2, 1].find((degree) => attributes[coefficient(degree, 0)] !== undefined) ?? 0;
  checkMemory("attribute POSITION", count, degree, file.size);
  const higher = [1, 2, 3].slice(0, degree).flatMap((degree) => Array.from({ length: 2 * degree + 1 }, (_, k) => coefficient(degree, k)));
  const shapes = [["POSITION", "VEC3"], [own("ROTATION"), "VEC4"], [own("SCALE"), "VEC3"], [own("OPACITY"), "SCALAR"], ...[coefficient(0, 0), ...higher].map((name) => [name, "VEC3"])];
  const parts = shapes.map(([name, shape]) => partOf(document, buffer, primitive, name, shape, count));
  // A half turn about z: glTF's x is left, its y up.
  const signs = ODD.map((letters) => [...letters].reduce((sign, letter) => (letter === "z" ? sign : -sign), 1));
  const writer = new StillWriter(count, degree, false);
  const { row } = writer;
  await eachRow(file, parts, count, (i, views, k) => {
    const number = (part, at) => views[part].getFloat32(k * parts[part].width + 4 * at, true);
    for (let axis = 0; axis < 3; axis++) {
      row[axis] = (axis < 2 ? -1 : 1) * number(0, axis) + moved[axis];
      const deviation = number(2, axis);
      if (deviation < 0) throw wrong("SCALE", "standard deviations of 0 or more", deviation);
      row[DEVIATIONS + axis] = Math.log(Math.max(deviation, 1e-12));
      row[COLOUR + axis] = number(4, axis);
    }
    const [x, y, z, w] = [0, 1, 2, 3].map((at) => number(1, at));
    row.set([-z, -y, x, w], QUATERNION);
    row[LOGIT] = logitOf(clamp(number(3, 0), 1e-12, 1 - 1e-12));
    for (let n = 0; n < higher.length; n++) for (let channel = 0; channel < 3; channel++) row[HIGHER + 3 * n + channel] = signs[n] * number(5 + n, channel);
    writer.put(i);
  });
  return { ...writer.finish(), note: notesOf(document, primitive) };
}

/** What of the file has no effect here, in one line. */
function notesOf({ animations, skins, extensionsUsed }, { targets }) {
  const parts = Object.entries({ animations, skins, "morph targets": targets }).filter(([, list]) => list?.length);
  const unused = [extensionsUsed ?? []].flat().filter((name) => typeof name !== "string" || !WITHOUT_EFFECT.test(name));
  const notes = [];
  if (parts.length) notes.push(`the scene is read without its ${parts.map(([name]) => name).join(" and ")}`);
  if (unused.length) notes.push(`extensions that are not read: ${shown(unused)}`);
  return notes.join("; ");
}
