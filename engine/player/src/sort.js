// Front-to-back order: a counting sort by depth, then updates of only the records that moved.

import { dot, nearest } from "./camera.js";
import { depthOf } from "./motion.js";
import { SHORTS, WORDS } from "./packet.js";

const BINS = 1 << 16;
/** 2³² times the golden ratio's fraction: multiples of it are even over 2³², so that records which are chosen by them are even over a picture. */
const GOLDEN = 0x9e3779b9;
/** Maximum fraction of records that are moved one by one; if more moved, all are sorted. */
const FEW = 1 / 8;

/** Keeps a packet's records in order from one time and view to the next. */
export class Sorter {
  constructor(packet) {
    const { count, shorts, positionLow, positionStep, velocityLow, velocityStep } = packet;
    this.count = count;
    this.still = Boolean(packet.still);
    this.position = new Float32Array(count * 3);
    this.velocity = new Float32Array(this.still ? 0 : count * 3);
    this.reference = new Uint8Array(this.still ? 0 : count);
    /** By which records are chosen where not all are drawn: the same Gaussian in each interval has the same number. */
    this.turn = Uint32Array.from({ length: count }, (_, i) => Math.imul(this.still ? i : packet.words[i * WORDS + 6], GOLDEN));
    for (let i = 0; i < count; i++) {
      if (this.still) {
        this.position.set(packet.floats.subarray(i * WORDS, i * WORDS + 3), 3 * i);
        continue;
      }
      this.reference[i] = packet.reference(i);
      for (let axis = 0; axis < 3; axis++) {
        this.position[3 * i + axis] = positionLow[axis] + positionStep[axis] * shorts[i * SHORTS + axis];
        this.velocity[3 * i + axis] = velocityLow[axis] + velocityStep[axis] * shorts[i * SHORTS + 3 + axis];
      }
    }
    this.depth = new Float32Array(count);
    this.seen = new Uint8Array(count);
    /** All records, nearest first; empty before the first sort. */
    this.order = new Uint32Array(count);
    this.spare = new Uint32Array(count);
    this.moved = new Uint32Array(count);
    this.sorted = false;
  }

  /**
   * Returns the records that may be visible at t, nearest first, equal depths in drawing order, and the numbers of records visited and moved. Where the
   * view has a `share` below 1, only so many of them.
   */
  sort(t, view) {
    this.look(t, view);
    let moved = this.sorted ? this.mend() : -1;
    if (moved < 0) {
      this.all();
      moved = this.count;
    }
    this.sorted = true;
    const shown = new Uint32Array(this.count);
    const most = (view.share ?? 1) * 2 ** 32;
    let total = 0;
    for (const i of this.order) if (this.seen[i] && this.turn[i] < most) shown[total++] = i;
    return { order: shown.slice(0, total), work: { records: this.count, moved } };
  }

  /** Computes depths, and whether a record may be visible. */
  look(t, view) {
    const { axes, eye, units } = view;
    const { position, velocity, reference, depth, seen } = this;
    // In square units.
    const [fx, fy, fz] = [units * axes[2][0], axes[2][1], units * axes[2][2]];
    const offset = dot(axes[2], eye);
    const least = nearest(view);
    if (this.still) {
      for (let i = 0; i < this.count; i++) {
        depth[i] = fx * position[3 * i] + fy * position[3 * i + 1] + fz * position[3 * i + 2] - offset;
        seen[i] = depth[i] > least ? 1 : 0;
      }
      return;
    }
    for (let i = 0; i < this.count; i++) {
      const tau = t - reference[i];
      const y = position[3 * i + 1] + velocity[3 * i + 1] * tau;
      const x = position[3 * i] + velocity[3 * i] * tau;
      const z = position[3 * i + 2] + velocity[3 * i + 2] * tau;
      depth[i] = fx * x - fy * z + fz * depthOf(Math.min(1, Math.max(0, y))) - offset;
      seen[i] = y >= 0 && y <= 1 && depth[i] > least ? 1 : 0;
    }
  }

  /** Sorts all records by counting. */
  all() {
    const { depth, order, count } = this;
    let [low, high] = [Infinity, -Infinity];
    for (let i = 0; i < count; i++) {
      if (depth[i] < low) low = depth[i];
      if (depth[i] > high) high = depth[i];
    }
    const scale = high > low ? (BINS - 1) / (high - low) : 0;
    const counts = new Uint32Array(BINS + 1);
    for (let i = 0; i < count; i++) counts[(((depth[i] - low) * scale) | 0) + 1]++;
    for (let bin = 0; bin < BINS; bin++) counts[bin + 1] += counts[bin];
    for (let i = 0; i < count; i++) order[counts[((depth[i] - low) * scale) | 0]++] = i;
    // If depths are far apart, many records share a bin, so each bin is sorted itself.
    for (let bin = 0, from = 0; bin < BINS; from = counts[bin++]) {
      if (counts[bin] - from > 1) order.subarray(from, counts[bin]).sort((a, b) => depth[a] - depth[b] || a - b);
    }
  }

  /** Removes misplaced records from the last order, sorts them, and merges both; returns −1 if they are too many. */
  mend() {
    const { depth, order, spare, moved, count } = this;
    const most = count * FEW;
    const before = (a, b) => depth[a] < depth[b] || (depth[a] === depth[b] && a < b);
    let [kept, out] = [0, 0];
    for (let place = 0; place < count; place++) {
      const i = order[place];
      if (kept && before(i, spare[kept - 1])) {
        if (out >= most) return -1;
        // Either of the two may have moved: it is the last one if the records before it are still in order.
        if (kept === 1 || before(spare[kept - 2], i)) {
          moved[out++] = spare[kept - 1];
          spare[kept - 1] = i;
        } else {
          moved[out++] = i;
        }
      } else {
        spare[kept++] = i;
      }
    }
    if (!out) return 0;
    const those = moved.subarray(0, out).sort((a, b) => (before(a, b) ? -1 : 1));
    for (let place = 0, a = 0, b = 0; place < count; place++) {
      order[place] = b === out || (a < kept && before(spare[a], those[b])) ? spare[a++] : those[b++];
    }
    return out;
  }
}
