// The source of intervals, and those already loaded.

/** The most bytes of packets kept. */
const KEPT = 256 * 2 ** 20;

/** A scene of chunks, of which each may need the one before it. */
class Chunked {
  constructor(description, helper) {
    this.description = description;
    this.helper = helper;
    /** The interval whose chunk the worker was given last, on from which it goes without those before. */
    this.given = -1;
  }

  async describe(from) {
    return { ...this.description, from, intervals: this.description.intervals.slice(from) };
  }

  async packet(interval) {
    const parts = [];
    for (let i = interval; i !== this.given; i--) {
      parts.unshift(await this.part(i));
      if (this.isAlone(parts[0])) break;
    }
    // No chunk is left to drop where it is the last one again.
    if (!parts.length) {
      this.given = -1;
      return this.packet(interval);
    }
    this.given = interval;
    const { start, end } = this.description.intervals[interval];
    const { coarseness } = this.description;
    const place = interval - parts.length + 1;
    try {
      const { buffer } = await this.helper.ask({ kind: "parts", interval, place, parts, times: { start, end }, coarseness });
      return packetIn(buffer);
    } catch (e) {
      this.given = -1;
      throw e;
    }
  }
}

/** A scene inside this file: its intervals are texts that follow the scripts, and may be still to come. */
class Embedded extends Chunked {
  constructor(element, helper) {
    super(JSON.parse(element.textContent), helper);
  }

  /** The text of interval i, once the browser has read it to its end. */
  part(i) {
    const whole = () => {
      const element = document.getElementById(`interval-${i}`);
      if (element && (element.nextSibling || document.readyState !== "loading")) return element.textContent;
      if (document.readyState !== "loading") throw new Error("the file ends before it");
      return null;
    };
    return new Promise((done, failed) => {
      const look = () => {
        try {
          const text = whole();
          if (text === null) setTimeout(look, 20);
          else done(text);
        } catch (e) {
          failed(e);
        }
      };
      look();
    });
  }

  /** The ninth byte: whether it needs none before it. */
  isAlone(text) {
    return bytesOf(text.slice(0, 12))[8] === 1;
  }

  async packet(interval) {
    if (!this.description.still) return super.packet(interval);
    const { buffer } = await this.helper.ask({ kind: "still", interval, text: await this.part(interval) });
    return packetIn(buffer);
  }
}

/** A container that was opened on the page. */
class Contained extends Chunked {
  constructor(file, about, chunks, helper) {
    super({ ...about, title: file.name }, helper);
    this.file = file;
    this.chunks = chunks;
  }

  /** A chunk as a page's text has it: after its key frame, and whether it is independent. */
  async part(i) {
    const { at, bytes, keyFrame, alone } = this.chunks[i];
    const part = new Uint8Array(9 + bytes);
    new DataView(part.buffer).setBigUint64(0, BigInt(keyFrame), true);
    part[8] = alone ? 1 : 0;
    part.set(new Uint8Array(await this.file.slice(at, at + bytes).arrayBuffer()), 9);
    return part;
  }

  isAlone(part) {
    return part[8] === 1;
  }
}

/** A scene behind the server this page came from. */
class Served {
  constructor(helper) {
    this.helper = helper;
  }

  async get(path) {
    const response = await fetch(path);
    if (!response.ok) throw new Error((await response.text()).trim());
    return response;
  }

  async describe(from) {
    return (await this.get(`scene.json?from=${from}`)).json();
  }

  async packet(interval) {
    const bytes = await (await this.get(`interval/${interval}`)).arrayBuffer();
    const { buffer } = await this.helper.ask({ kind: "packet", interval, buffer: bytes }, [bytes]);
    return packetIn(buffer);
  }
}

/** A still scene from a file that was opened on the page: its packet is at hand. */
class Local {
  constructor(title, packet, still) {
    this.description = { title, fps: 0, still, live: false, complete: true, first: 0, intervals: [{ start: 0, end: 0, gaussians: packet.count }] };
    this.whole = packet;
  }

  async describe(from) {
    return { ...this.description, from, intervals: this.description.intervals.slice(from) };
  }

  async packet() {
    return this.whole;
  }
}

/** The list of intervals, and the packets that were asked for last. */
class Store {
  /** `left`: what is done with an interval that is no longer kept. */
  constructor(source, left) {
    this.source = source;
    this.left = left;
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
    // Intervals that a stream no longer keeps have no times.
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
      this.left(oldest);
      this.bytes -= size;
    }
    return packet;
  }
}
