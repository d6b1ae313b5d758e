// The time of a clip, advanced by another program's loop.

/** Plays between a start and an end. */
export class Clock {
  constructor(start, end) {
    [this.start, this.end, this.time] = [start, end, start];
    [this.playing, this.loop, this.rate] = [false, true, 1];
  }

  /** Advances the time by some seconds. */
  advance(seconds) {
    if (!this.playing || this.end === this.start) return;
    const next = this.time + seconds * this.rate;
    const length = this.end - this.start;
    if (this.loop) this.time = this.start + ((((next - this.start) % length) + length) % length);
    else this.time = Math.min(this.end, Math.max(this.start, next));
    if (!this.loop && this.time === (this.rate < 0 ? this.start : this.end)) this.playing = false;
  }

  /** Seconds since the start. */
  get current() {
    return this.time - this.start;
  }

  set current(seconds) {
    if (!Number.isFinite(seconds)) throw new Error(`time: expected a number of seconds, found ${seconds}`);
    this.time = Math.min(this.end, Math.max(this.start, this.start + seconds));
  }
}
