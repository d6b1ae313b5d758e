// A scene in time: its intervals as they are needed and some ahead, and the order of its Gaussians. It draws nothing.

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

/** Bytes of packets that are kept, and seconds that are read ahead. */
const [ROOM, AHEAD] = [64 * 2 ** 20, 2];
/** Intervals read ahead at once. */
const COMING = 2;
/** Milliseconds after a failure until the next attempt. */
const RETRY = 2000;
/** Bytes of a Gaussian in a packet at most. */
const EACH = RECORD + 5;

/** The player's worker. */
function ownWorker() {
  const address = new URL("./worker.js", import.meta.url);
  if (address.origin === location.origin) return new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
  // A page starts no worker from another site: it starts one of its own that imports the other's.
  const own = new Blob([`import ${JSON.stringify(address.href)};`], { type: "text/javascript" });
  return new Worker(URL.createObjectURL(own), { type: "module" });
}

/** The file that a source is: an address, a Blob, or bytes. */
async function fileOf(source, signal) {
  if (source instanceof Blob) return new BlobFile(source);
  if (source instanceof ArrayBuffer || ArrayBuffer.isView(source)) return new BlobFile(new Blob([source]));
  if (typeof source !== "string" && !(source instanceof URL)) throw wrong("source", "an address, a Blob or bytes", typeof source);
  return RemoteFile.open(source, { signal });
}

export class Clip {
  /**
   * The scene in a container. `room`: bytes of packets kept; `gaussians`: the most of an interval; `signal` ends what is under way.
   */
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
    /** The most Gaussians of an interval. */
    this.most = about.intervals.reduce((most, { gaussians }) => Math.max(most, gaussians), 0);
    this.camera = new Camera();
    this.camera.place(about.placement);
    this.orders = new Orders(helper, () => this.came());
    this.store = new Store(new Contained(file, index, helper, ""), (interval) => this.orders.forget(interval), room);
    /** Called when something was loaded that may change the picture, and when an interval cannot be loaded. */
    this.came = () => {};
    this.failed = () => {};
    this.again = 0;
    this.placed = false;
  }

  /** Requests made and bytes received so far, of a clip behind an address. */
  get traffic() {
    return { ...(this.file.traffic ?? { requests: 0, bytes: 0 }) };
  }

  /** Bytes of packets in memory. */
  get kept() {
    return this.store.bytes;
  }

  /** The packet of an interval, from wherever it is. */
  packet(interval) {
    return this.store.fetch(interval);
  }

  /** Lets the camera turn about the middle of the first interval, whichever is shown, so that a view does not depend on what was shown before. */
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

  /** Requests the intervals that are shown soon, if not too many are on their way. */
  readAhead(interval, time, loop) {
    const { store, intervals } = this;
    let bytes = 0;
    for (let i = interval + 1; i < intervals.length + (loop ? interval : 0); i++) {
      const [k, laps] = [i % intervals.length, i < intervals.length ? 0 : this.end - this.start];
      bytes += HEADER + EACH * intervals[k].gaussians;
      // What is read ahead must not displace what is shown.
      if (intervals[k].start + laps > time + AHEAD || bytes > this.room / 2 || store.coming.size >= COMING) return;
      if (!store.kept.has(k) && !store.coming.has(k)) this.load(k);
    }
  }

  /**
   * What is drawn at a time from a view: { packet, interval, t, order, exact }; null while it is still to come. `moving`: whether time goes on;
   * `loop`: whether the beginning follows the end.
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

  /** Whether the interval at a time is loaded. */
  has(time) {
    return this.store.kept.has(this.store.find(time));
  }

  /** Ends the worker. */
  close() {
    this.helper.end();
    this.store = null;
  }
}
