// A scene in time: loads its intervals on demand and ahead, and keeps the order of its Gaussians. It does not draw.

import { BlobFile } from "./blob.js";
import { Camera, clamp } from "./camera.js";
import { MOST_GAUSSIANS } from "./chunk.js";
import { readIndex } from "./container.js";
import { wrong } from "./errors.js";
import { Helper, Orders } from "./helper.js";
import { depthOf, depthsOf } from "./motion.js";
import { HEADER, RECORD } from "./packet.js";
import { RemoteFile } from "./remote.js";
import { Contained, Store } from "./store.js";

/** Bytes of packets that are kept, and seconds that are loaded ahead. */
const [ROOM, AHEAD] = [64 * 2 ** 20, 2];
/** Maximum number of intervals loading ahead at the same time. */
const COMING = 2;
/** Milliseconds from a failure to the next attempt. */
const RETRY = 2000;
/** Maximum bytes per Gaussian in a packet. */
const EACH = RECORD + 5;

/** Returns the player's worker. */
function ownWorker() {
  const address = new URL("./worker.js", import.meta.url);
  if (address.origin === location.origin) return new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
  // A page cannot start a worker from another site, so it starts its own, which imports the other's.
  const own = new Blob([`import ${JSON.stringify(address.href)};`], { type: "text/javascript" });
  return new Worker(URL.createObjectURL(own), { type: "module" });
}

/** Returns the file of a source: an address, a Blob, or bytes. */
async function fileOf(source, signal) {
  if (source instanceof Blob) return new BlobFile(source);
  if (source instanceof ArrayBuffer || ArrayBuffer.isView(source)) return new BlobFile(new Blob([source]));
  if (typeof source !== "string" && !(source instanceof URL)) throw wrong("source", "an address, a Blob or bytes", typeof source);
  return RemoteFile.open(source, { signal });
}

export class Clip {
  /** Opens the scene in a container. `room`: bytes of packets kept; `gaussians`: the maximum of an interval; `signal` aborts loading. */
  static async open(source, { room = ROOM, gaussians = MOST_GAUSSIANS, signal = null } = {}) {
    const file = await fileOf(source, signal);
    const index = await readIndex(file, gaussians);
    file.indexed?.();
    const clip = new Clip(file, index, room, new Helper(ownWorker()));
    await clip.store.refresh();
    return clip;
  }

  constructor(file, index, room, helper) {
    [this.file, this.room, this.helper] = [file, room, helper];
    const { about } = index;
    [this.fps, this.placement, this.intervals] = [about.fps, about.placement, about.intervals];
    this.start = about.intervals[0].start;
    this.end = about.intervals[about.intervals.length - 1].end;
    /** Maximum number of Gaussians of an interval. */
    this.most = about.intervals.reduce((most, { gaussians }) => Math.max(most, gaussians), 0);
    this.camera = new Camera();
    this.camera.place(about.placement);
    this.orders = new Orders(helper, () => this.came());
    this.store = new Store(new Contained(file, index, helper, ""), (interval) => this.orders.forget(interval), room);
    /** Called when loaded data may change the picture, and when an interval cannot be loaded. */
    this.came = () => {};
    this.failed = () => {};
    this.again = 0;
    this.placed = false;
  }

  /** Number of requests and bytes received so far, for a clip behind an address. */
  get traffic() {
    return { ...(this.file.traffic ?? { requests: 0, bytes: 0 }) };
  }

  /** Bytes of packets in memory. */
  get kept() {
    return this.store.bytes;
  }

  /** Returns the packet of an interval, from memory or from the file. */
  packet(interval) {
    return this.store.fetch(interval);
  }

  /** Sets the camera's pivot to the middle of the first interval, so that a view does not depend on the intervals shown before. */
  async place() {
    if (this.placed) return;
    this.camera.depth = depthOf(depthsOf(await this.packet(0)).middle);
    this.placed = true;
  }

  /** Requests an interval; after a failure, not again for RETRY milliseconds. */
  load(interval) {
    if (performance.now() < this.again) return;
    this.packet(interval).then(
      () => this.came(),
      (e) => {
        if (!this.store) return;
        this.again = performance.now() + RETRY;
        this.failed(e, interval);
      },
    );
  }

  /** Requests the intervals that are shown next, unless too many are loading. */
  readAhead(interval, time, loop) {
    const { store, intervals } = this;
    let bytes = 0;
    for (let i = interval + 1; i < intervals.length + (loop ? interval : 0); i++) {
      const [k, laps] = [i % intervals.length, i < intervals.length ? 0 : this.end - this.start];
      bytes += HEADER + EACH * intervals[k].gaussians;
      // Intervals loaded ahead must not displace the one that is shown.
      if (intervals[k].start + laps > time + AHEAD || bytes > this.room / 2 || store.coming.size >= COMING) return;
      if (!store.kept.has(k) && !store.coming.has(k)) this.load(k);
    }
  }

  /**
   * Returns the data to draw at a time from a view: { packet, interval, t, order, exact }; null while it is not loaded. `moving`: whether time
   * advances; `loop`: whether the beginning follows the end.
   */
  at(time, view, { moving = false, loop = false } = {}) {
    const { store, orders } = this;
    const interval = store.find(time);
    const packet = store.held(interval);
    if (!packet) {
      this.load(interval);
      return null;
    }
    this.readAhead(interval, time, loop);
    const t = packet.end > packet.start ? clamp((time - packet.start) / (packet.end - packet.start), 0, 1) : 0;
    orders.want(interval, t, view, moving && store.kept.has(interval + 1) ? interval + 1 : null);
    const found = orders.of(interval, t, view);
    return found && { packet, interval, t, ...found };
  }

  /** Returns whether the interval at a time is loaded. */
  has(time) {
    return this.store.kept.has(this.store.find(time));
  }

  /** Ends the worker. */
  close() {
    this.helper.end();
    this.store = null;
  }
}
