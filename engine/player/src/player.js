// A scene in time on a canvas.

import { clamp, STEEPEST } from "./camera.js";
import { Clip } from "./clip.js";
import { Drawing, MODES } from "./draw.js";
import { Headset } from "./headset.js";
import { depthsOf } from "./motion.js";
import { Pace } from "./pace.js";
import { followPointers } from "./pointers.js";

/** Parses a colour to red, green and blue from 0 to 1: from these, from one grey level, or from #rrggbb. */
function colourOf(colour) {
  if (typeof colour === "number") return [colour, colour, colour].map((level) => clamp(level, 0, 1));
  const hex = typeof colour === "string" && /^#([0-9a-f]{2})([0-9a-f]{2})([0-9a-f]{2})$/i.exec(colour);
  if (hex) return hex.slice(1).map((level) => parseInt(level, 16) / 255);
  if (Array.isArray(colour) && colour.length === 3 && colour.every(Number.isFinite)) return colour.map((level) => clamp(level, 0, 1));
  throw new Error(`background: expected a level from 0 to 1, three of them or #rrggbb, found ${JSON.stringify(colour)}`);
}

/**
 * Plays a container on a canvas. Events have the names of a video's: `loadedmetadata`, `loadeddata` (the first picture is drawn), `play`, `pause`,
 * `waiting`, `playing`, `seeking`, `seeked`, `timeupdate`, `ended`, `error` (with `error`). In addition there are `viewchange` after the camera was
 * moved, and `tap` after the canvas was touched without a drag.
 */
export class Player extends EventTarget {
  constructor(canvas, { background = 0.07, loop = false, rate = 1, room, gaussians, interactive = true, bounded = true } = {}) {
    super();
    this.canvas = canvas;
    this.options = { room, gaussians };
    this.bounded = bounded;
    this.colour = colourOf(background);
    [this.loop, this.playbackRate, this.shownMode] = [loop, rate, 0];
    [this.time, this.playing, this.springing, this.waiting, this.seekingNow] = [0, false, false, false, false];
    /** `stale`: a frame must be drawn although nothing plays; `due`: a better order was loaded for the current picture. */
    [this.stale, this.due] = [true, false];
    this.clip = null;
    this.opening = null;
    /** The picture on the canvas: { packet, interval, t, order, exact, view, time }. */
    this.shown = null;
    this.pace = new Pace();
    this.drawing = new Drawing(canvas);
    /** The headset that shows the scene, if any. */
    this.headset = null;
    this.until = new AbortController();
    const { signal } = this.until;
    canvas.addEventListener("webglcontextlost", (e) => (e.preventDefault(), (this.drawing = null)), { signal });
    canvas.addEventListener("webglcontextrestored", () => ((this.drawing = new Drawing(canvas)), (this.stale = true)), { signal });
    if (interactive) {
      const [begun, released] = [false, true].map((on) => () => (this.springing = on && this.bounded));
      const changed = () => this.turned();
      followPointers(canvas, () => this.clip?.camera, { begun, changed, released, tapped: () => this.say("tap") }, signal);
    }
    this.before = performance.now();
    const turn = (now) => {
      if (signal.aborted) return;
      this.turn(now);
      requestAnimationFrame(turn);
    };
    requestAnimationFrame(turn);
  }

  /** Handles a moved camera. */
  turned() {
    this.stale = true;
    this.say("viewchange");
  }

  say(what, more = {}) {
    this.dispatchEvent(Object.assign(new Event(what), more));
  }

  /** Shows a container: an address, a File or another Blob, or bytes. Resolves when its index is read; the previous one is shown until then. */
  async load(source) {
    this.opening?.abort();
    const own = (this.opening = new AbortController());
    try {
      const room = this.drawing ? this.drawing.room : Infinity;
      const gaussians = Math.min(this.options.gaussians ?? Infinity, room, 2 ** 24);
      const clip = await Clip.open(source, { room: this.options.room, gaussians, signal: own.signal });
      if (own.signal.aborted) return clip.close();
      this.clip?.close();
      this.clip = clip;
      clip.camera.bounded = this.bounded;
      clip.came = () => (this.due = true);
      clip.failed = (error, interval) => own.signal.aborted || this.say("error", { error, interval });
      [this.time, this.shown, this.stale] = [clip.start, null, true];
      this.say("loadedmetadata");
      this.begin(own);
    } catch (error) {
      if (own.signal.aborted) return;
      this.say("error", { error });
      throw error;
    }
  }

  /** Places the camera; retries if the first interval cannot be loaded. */
  begin(own) {
    const { clip } = this;
    clip.place().then(
      () => (this.stale = true),
      (error) => {
        if (own.signal.aborted) return;
        this.say("error", { error, interval: 0 });
        setTimeout(() => clip === this.clip && this.begin(own), 2000);
      },
    );
  }

  // ---- Time ---------------------------------------------------------------------------------------------------------------------

  get start() {
    return this.clip?.start ?? 0;
  }

  get end() {
    return this.clip?.end ?? 0;
  }

  get duration() {
    return this.clip ? this.end - this.start : NaN;
  }

  /** Seconds since the scene's start. */
  get currentTime() {
    return this.time - this.start;
  }

  set currentTime(seconds) {
    this.seek(seconds);
  }

  get paused() {
    return !this.playing;
  }

  get seeking() {
    return this.seekingNow;
  }

  get ended() {
    return Boolean(this.clip) && !this.loop && this.time >= this.end;
  }

  /** Frames of the source per second. */
  get fps() {
    return this.clip?.fps ?? NaN;
  }

  /** Shows another time, in seconds since the start; resolves when its picture is on the canvas. */
  seek(seconds) {
    if (!Number.isFinite(seconds)) throw new Error(`time: expected a number of seconds, found ${seconds}`);
    if (!this.clip) return Promise.resolve();
    this.time = clamp(this.start + seconds, this.start, this.end);
    this.stale = this.seekingNow = true;
    this.say("seeking");
    return new Promise((done) => this.addEventListener("seeked", () => done(), { once: true }));
  }

  play() {
    if (this.playing) return;
    if (this.clip && !this.loop && this.time >= this.end) this.time = this.start;
    this.playing = this.stale = true;
    this.say("play");
  }

  pause() {
    if (!this.playing) return;
    this.playing = false;
    this.stale = true;
    this.say("pause");
  }

  advance(seconds) {
    const { start, end } = this;
    if (!this.playing || end === start) return;
    const next = this.time + seconds * this.playbackRate;
    this.stale = true;
    const inside = this.loop ? next >= start && next <= end : this.playbackRate < 0 ? next > start : next < end;
    if (inside) {
      this.time = next;
      return;
    }
    const length = end - start;
    this.time = this.loop ? start + ((((next - start) % length) + length) % length) : clamp(next, start, end);
    if (this.loop) return;
    this.playing = false;
    this.say("pause");
    this.say("ended");
  }

  // ---- The view -----------------------------------------------------------------------------------------------------------------

  /** The view: angles in degrees, magnification, shift in scene units, parallel rays or perspective. */
  get view() {
    const { yaw = 0, pitch = 0, zoom = 1, shift = [0, 0, 0], perspective = false } = this.clip?.camera ?? {};
    return { yaw, pitch, zoom, x: shift[0], y: shift[1], z: shift[2], lens: perspective ? "perspective" : "parallel" };
  }

  /** Sets the given properties of the view. */
  look({ yaw, pitch, zoom, x, y, z, lens } = {}) {
    const camera = this.clip?.camera;
    if (!camera) throw new Error("view: expected a scene, found none yet (wait for loadedmetadata)");
    for (const [name, value] of Object.entries({ yaw, pitch, zoom, x, y, z })) {
      if (value !== undefined && !Number.isFinite(value)) throw new Error(`${name}: expected a number, found ${value}`);
    }
    if (lens !== undefined && lens !== "parallel" && lens !== "perspective") throw new Error(`lens: expected parallel or perspective, found ${lens}`);
    if (yaw !== undefined) camera.yaw = yaw;
    if (pitch !== undefined) camera.pitch = clamp(pitch, -STEEPEST, STEEPEST);
    if (zoom !== undefined) camera.magnify(zoom / camera.zoom);
    camera.shift = [x, y, z].map((value, i) => value ?? camera.shift[i]);
    if (lens !== undefined) camera.perspective = lens === "perspective";
    this.springing = false;
    this.turned();
  }

  /** Returns to the source's own view. */
  home() {
    const camera = this.clip?.camera;
    if (!camera) return;
    camera.reset();
    camera.perspective = camera.home.lens === "perspective";
    this.turned();
  }

  /** The displayed quantity: `colour`, `depth` or `identity`. */
  get mode() {
    return MODES[this.shownMode];
  }

  set mode(mode) {
    if (!MODES.includes(mode)) throw new Error(`mode: expected ${MODES.join(", ")}, found ${mode}`);
    this.shownMode = MODES.indexOf(mode);
    this.stale = true;
  }

  get background() {
    return this.colour;
  }

  set background(colour) {
    this.colour = colourOf(colour);
    this.stale = true;
  }

  // ---- The picture --------------------------------------------------------------------------------------------------------------

  /** Number of pictures drawn, and the current fraction of pixels per side, which is lower while drawing is too slow. */
  get pictures() {
    return this.pace.pictures;
  }

  get detail() {
    return this.pace.detail;
  }

  fit() {
    const { canvas, drawing } = this;
    const scale = Math.min(globalThis.devicePixelRatio || 1, 2) * this.pace.detail;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((side) => clamp(Math.round(side * scale), 1, drawing.largest));
    if (canvas.width === width && canvas.height === height) return;
    [canvas.width, canvas.height, this.stale] = [width, height, true];
  }

  /** Advances the time, unless it waits for an interval that is not loaded yet. */
  pass(seconds) {
    const has = this.clip.has(this.time);
    if (has) this.advance(seconds);
    if (!this.playing || this.waiting !== has) return;
    this.waiting = !has;
    this.say(has ? "playing" : "waiting");
  }

  turn(now) {
    const seconds = clamp((now - this.before) / 1000, 0, 0.1);
    this.before = now;
    if (!this.clip || !this.drawing || this.headset) return;
    if (this.springing) {
      this.springing = this.clip.camera.settle(seconds);
      if (this.springing) this.turned();
    }
    if (this.pace.turn(now, this.playing || this.stale)) this.stale = true;
    this.fit();
    if (!this.clip.placed) return;
    this.pass(seconds);
    if (!this.stale && !this.due) return;
    this.due = false;
    try {
      this.stale = !this.draw();
    } catch (error) {
      this.stale = false;
      this.say("error", { error });
    }
  }

  /** Returns the clip's data for the time, seen from a view, and its drawing options; null while they are not loaded. */
  found(view) {
    const found = this.clip.at(this.time, view, { moving: this.playing, loop: this.loop });
    if (!found) return null;
    const { far, near } = depthsOf(found.packet);
    return { ...found, looks: { mode: this.shownMode, background: this.colour, range: [far, near], share: found.share } };
  }

  /** Draws the clip at the time; returns false if it is not loaded yet. */
  draw() {
    const { canvas, clip, drawing, playing, time } = this;
    const view = { ...clip.camera.view(canvas.width, canvas.height), share: this.pace.share };
    const found = this.found(view);
    if (!found) return false;
    const { packet, order, t, exact, looks } = found;
    drawing.draw(packet, order, t, view, looks);
    this.pace.drew();
    const first = !this.shown;
    this.shown = { ...found, view, time };
    if (first) this.say("loadeddata");
    // During motion an earlier order is used; once motion stops, the picture is exact.
    if (this.seekingNow && (playing || exact)) {
      this.seekingNow = false;
      this.say("seeked");
    }
    this.say("timeupdate");
    return true;
  }

  // ---- A headset ----------------------------------------------------------------------------------------------------------------

  /**
   * Shows the scene in a headset, two metres ahead; a trigger or a pinch plays and pauses. Browsers allow it only in response to a click. Resolves
   * when the session has started. Events `vrenter` and `vrleave`.
   */
  async enterVR() {
    if (!this.clip?.placed || !this.drawing) throw new Error("headset: expected a scene, found none yet (wait for loadeddata)");
    if (this.headset) return;
    this.headset = await Headset.enter(this.drawing, this.clip.camera, {
      advance: (seconds) => this.clip && this.pass(seconds),
      found: (view) => this.clip && this.found(view),
      selected: () => (this.playing ? this.pause() : this.play()),
      left: () => {
        this.headset = null;
        this.stale = true;
        this.say("vrleave");
      },
    });
    this.say("vrenter");
  }

  /** Returns to the canvas. */
  async leaveVR() {
    await this.headset?.leave();
  }

  /** Ends the player. The canvas keeps its last picture. */
  close() {
    this.opening?.abort();
    this.until.abort();
    this.headset?.leave();
    this.clip?.close();
    [this.clip, this.playing] = [null, false];
  }
}
