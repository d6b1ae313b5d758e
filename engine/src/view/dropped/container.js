// Containers, scenes in time: their index alone; the page asks for chunks as it shows them. docs/container.md has every byte.

/** Bytes of a header, of a trailer, of an index without intervals, and of an interval in it. */
const OF_HEADER = 16;
const OF_TRAILER = 48;
const OF_INDEX = 44;
const OF_ENTRY = 96;

/** The description of a container's scene, as the server has it, and where its chunks are. Digests are not compared: `streamsplat inspect` does that. */
async function containerFile(file, most) {
  const head = await viewOf(file, 0, OF_HEADER);
  const version = head.getUint32(8, true);
  if (head.getUint32(4) !== 0x61741a0a) throw wrong("header", "the mark of a container", "another one");
  if (version !== 3 && version !== 4) throw wrong("version", `3 or 4 ${program()}`, version);
  if (file.size < OF_HEADER + OF_INDEX + OF_TRAILER) throw wrong("file", "an index and a trailer", `${file.size} bytes`);
  const trailer = await viewOf(file, file.size - OF_TRAILER, OF_TRAILER);
  const [place, length] = [0, 8].map((at) => Number(trailer.getBigUint64(at, true)));
  if (place + length !== file.size - OF_TRAILER || length < OF_INDEX) throw wrong("trailer", "the place of an index", `${length} bytes at ${place}`);
  const index = await viewOf(file, place, length);
  const sizes = [8, 16, 24, 32].map((at) => [index.getUint32(at, true), index.getUint32(at + 4, true)]);
  if (sizes.some((size, which) => which !== 2 && !(size[0] && size[1]))) throw wrong("index", "frames with a size", "none");
  const count = index.getUint32(40, true);
  if (!count || count * OF_ENTRY > length - OF_INDEX) throw wrong("index", "as many intervals as it has room for", count);
  const [intervals, chunks] = [[], []];
  let next = OF_HEADER;
  for (let i = 0; i < count; i++) {
    const entry = OF_INDEX + i * OF_ENTRY;
    const [at, bytes, keyFrame] = [0, 8, 32].map((field) => Number(index.getBigUint64(entry + field, true)));
    const [start, end] = [16, 24].map((field) => index.getFloat64(entry + field, true));
    const [gaussians, back] = [48, 56].map((field) => index.getUint32(entry + field, true));
    if (at !== next || at + bytes > place) throw wrong(`interval ${i}`, `a chunk from byte ${next} on`, `${bytes} bytes at ${at}`);
    if (!(start <= end && start >= (intervals[i - 1]?.end ?? -Infinity))) throw wrong(`interval ${i}`, "times that ascend", `${start} to ${end}`);
    if (back > Math.min(i, 7)) throw wrong(`interval ${i}`, "an independent one among the seven before", `one ${back} before`);
    checkCount(`interval ${i}`, gaussians, most);
    next = at + bytes;
    intervals.push({ start, end, gaussians });
    chunks.push({ at, bytes, keyFrame, alone: back === 0 });
  }
  const [source, model, offset, content] = sizes;
  const about = { fps: index.getFloat64(0, true), placement: { source, model, offset, content }, live: false, complete: true, first: 0 };
  return { about: { ...about, intervals, coarseness: new Array(VALUES).fill(1) }, chunks };
}
