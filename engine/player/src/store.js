// The source of intervals, and the loaded ones.

import { Packet } from "./packet.js";

/** Maximum bytes of packets kept. */
const KEPT = 256 * 2 ** 20;

/** A scene of chunks, each of which may need the previous one. */
export class Chunked {
  constructor(description, helper) {
    this.description = description;
    this.helper = helper;
    /** The interval of the worker's last chunk; the next one needs no earlier chunks. */
    this.given = -1;
    /** The previous question. */
    this.line = Promise.resolve();
  }

  async describe(from) {
    return { ...this.description, from, intervals: this.description.intervals.slice(from) };
  }

  /** Returns the packet of an interval. Chunks are read in parallel; dependent chunks are decoded in order. */
  packet(interval) {
    // If it is the last one again, no chunk is left to drop.
    const from = this.given < interval ? this.given + 1 : 0;
    this.given = interval;
    const [parts, before] = [this.parts(interval, from), this.line];
    const packet = (async () => {
      try {
        const chunks = await parts;
        if (!chunks[0].alone) await before;
        return await this.taken(interval, chunks);
      } catch (e) {
        this.given = -1;
        if (!e.lost) throw e;
        // The interval before it was not loaded.
        return this.taken(interval, await this.parts(interval, 0));
      }
    })();
    this.line = packet.catch(() => {});
    return packet;
  }

  async taken(interval, parts) {
    const { intervals, coarseness } = this.description;
    const { start, end } = intervals[interval];
    const question = { kind: "parts", interval, place: interval - parts.length + 1, parts, times: { start, end }, coarseness };
    const { buffer, lost } = await this.helper.ask(question, [...new Set(parts.map(({ bytes }) => bytes.buffer))]);
    if (lost) throw Object.assign(new Error(`interval ${interval}: expected the one before, found none`), { lost });
    return new Packet(buffer);
  }
}

/** A scene in a container: a file in the form of container.js, and its index. */
export class Contained extends Chunked {
  constructor(file, { about, chunks }, helper, title) {
    super({ ...about, title }, helper);
    this.file = file;
    this.chunks = chunks;
  }

  /** Returns the chunks up to that of an interval, from `from` on or from the last independent one. They are contiguous. */
  async parts(interval, from) {
    const first = Math.max(from, interval - this.chunks[interval].back);
    const { at, bytes } = this.chunks[interval];
    const begin = this.chunks[first].at;
    const whole = await this.file.read(begin, at + bytes - begin);
    return this.chunks.slice(first, interval + 1).map(({ at, bytes, index, back }, k) => {
      const { gaussians: count } = this.description.intervals[first + k];
      return { bytes: whole.subarray(at - begin, at - begin + bytes), index, alone: back === 0, count };
    });
  }
}

/** The list of intervals, and the packets used last. */
export class Store {
  /** `left`: called with an interval that is dropped; `room`: maximum bytes of packets kept. */
  constructor(source, left, room = KEPT) {
    this.source = source;
    this.room = room;
    this.left = left;
    this.about = null;
    this.times = [];
    this.kept = new Map();
    this.coming = new Map();
    this.bytes = 0;
  }

  /** Requests the intervals that are not in the list yet; returns their number. */
  async refresh() {
    const known = this.times.length;
    const { intervals, from, ...about } = await this.source.describe(known);
    this.about = about;
    // Intervals that a stream has dropped have no times.
    while (this.times.length < from) this.times.push(null);
    this.times.push(...intervals);
    return this.times.length - known;
  }

  /** Returns the first interval that can be shown. */
  get first() {
    const first = Math.min(this.about?.first ?? 0, Math.max(this.times.length - 1, 0));
    const held = [...this.kept.keys()];
    return Math.max(this.times.findIndex(Boolean), held.length ? Math.min(first, ...held) : first);
  }

  get span() {
    if (!this.times.length) return [0, 0];
    return [this.times[this.first].start, this.times[this.times.length - 1].end];
  }

  /** Returns the interval that shows `time`: where two meet, the earlier one that has a length. */
  find(time) {
    let low = this.first;
    let high = this.times.length - 1;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.times[middle].end < time) low = middle + 1;
      else high = middle;
    }
    const longer = low + 1 < this.times.length && this.times[low].end === this.times[low].start;
    return longer && this.times[low + 1].start <= time ? low + 1 : low;
  }

  /** Returns packet i if it is loaded. */
  held(i) {
    const packet = this.kept.get(i);
    if (packet) {
      this.kept.delete(i); // moved to the end, as the last one used
      this.kept.set(i, packet);
    }
    return packet;
  }

  /** Returns packet i, from memory or from the source. */
  fetch(i) {
    const held = this.held(i);
    if (held) return Promise.resolve(held);
    if (!this.coming.has(i)) {
      const coming = this.source.packet(i).then((packet) => this.keep(i, packet));
      this.coming.set(i, coming.finally(() => this.coming.delete(i)));
    }
    return this.coming.get(i);
  }

  keep(i, packet) {
    this.kept.set(i, packet);
    this.bytes += packet.size;
    for (const [oldest, { size }] of this.kept) {
      if (this.bytes <= this.room || oldest === i) break;
      this.kept.delete(oldest);
      this.left(oldest);
      this.bytes -= size;
    }
    return packet;
  }
}
