// Where intervals come from, and the ones at hand.

/** The most bytes of packets kept. */
const KEPT = 256 * 2 ** 20;

/** Bytes of a packet's header; of its records, ages and rates. */
const HEADER_BYTES = 96;
const WIDTHS = [32, 2, 3];

/** The bytes of a packet from those by columns: of each part the first byte of every entry, then the second, and so on. */
function byRows(columns) {
  const bytes = new Uint8Array(columns.length);
  bytes.set(columns.subarray(0, HEADER_BYTES));
  const count = new DataView(columns.buffer, columns.byteOffset).getUint32(32, true);
  let start = HEADER_BYTES;
  for (const width of WIDTHS) {
    if (start + count * width > columns.length) break;
    for (let byte = 0, from = start; byte < width; byte++) {
      for (let to = start + byte, end = start + count * width; to < end; to += width) bytes[to] = columns[from++];
    }
    start += count * width;
  }
  return bytes;
}

/** A scene inside this file. */
class Embedded {
  constructor(element) {
    this.description = JSON.parse(element.textContent);
  }

  async describe(from) {
    return { ...this.description, from, intervals: this.description.intervals.slice(from) };
  }

  async packet(i) {
    const text = atob(document.getElementById(`interval-${i}`).textContent);
    const bytes = new Uint8Array(text.length);
    for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
    const inflated = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
    return new Packet(byRows(new Uint8Array(await new Response(inflated).arrayBuffer())).buffer);
  }
}

/** A scene behind the server this page came from. */
class Served {
  async get(path) {
    const response = await fetch(path);
    if (!response.ok) throw new Error((await response.text()).trim());
    return response;
  }

  async describe(from) {
    return (await this.get(`scene.json?from=${from}`)).json();
  }

  async packet(i) {
    return new Packet(await (await this.get(`interval/${i}`)).arrayBuffer());
  }
}

/** The list of intervals, and the packets that were asked for last. */
class Store {
  constructor(source) {
    this.source = source;
    this.about = null;
    this.times = [];
    this.kept = new Map();
    this.coming = new Map();
    this.bytes = 0;
  }

  /** Asks for intervals that are not on the list yet. Returns how many there were. */
  async refresh() {
    const known = this.times.length;
    const { intervals, from, ...about } = await this.source.describe(known);
    this.about = about;
    // What a stream no longer keeps has no times.
    while (this.times.length < from) this.times.push(null);
    this.times.push(...intervals);
    return this.times.length - known;
  }

  /** The first interval that can be shown. */
  get first() {
    const first = Math.min(this.about?.first ?? 0, Math.max(this.times.length - 1, 0));
    const held = [...this.kept.keys()];
    return Math.max(this.times.findIndex(Boolean), held.length ? Math.min(first, ...held) : first);
  }

  get span() {
    if (!this.times.length) return [0, 0];
    return [this.times[this.first].start, this.times[this.times.length - 1].end];
  }

  /** The interval that shows `time`: where two meet, the earlier one that has a length. */
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

  /** Packet i if it is at hand. */
  held(i) {
    const packet = this.kept.get(i);
    if (packet) {
      this.kept.delete(i); // and behind all others, as the last one used
      this.kept.set(i, packet);
    }
    return packet;
  }

  /** Packet i, from wherever it is. */
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
      if (this.bytes <= KEPT || oldest === i) break;
      this.kept.delete(oldest);
      this.bytes -= size;
    }
    return packet;
  }
}
