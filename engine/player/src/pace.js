// Control of the frame rate: if frames are slow during motion, they are drawn with fewer pixels and fewer Gaussians, until motion stops or frames are fast
// again.

import { clamp } from "./camera.js";

/** Maximum time between pictures, in milliseconds, and the least level of detail. */
const SLOW = 34;
const LEAST = 0.2;
/** The minimum fraction of the pixels per side, and the fraction of the Gaussians per level: pixels are reduced first, which is seen less. */
const FEWEST = 0.3;
const GAUSSIANS = 1.8;
/** Fraction of that time below which there is room for more, and the factor by which the level then grows. */
const [ROOMY, GROWTH] = [0.6, 1.1];
/** Milliseconds without motion before the picture is drawn with all pixels again. */
const REST = 400;

export class Pace {
  constructor() {
    /** The level of detail, and the one that was fast enough. */
    this.level = 1;
    this.quick = 1;
    this.pictures = 0;
    this.drawn = false;
    this.last = 0;
    this.moved = 0;
    this.times = [];
  }

  /** Fraction of the pixels per side. */
  get detail() {
    return Math.max(FEWEST, this.level);
  }

  /** Fraction of the Gaussians. */
  get share() {
    return Math.min(1, GAUSSIANS * this.level);
  }

  drew() {
    this.pictures++;
    this.drawn = true;
  }

  /** Handles one animation frame, with or without motion; returns whether the level of detail changed. */
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
    const level = now - this.moved < REST ? this.quick : 1;
    const changed = level !== this.level;
    this.level = level;
    return changed;
  }
}
