// The index of a container. docs/container.md describes every byte; the checks are those of engine/src/scene/container/index.rs.

import { MOST_GAUSSIANS } from "./chunk.js";
import { wrong } from "./errors.js";

/** Bytes of a header, of a trailer, of an index without intervals, and of an interval in the index. */
const [OF_HEADER, OF_TRAILER, OF_INDEX, OF_ENTRY] = [16, 48, 44, 96];
/** Maximum bytes of an index; maximum number of chunks from one independent chunk to the next. */
const MOST_INDEX = 2 ** 26;
const ALONE_EVERY = 8;
const VERSION = 1n;
/** As in engine/src/formats/limits.rs: bytes in memory per byte of the file, bytes allowed for any file, and bytes of a Gaussian and of a merge. */
const [RATIO, ALLOWED, OF_GAUSSIAN, OF_MERGE] = [256, 2 ** 24, 110, 16];
/** As in engine/src/scene/container/read.rs: times that ratio for all intervals, which are read one at a time. */
const TOGETHER = 4;

const viewed = ({ buffer, byteOffset, byteLength }) => new DataView(buffer, byteOffset, byteLength);

/** Throws unless a file begins with the header of a container of this version. */
function checkHeader(head) {
  if (head.getUint32(0) !== 0x7373706c || head.getUint32(4) !== 0x61741a0a) throw wrong("header", "a container's first bytes", "others");
  const version = head.getBigUint64(8, true);
  if (version !== VERSION) throw wrong("header", `version ${VERSION}`, `version ${version}`);
}

/** Returns sizes as in the index, if the content is inside the model's input. */
function placementOf(index) {
  const [source, model, offset, content] = [8, 16, 24, 32].map((at) => [index.getUint32(at, true), index.getUint32(at + 4, true)]);
  const inside = [0, 1].every((i) => source[i] && content[i] && model[i] <= 2 ** 31 && offset[i] + content[i] <= model[i]);
  if (!inside) throw wrong("index: placement", "the content inside the model's input", JSON.stringify({ source, model, offset, content }));
  return { source, model, offset, content };
}

/** Throws if times of frames are not ascending, or not in their interval. */
function checkFrames(index, at, count, { start, end }, i) {
  for (let k = 0, last = -Infinity; k < count; k++) {
    const time = index.getFloat64(at + 8 * k, true);
    if (!(time > last && time >= start && time <= end)) throw wrong(`index: interval ${i}`, "times of frames in order", time);
    last = time;
  }
}

/**
 * Returns the description of a container's scene, in the form of the page's server, and the positions of its chunks: { about, chunks }. An interval
 * may have `most` Gaussians. Digests are not compared; `streamsplat inspect` does that.
 */
export async function readIndex(file, most = MOST_GAUSSIANS) {
  if (file.size < OF_HEADER + OF_TRAILER) throw wrong("container", `at least ${OF_HEADER + OF_TRAILER} bytes`, file.size);
  checkHeader(viewed(await file.read(0, OF_HEADER)));
  const trailer = viewed(await file.read(file.size - OF_TRAILER, OF_TRAILER));
  const [place, length] = [0, 8].map((at) => Number(trailer.getBigUint64(at, true)));
  if (place + length !== file.size - OF_TRAILER || length > MOST_INDEX || place < OF_HEADER) {
    throw wrong("trailer", "an index that ends where it begins", `${length} bytes at ${place} of ${file.size}`);
  }
  if (length < OF_INDEX) throw wrong("index", "44 bytes and 96 for each interval", `${length} bytes`);
  const index = viewed(await file.read(place, length));
  const placement = placementOf(index);
  const fps = index.getFloat64(0, true);
  if (!(fps > 0 && fps < Infinity)) throw wrong("index: frames per second", "a number above 0", fps);
  const count = index.getUint32(40, true);
  const listed = length - OF_INDEX - OF_ENTRY * count;
  if (!count || listed < 0) {
    throw wrong("index", "44 bytes and 96 for each of at least one interval", `${length} for ${count}`);
  }
  const [intervals, chunks] = [[], []];
  let [next, frames, gaussians, merges] = [OF_HEADER, 0, 0, 0];
  for (let i = 0; i < count; i++) {
    const entry = OF_INDEX + i * OF_ENTRY;
    const name = (what) => `index: interval ${i}: ${what}`;
    const [at, bytes] = [0, 8].map((field) => Number(index.getBigUint64(entry + field, true)));
    const [start, end] = [16, 24].map((field) => index.getFloat64(entry + field, true));
    const [its, merged, back, times] = [48, 52, 56, 60].map((field) => index.getUint32(entry + field, true));
    if (at !== next || at + bytes > place) throw wrong(name("place"), "its chunk after the one before and before the index", `${bytes} bytes at ${at}`);
    const before = intervals[i - 1]?.end ?? -Infinity;
    if (!(start >= before && start <= end && Number.isFinite(start) && Number.isFinite(end))) throw wrong(name("times"), "ascending ones", `${start} to ${end} after ${before}`);
    if (its > MOST_GAUSSIANS || merged > MOST_GAUSSIANS) throw wrong(name("counts"), "at most 2^24", `${its} and ${merged}`);
    if (its > most) throw wrong(`interval ${i}`, `at most ${most} Gaussians in this browser`, its);
    if (back && (back !== chunks[i - 1]?.back + 1 || back >= ALONE_EVERY)) {
      throw wrong(name("chunks back"), "none, or one more than of the interval before, under 8", back);
    }
    if (8 * times > listed - frames) throw wrong("index: times of frames", "8 bytes for each", `${listed} for ${frames / 8 + times}`);
    checkFrames(index, OF_INDEX + OF_ENTRY * count + frames, times, { start, end }, i);
    [next, frames, gaussians, merges] = [at + bytes, frames + 8 * times, gaussians + its, merges + merged];
    intervals.push({ start, end, gaussians: its });
    chunks.push({ at, bytes, index: index.getBigUint64(entry + 32, true), back });
  }
  if (frames !== listed) throw wrong("index: times of frames", "8 bytes for each", `${listed} for ${frames / 8}`);
  if (next !== place) throw wrong("index", "chunks up to the index", `their end at ${next} of ${place}`);
  const least = Math.max(ALLOWED, file.size * RATIO);
  const large = intervals.findIndex((one) => one.gaussians * OF_GAUSSIAN > least);
  if (large >= 0) throw wrong(`interval ${large}`, `at most ${Math.floor(least / OF_GAUSSIAN)} Gaussians in a file of ${file.size} bytes`, intervals[large].gaussians);
  const room = Math.max(ALLOWED, file.size * RATIO * TOGETHER);
  for (const [what, number, each] of [["Gaussians", gaussians, OF_GAUSSIAN], ["merges", merges, OF_MERGE]]) {
    if (number * each > room) throw wrong("intervals", `at most ${Math.floor(room / each)} ${what} in a file of ${file.size} bytes`, number);
  }
  return { about: { fps, placement, live: false, complete: true, first: 0, intervals }, chunks };
}
