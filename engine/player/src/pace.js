// The pace of pictures: where they come too slowly while things move, they are drawn with fewer pixels, until things rest or
// pictures come quickly again.

import { clamp } from "./camera.js";

/** The longest time from one picture to the next, in milliseconds, and the fewest pixels a side of all there are. */
const SLOW = 36;
const LEAST = 0.3;
/** The part of that time in which there is room for more pixels, and by how much a side then grows. */
const [ROOMY, GROWTH] = [0.6, 1.1];
/** How long nothing moves before the picture is drawn with all pixels again, in milliseconds. */
const REST = 400;

export class Pace {
  constructor() {
    this.detail = 1;
    /** The detail that was found to be quick enough. */
    this.quick = 1;
    this.pictures = 0;
    this.drawn = false;
    this.last = 0;
    this.moved = 0;
    this.times = [];
  }

  drew() {
    this.pictures++;
    this.drawn = true;
  }

  /** One turn of the browser's clock, in which things move or not; returns whether the detail changed. */
  turn(now, moving) {
    const since = now - this.last;
    this.last = now;
    if (this.drawn && since < 1000) this.times.push(since);
    this.drawn = false;
    if (this.times.length >= 8) {
      const middle = this.times.sort((a, b) => a - b)[4];
      this.times = [];
      if (middle > SLOW) this.quick = Math.max(LEAST, this.quick * clamp(Math.sqrt(SLOW / middle), 0.5, 0.9));
      else if (middle < ROOMY * SLOW) this.quick = Math.min(1, this.quick * GROWTH);
    }
    if (moving) this.moved = now;
    const detail = now - this.moved < REST ? this.quick : 1;
    const changed = detail !== this.detail;
    this.detail = detail;
    return changed;
  }
}
