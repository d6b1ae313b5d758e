// The readers of the page, as in its worker. Each has seeds, a function that reads bytes and checks the result, and the errors that are refusals.

import { readFileSync } from "node:fs";
import { deflateRawSync, gzipSync } from "node:zlib";
import { columnOf } from "../../outside/column.mjs";

const VIEW = "engine/src/view";
const PLAYER = "engine/player/src";
/** The limit on Gaussians of a file that is passed to the page. */
const MOST = 1 << 20;

/** The definitions of the worker's scripts, joined as in page.rs. */
function scripts() {
  const list = /const WORKER_FILES[^=]*= \[(.*?)\];/s.exec(readFileSync(`${VIEW}/page.rs`, "utf8"))[1];
  // Images are decoded by browsers alone: here a function of the same name makes pixels.
  const files = [...list.matchAll(/(player|include_str)!\("(.*?)"\)/g)].filter(([, , name]) => !["worker.js", "dropped/pixels.js"].includes(name));
  const lines = files.flatMap(([, kind, name]) => readFileSync(`${kind === "player" ? PLAYER : VIEW}/${name}`, "utf8").split("\n"));
  const text = lines.filter((line) => !line.startsWith("import ")).map((line) => line.replace(/^export /, "")).join("\n");
  return new Function("pixelsOf", `"use strict";\n${text}\nreturn { opened, unzstd, Packet, packetIn, decode, packetOf, HEADER, RECORD, crcOf };`)(pixelsOf);
}

/** Pixels of an image of this size; the alphas of rotations, and labels, are those that occur. */
async function pixelsOf(bytes, width, height, name) {
  const special = { "quats_0.webp": (i) => 252 + (i & 3), "shN_1.webp": (i) => (i & 3 ? 0 : (i >> 2) & 15) }[name];
  return Uint8Array.from({ length: 4 * width * height }, (_, i) => special?.(i) ?? (i * 37) & 255);
}

/** A file in memory, with the interface that the page's readers use. */
class Bytes {
  constructor(bytes, name) {
    [this.bytes, this.name, this.size] = [bytes, name, bytes.length];
  }

  slice(from, to) {
    const part = this.bytes.subarray(from, Math.min(to, this.size));
    return { arrayBuffer: async () => new Uint8Array(part).buffer };
  }

  stream() {
    return new ReadableStream({
      start: (controller) => {
        if (this.size) controller.enqueue(new Uint8Array(this.bytes));
        controller.close();
      },
    });
  }
}

const check = (holds, what) => {
  if (!holds) throw new TypeError(`finding: ${what}`);
};

const floats = (count, value) => Buffer.from(Float32Array.from({ length: count }, (_, i) => value(i)).buffer);
const value = (i) => ((i * 7919) % 1009) / 504.5 - 1;

/** A PLY file of elements: [name, count, [[type, property]…], bytes]. */
function ply(elements) {
  const lines = elements.flatMap(([name, count, properties]) => [`element ${name} ${count}`, ...properties.map((property) => `property ${property.join(" ")}`)]);
  return Buffer.concat([Buffer.from(`ply\nformat binary_little_endian 1.0\n${lines.join("\n")}\nend_header\n`), ...elements.map((element) => element[3])]);
}

const PLAIN = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"];
const all = (type, names) => names.map((name) => [type, name]);
const numbered = (count) => Array.from({ length: count }, (_, i) => `f_rest_${i}`);

function plain(count, rest) {
  const names = [...PLAIN, ...numbered(rest)];
  return ply([["vertex", count, all("float", names), floats(count * names.length, value)]]);
}

function packed(count, rest) {
  const ends = ["min_x", "min_y", "min_z", "max_x", "max_y", "max_z", "min_scale_x", "min_scale_y", "min_scale_z", "max_scale_x", "max_scale_y", "max_scale_z"];
  const words = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];
  const bytes = (length) => Buffer.from(Uint8Array.from({ length }, (_, i) => (i * 101) & 255));
  const chunks = Math.ceil(count / 256);
  const parts = [
    ["chunk", chunks, all("float", ends), floats(12 * chunks, value)],
    ["vertex", count, all("uint", words), bytes(16 * count)],
  ];
  return ply(rest ? [...parts, ["sh", count, all("uchar", numbered(rest)), bytes(rest * count)]] : parts);
}

function splat(count) {
  const records = Buffer.from(Uint8Array.from({ length: 32 * count }, (_, i) => (i * 37) & 255));
  for (let i = 0; i < count; i++) for (let k = 0; k < 6; k++) records.writeFloatLE(Math.abs(value(6 * i + k)), 32 * i + 4 * k);
  return records;
}

/** The content of an SPZ file's gzip stream. */
function spz(version, count, degree) {
  const head = Buffer.alloc(16);
  head.write("NGSP");
  [version, count].forEach((word, k) => head.writeUInt32LE(word, 4 + 4 * k));
  head.set([degree, 12, 0, 0], 12);
  const each = 16 + version + 1 + 3 * ((degree + 1) ** 2 - 1);
  return Buffer.concat([head, Buffer.from(Uint8Array.from({ length: count * each }, (_, i) => (i * 73) & 255))]);
}

/** A zstd frame of one uncompressed block, of at most 255 bytes. */
const stored = (bytes) => Buffer.concat([Buffer.from([0x28, 0xb5, 0x2f, 0xfd, 0x20, bytes.length, 1 | (bytes.length << 3), bytes.length >> 5, 0]), bytes]);

/** An SPZ file of version 4. */
function spz4(count, degree) {
  const old = spz(3, count, degree);
  let at = 16;
  const frames = [9, 1, 3, 3, 4, 3 * ((degree + 1) ** 2 - 1)].filter(Boolean).map((each) => stored(old.subarray(at, (at += each * count))));
  const header = Buffer.alloc(32);
  old.copy(header, 0, 0, 16);
  [4, header[8]].forEach((word, k) => header.writeUInt32LE(word, 4 + 4 * k));
  header[15] = frames.length;
  header.writeUInt32LE(32, 16);
  const table = Buffer.concat(frames.map((frame) => {
    const entry = Buffer.alloc(16);
    [frame.length, frame.length - 9].forEach((length, k) => entry.writeUInt32LE(length, 8 * k));
    return entry;
  }));
  return Buffer.concat([header, table, ...frames]);
}

/** A zip file of files, every second one compressed. */
function zip(files) {
  const { crcOf } = (zip.scripts ??= scripts());
  let [at, bodies, entries] = [0, [], []];
  files.forEach(([name, bytes], i) => {
    const method = i % 2 ? 8 : 0;
    const stored = method ? deflateRawSync(bytes) : bytes;
    const [header, entry] = [Buffer.alloc(30), Buffer.alloc(46)];
    [[header, 0x04034b50, 8, 14], [entry, 0x02014b50, 10, 16]].forEach(([head, magic, place, sums]) => {
      head.writeUInt32LE(magic);
      head.writeUInt16LE(method, place);
      [crcOf(bytes), stored.length, bytes.length].forEach((word, k) => head.writeUInt32LE(word, sums + 4 * k));
      head.writeUInt16LE(name.length, sums + 12);
    });
    entry.writeUInt32LE(at, 42);
    bodies.push(header, Buffer.from(name), stored);
    entries.push(entry, Buffer.from(name));
    at += header.length + name.length + stored.length;
  });
  const directory = Buffer.concat(entries);
  const end = Buffer.alloc(22);
  end.writeUInt32LE(0x06054b50);
  [8, 10].forEach((place) => end.writeUInt16LE(files.length, place));
  [directory.length, at].forEach((word, k) => end.writeUInt32LE(word, 12 + 4 * k));
  return Buffer.concat([...bodies, directory, end]);
}

/** The head of a lossless WebP image, which is all that is read here. */
function webp(width, height) {
  const bytes = Buffer.alloc(25);
  bytes.write("RIFF....WEBPVP8L", "latin1");
  bytes[20] = 0x2f;
  bytes.writeUInt32LE((width - 1) | ((height - 1) << 14), 21);
  return bytes;
}

/** The meta.json of a SOG scene of 16 Gaussians. */
function meta(degree) {
  const codebook = Array.from({ length: 256 }, (_, i) => i % 5);
  const files = (name, count = 1) => Array.from({ length: count }, (_, k) => `${name}_${k}.webp`);
  const about = {
    version: 2,
    count: 16,
    means: { mins: [-1, -2, -3], maxs: [1, 2, 3], files: files("means", 2) },
    scales: { codebook, files: files("scales") },
    quats: { files: files("quats") },
    sh0: { codebook, files: files("sh0") },
  };
  if (degree) about.shN = { count: 70, bands: degree, codebook, files: files("shN", 2) };
  return Buffer.from(JSON.stringify(about));
}

/** A SOG file with this meta.json. */
function sog(text) {
  const names = ["means_0", "means_1", "scales_0", "quats_0", "sh0_0", "shN_1"];
  return zip([["meta.json", text], ...names.map((name) => [`${name}.webp`, webp(4, 4)]), ["shN_0.webp", webp(960, 2)]]);
}

/** A binary glTF file of `count` Gaussians. */
function glb(count, degree) {
  const own = "KHR_gaussian_splatting:";
  const coefficients = [0, 1, 2, 3].slice(0, degree + 1).flatMap((degree) => Array.from({ length: 2 * degree + 1 }, (_, k) => [`${own}SH_DEGREE_${degree}_COEF_${k}`, "VEC3"]));
  const shapes = [["POSITION", "VEC3"], [`${own}ROTATION`, "VEC4"], [`${own}SCALE`, "VEC3"], [`${own}OPACITY`, "SCALAR"], ...coefficients];
  const lengths = shapes.map(([, shape]) => 4 * count * { SCALAR: 1, VEC3: 3, VEC4: 4 }[shape]);
  const starts = lengths.map((_, k) => lengths.slice(0, k).reduce((sum, length) => sum + length, 0));
  const document = {
    asset: { version: "2.0" },
    extensionsUsed: ["KHR_gaussian_splatting"],
    scene: 0,
    scenes: [{ nodes: [0] }],
    nodes: [{ mesh: 0, translation: [1, 2, 5000.25] }],
    meshes: [{ primitives: [{ mode: 0, attributes: Object.fromEntries(shapes.map(([name], k) => [name, k])), extensions: { KHR_gaussian_splatting: { kernel: "ellipse" } } }] }],
    accessors: shapes.map(([, type], k) => ({ bufferView: k, componentType: 5126, type, count })),
    bufferViews: lengths.map((byteLength, k) => ({ buffer: 0, byteOffset: starts[k], byteLength })),
    buffers: [{ byteLength: starts.at(-1) + lengths.at(-1) }],
  };
  const text = Buffer.from(JSON.stringify(document).padEnd(Math.ceil(JSON.stringify(document).length / 4) * 4));
  const numbers = floats((starts.at(-1) + lengths.at(-1)) / 4, (i) => Math.abs(value(i)));
  const chunk = (kind, bytes) => {
    const head = Buffer.alloc(8);
    head.writeUInt32LE(bytes.length);
    head.write(kind, 4, "latin1");
    return Buffer.concat([head, bytes]);
  };
  const chunks = Buffer.concat([chunk("JSON", text), chunk("BIN\0", numbers)]);
  const head = Buffer.alloc(12);
  head.write("glTF");
  head.writeUInt32LE(2, 4);
  head.writeUInt32LE(12 + chunks.length, 8);
  return Buffer.concat([head, chunks]);
}

/** Contents of three kinds, and their frames by zstd 1.5.4: `-19`, `-1`, `-19`. */
const CONTENT = 1500;
function content(kind) {
  let [state, last] = [1, 100];
  const next = () => (state = (Math.imul(state, 1664525) + 1013904223) >>> 0) >>> 24;
  return Uint8Array.from({ length: CONTENT }, (_, i) => [(last = (last + (next() & 3) - 1) & 255), [7, 7, 7, 40][next() & 3], i % 97 < 60 ? i % 97 : i >> 3][kind]);
}
const FRAMES = [
  "KLUv/WTcBLUnALQ9Y2NiY2JhYmRlZWVnaGhqbGtrbW9wcnFzcnNydHR2d3l4enx9fn9/gYKDg4SFhYWHhoaIiYiKi4qJiYiJi42Mi42NjY+RkJGSk5OVlJWXl5aVlpeZmJqcnZyenp+hoqKkpKOko6OlpKOlpaepqaqpqqytra+wsbO1t7a1tbW3ubi4ubm4ubq8vLy+v77AwcLDwsPDw8TFxsjHx8jKy83Ozc3MzM3P0dPV1tbY19nb3d7d397f4eLk5eXk5uXm5ubn6evq6ejq6evs7O7t7u7w8fHw7/Dv8fDx8PLy8vT19vX19PP08/Lx8fLy9PX09vf49/n6/P4AAAABAQMDBAYFBwcGBQYHBggICQgHBgYFBAQDAgEBAgYIBwkKDA4QEBAPERMSExMUFRQVFxYXGBobGxoaHR8hIiIjIiMlJiUlJCMkJScmKCcoKiwtLi0uLzAxMzMzMjQzMjM1NDY3Nzg6PDs8PD0+PT9BQEJEQ0NFRkdJSEdJS0xMTk1OTk5PTk9PUVFSVFRVV1ZUU1NTVFZVWFpcW11fYF9gYWNkY2JiYmNlZGRmZmhnZ2hqampsbWxsbWtsbW9vbnBvcXFycnN0dXd3eHp5eHl4d3h4eXp/g4WGiIiIh4iMjo6NjpCPkZGRkJCSkpGSkpiYmJqbnJydnZ2mpaaoqKepq6qsrrCys7W0tLa4uLq6u7q5urm7vb7AwcHDwcC/vr28u769vb6+vb++vb/Av8HDxMPExsfIycrJycnKy8zNzs7Q0dLX4OLk4+Xk5efp6uvt7O3u7+/u7fDw8fP19/j4+fr5+vv9/v38/f8AAQICAQMFBAUFBwkJCwwLDQ8PERESERITFRQWGBkZGh4gIiMkJigoJygpKiwuMC8wLy8uLi0vLjAwMTExNTU0MzM5ODk4Nzg5Ojs7Ojk9P0A/PkVLUFJRU1NVVVVXV1hZW1xeYGJkY2Vma2ppaWloaHBvbm5vcHR2d3d5e318fH1/fn9+gIKDhYSDgoaHhomJiYuLioyMjpGQj5GTkpOUk5KVlZSTlZeZmpmam5yen5+foaKhoaOio6OmpqipqKqrrayrra+xsLKysbGzsrKztLS1tre2trW2u72+v7/AwL+/wsTDxcbGxcfJz87S09PU1tjZ2tzd3t7d39/f4ODh4eDk5Obm6Onr6urq8/b3+fv6/Pz+/wIEBQYFBwsNDQwMDRMXGRgZGRgaGRgZGhweHRwdHRwdHiAhIiQjKCopKikrKiwtLS0xMC8vLzEzMzQ2NzY4Ojo8PkBCQkJGSEpMTk9RUFFTVFlZWVpcXV5gX15gYmFjYmNigJeoESFziBAakhFJkhQyHDDIoZGo+IDbAedHlb/r38w/AKMjrBlbI/h3oE5rXIXH6v8wAMXWQB0wJywMwl2FzgfFiSQjmMilSsPXzYPyG3Qygiai/GYEd1Ldpy3kepmAEGFLWCK3DDyDiEoXK/UXFCCgSifAiJf/3wFEf6iVJW6HRfc4D0dPGNH64PR5vqWnOoHyKJdTlwsNpCzCB9xnwdcFNEs1DXG61TngvLVup35t10e5HzWfD/jFWwgbdC4ahs1pWK6hhGFjyeYwZqINIQFBtEGFBEGBWFsEPizYnXCH6BeQjGUYfXBe6RdxFD/tNSevlBJo8HAu+VUT7oAzlnEMQFEGhE8cspJUpCBUk/1cNUpMY2BZDR5K8b5b",
  "KLUv/WTcBG0JAGKEAwTgD/b50LN10xfl32lCgNOooGvYDZCCsbPNARFAUI0lbaEwjQEz8KWpJXvofvdHsPJB1AEIqxMcKpMHs/d9EPa2q2JlImq5tJ77aOoWnDDGmAikywSiM5zKl14TxZzdtMTZQpMpvcJfoy2gK2XxFuQ+9HNqCyVrVhamc/clh8zE+oebCqs5ABMPhNNBdIcnnsu/8348qCsm/10GJEKA/8Qygw9nFtrGXObKK2dICwNqr2QZCJ00xVPQ6nnoZv7d8m2OOMjYkdS8ZRG98442P1wUFvQfEY1SSZu9QluxqI1cxZwNJ+A1jisBBl43+eOFuj1bmDDQbn6sp2ElVcuvBUvmpU93Ez6qtiVys88obwd5iotqjglu/VrA1Xpr60QGftuL7XsftgFeSQHVikRm",
  "KLUv/WTcBC0HALQJAAECAwQFBgcICQoLDA0ODxAREhMUFRYXGBkaGxwdHh8gISIjJCUmJygpKissLS4vMDEyMzQ1Njc4OTo7BwgJCgsMExMTFBUWFxgYHx8gISIjJCQkKywtLi8wODk6OzxERUZHSFBRUlNUXF1eX2BoaWprbG10dHR1dnd4eXmAgIGCg4SFhYWMjY6PkJGZmpucnaWmp6ipsbKztLVWqHHY5Pp/BpC9GXIoHEc6/v+fiT6GJqyCTgEY7hIMLTXv8eLah7hHBHGIcp/AYUOLnQJsdqhqOi69yYlSUlPIPHIh1xIboKo9G5mH",
].map((text) => Buffer.from(text, "base64"));

/** A chunk of a page's container: records that are fresh, all differences small. */
function chunk(count) {
  return Buffer.concat(
    Array.from({ length: 31 }, (_, column) => {
      const empty = column === 1 || column === 2 || column > 26;
      return columnOf(Array.from({ length: empty ? 0 : count }, (_, i) => (column < 7 ? 0 : (i * 5 + column) & 14)));
    }),
  );
}

/** A container of one chunk each: header, chunks, index and trailer, without digests, which the page does not compare. */
function container(chunks, backs) {
  const header = Buffer.alloc(16);
  header.write("ssplat\x1a\n", "latin1");
  header.writeUInt32LE(1, 8);
  const index = Buffer.alloc(44 + 96 * chunks.length);
  index.writeDoubleLE(24);
  [144, 256, 144, 256, 0, 0, 144, 256, chunks.length].forEach((word, k) => index.writeUInt32LE(word, 8 + 4 * k));
  let at = header.length;
  chunks.forEach((bytes, i) => {
    const entry = 44 + 96 * i;
    [at, bytes.length].forEach((word, k) => index.writeUInt32LE(word, entry + 8 * k));
    [i / 24, (i + 1) / 24].forEach((time, k) => index.writeDoubleLE(time, entry + 16 + 8 * k));
    [[32, i], [48, 40], [56, backs[i]]].forEach(([field, word]) => index.writeUInt32LE(word, entry + field));
    at += bytes.length;
  });
  const trailer = Buffer.alloc(48);
  [at, index.length].forEach((word, k) => trailer.writeUInt32LE(word, 8 * k));
  return Buffer.concat([header, ...chunks, index, trailer]);
}

const PLACE = { index: 3n, start: 0, end: 1 };
const whole = (bytes) => new Uint8Array(bytes).buffer;

/** All readers by name. */
export function readers() {
  const { opened, unzstd, Packet, packetIn, decode, packetOf, HEADER, RECORD } = scripts();
  FRAMES.forEach((frame, kind) => check(Buffer.compare(unzstd(frame, CONTENT), content(kind)) === 0, `the content of frame ${kind}`));
  /** One error of one line that states what was expected and found. */
  const own = (error) => error.constructor === Error && /^[^\n]+: expected [^\n]*, found [^\n]*$/.test(error.message);
  const file = (name, seeds, wrapped = (bytes) => bytes) => ({
    seeds,
    refusal: own,
    async read(bytes, chance) {
      const { buffer, degree, least, greatest } = await opened(new Bytes(wrapped(bytes, chance), name), MOST);
      const packet = packetIn(buffer);
      check(packet.count >= 0 && packet.count <= MOST && degree <= 3, `${packet.count} of degree ${degree}`);
      check([...least, ...greatest].every(Number.isFinite), `a box of ${least} and ${greatest}`);
      check(least.every((low, axis) => low <= greatest[axis]), `a box of ${least} and ${greatest}`);
    },
  });
  const zipped = (bytes, chance) => {
    // Sometimes the stream itself is changed.
    const stream = gzipSync(bytes, { level: 1 });
    if (chance(8) === 0) stream[chance(stream.length)] ^= 1 << chance(8);
    return stream;
  };
  const first = decode(chunk(40), null);
  return {
    ply: file("a.ply", [plain(3, 0), plain(2, 9), plain(2, 24), plain(2, 45)]),
    packed: file("a.ply", [packed(3, 0), packed(300, 0), packed(2, 9), packed(2, 45)]),
    splat: file("a.splat", [splat(1), splat(20)]),
    spz: file("a.spz", [spz(2, 3, 0), spz(3, 3, 0), spz(3, 2, 1), spz(2, 2, 3), spz(3, 2, 4)], zipped),
    spz4: file("a.spz", [spz4(1, 0), spz4(3, 1), spz4(2, 3)]),
    // Only the index: chunks have a reader of their own.
    ssz: {
      seeds: [container([chunk(1)], [0]), container([chunk(40), chunk(40), chunk(40)], [0, 1, 0])],
      refusal: own,
      async read(bytes) {
        const { scene } = await opened(new Bytes(bytes, "a.ssz"), MOST);
        const { about, chunks } = scene;
        check(chunks.length === about.intervals.length && chunks[0].back === 0, "an interval for each chunk, the first of which needs none");
        check(chunks.every(({ at, bytes: length }) => at >= 16 && at + length <= bytes.length - 48), "chunks inside of the file");
        check(about.intervals.every(({ start, end, gaussians }) => start <= end && gaussians <= MOST), "intervals in order");
      },
    },
    zstd: {
      seeds: FRAMES,
      refusal: (error) => error.constructor === Error && /^damaged: [^\n]+$/.test(error.message),
      async read(bytes) {
        check(unzstd(bytes, CONTENT).length === CONTENT, "a content of another length");
      },
    },
    sog: file("a.sog", [meta(0), meta(1), meta(3)], sog),
    zip: file("a.sog", [sog(meta(0)), sog(meta(3))]),
    glb: file("a.glb", [glb(1, 0), glb(3, 1), glb(2, 3)]),
    others: file("a.bin", [plain(1, 0), ...[spz(2, 1, 0)].map((bytes) => gzipSync(bytes))]),
    // With the count that an index has, and as a page's text, without one.
    chunk: {
      seeds: [chunk(40)],
      refusal: own,
      async read(bytes, chance) {
        const records = decode(bytes, chance(2) ? first : null, { count: chance(2) ? 40 : null });
        new Packet(packetOf(records, PLACE));
      },
    },
    // Packets come from the program itself: any quick error is accepted, and no packet may be accepted in part.
    packet: {
      seeds: [],
      refusal: (error) => error.constructor === Error && /interval/.test(error.message),
      async read(bytes) {
        const packet = new Packet(whole(bytes));
        check(packet.size === HEADER + packet.count * (RECORD + 2) + packet.rates.length, `${packet.count} records in ${packet.size} bytes`);
        for (let i = 0; i < packet.count; i++) {
          check(packet.identity(i) >= 0n && packet.handover(i) <= 3 && packet.reference(i) <= 1, `record ${i}`);
          packet.gamma(i).concat(packet.deviation(i), [...packet.colour(i)]);
        }
      },
    },
  };
}

/** Seeds that take some time to make. */
export async function prepared(name) {
  const all = readers();
  if (name === "packet") {
    const { decode, packetOf } = scripts();
    for (const count of [1, 5]) all.packet.seeds.push(Buffer.from(packetOf(decode(chunk(count), null), PLACE)));
  }
  return all[name];
}

