// <streamsplat-player src="clip.ssz" autoplay loop controls></streamsplat-player>

import { offersHeadset } from "./headset.js";
import { Player } from "./player.js";

const STYLE = `
:host { display: block; position: relative; aspect-ratio: 16 / 9; overflow: hidden; background: #121212; color: #fff; font: 14px/1.4 system-ui, sans-serif; }
:host([hidden]) { display: none; }
canvas { display: block; width: 100%; height: 100%; touch-action: none; cursor: grab; outline-offset: -2px; }
canvas.held { cursor: grabbing; }
:host([still-camera]) canvas { cursor: default; touch-action: auto; }
.poster { position: absolute; inset: 0; display: grid; pointer-events: none; }
.poster ::slotted(img) { width: 100%; height: 100%; object-fit: contain; }
.bar { position: absolute; inset: auto 0 0; display: flex; gap: 8px; align-items: center; padding: 4px 12px 4px 4px; background: linear-gradient(transparent, #000b); }
.bar button { width: 44px; height: 44px; border: 0; background: none; cursor: pointer; }
.bar svg { width: 20px; fill: #fff; }
.bar input { flex: 1; min-width: 0; height: 44px; margin: 0; accent-color: #fff; background: none; }
.bar span { font-variant-numeric: tabular-nums; white-space: nowrap; }
.message { position: absolute; inset: 0 0 auto; margin: 0; padding: 8px 12px; background: #000b; overflow-wrap: anywhere; }
[hidden] { display: none; }
`;
const HEADSET = "M2 5h16v10h-5l-2-3H9l-2 3H2zM6 8a1.5 1.5 0 100 3 1.5 1.5 0 000-3M14 8a1.5 1.5 0 100 3 1.5 1.5 0 000-3";
const [PLAY, PAUSE] = ["M5 3l12 7-12 7z", "M5 3h3.5v14H5zM11.5 3H15v14h-3.5z"];
const BODY = `
<canvas tabindex="0" role="img" aria-label="A scene that can be turned" part="canvas"></canvas>
<div class="poster" part="poster"><slot></slot></div>
<p class="message" part="message" role="status" hidden></p>
<div class="bar" part="controls" hidden>
<button type="button" aria-label="Play"><svg viewBox="0 0 20 20" aria-hidden="true"><path d="${PLAY}"/></svg></button>
<input type="range" aria-label="Time" min="0" max="1" step="any" value="0"><span></span>
<button type="button" class="vr" aria-label="Show in a headset" hidden><svg viewBox="0 0 20 20" aria-hidden="true"><path d="${HEADSET}"/></svg></button>
</div>`;
/** Events of the player that the element dispatches as well. */
const EVENTS = [
  ...["loadedmetadata", "loadeddata", "play", "pause", "waiting", "playing", "seeking", "seeked", "timeupdate", "ended", "error", "viewchange"],
  ...["vrenter", "vrleave"],
];

export class StreamsplatPlayer extends HTMLElement {
  static observedAttributes = ["src", "loop", "controls", "background", "playbackrate", "mode"];

  constructor() {
    super();
    const root = this.attachShadow({ mode: "open" });
    const style = document.createElement("style");
    style.textContent = STYLE;
    root.innerHTML = BODY;
    root.prepend(style);
    [this.canvas, this.bar, this.message, this.poster] = ["canvas", ".bar", ".message", ".poster"].map((part) => root.querySelector(part));
    [this.button, this.slider, this.clock] = ["button", "input", "span"].map((part) => this.bar.querySelector(part));
    this.button.addEventListener("click", () => this.toggle());
    const vr = this.bar.querySelector(".vr");
    vr.addEventListener("click", () => this.enterVR().catch((error) => this.show(error)));
    offersHeadset().then((has) => (vr.hidden = !has));
    this.slider.addEventListener("input", () => (this.currentTime = Number(this.slider.value)));
    this.canvas.addEventListener("keydown", (e) => this.pressed(e));
    /** The player, while the element is in a page. */
    this.player = null;
  }

  connectedCallback() {
    if (this.player) return;
    try {
      const room = this.hasAttribute("room") ? Number(this.getAttribute("room")) : undefined;
      this.player = new Player(this.canvas, { interactive: !this.hasAttribute("still-camera"), bounded: !this.hasAttribute("free"), room });
    } catch (error) {
      this.show(error);
      return;
    }
    for (const name of EVENTS) {
      this.player.addEventListener(name, ({ error, interval }) => {
        this.heard(name, error);
        this.dispatchEvent(Object.assign(new Event(name), { error, interval }));
      });
    }
    this.player.addEventListener("tap", () => this.hasAttribute("controls") && this.toggle());
    for (const name of StreamsplatPlayer.observedAttributes) this.attributeChangedCallback(name, null, this.getAttribute(name));
  }

  disconnectedCallback() {
    // An element that is only moved is reconnected at once.
    queueMicrotask(() => {
      if (this.isConnected) return;
      this.player?.close();
      this.player = null;
    });
  }

  attributeChangedCallback(name, before, value) {
    const { player } = this;
    if (name === "controls") this.bar.hidden = value === null;
    if (!player || (value === null && name !== "loop")) return;
    try {
      if (name === "src" && value !== before) this.load(value).catch(() => {});
      if (name === "loop") player.loop = value !== null;
      if (name === "background") player.background = Number.isNaN(Number(value)) ? value : Number(value);
      if (name === "playbackrate") player.playbackRate = Number(value) || 1;
      if (name === "mode") player.mode = value;
    } catch (error) {
      this.show(error);
    }
  }

  /** Shows a container: an address, a File or another Blob, or bytes. */
  async load(source) {
    if (!this.player) throw new Error("load: expected an element in a page, found one outside");
    this.message.hidden = true;
    await this.player.load(source);
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (this.hasAttribute("autoplay") && !still) this.player.play();
  }

  play() {
    this.player?.play();
  }

  pause() {
    this.player?.pause();
  }

  toggle() {
    if (this.paused) this.play();
    else this.pause();
  }

  seek(seconds) {
    return this.player ? this.player.seek(seconds) : Promise.resolve();
  }

  look(view) {
    this.player?.look(view);
  }

  home() {
    this.player?.home();
  }

  async enterVR() {
    await this.player?.enterVR();
  }

  async leaveVR() {
    await this.player?.leaveVR();
  }

  get view() {
    return this.player?.view ?? null;
  }

  get src() {
    return this.getAttribute("src") ?? "";
  }

  set src(address) {
    this.setAttribute("src", address);
  }

  get currentTime() {
    return this.player?.currentTime ?? 0;
  }

  set currentTime(seconds) {
    this.seek(seconds);
  }

  get duration() {
    return this.player?.duration ?? NaN;
  }

  get paused() {
    return this.player?.paused ?? true;
  }

  get ended() {
    return this.player?.ended ?? false;
  }

  /** Updates the element after a player's event. */
  heard(name, error) {
    const { player } = this;
    if (name === "loadeddata") this.poster.hidden = true;
    if (name === "loadedmetadata") {
      const { source } = player.clip.placement;
      this.style.aspectRatio ||= `${source[1]} / ${source[0]}`;
      [this.slider.max, this.slider.value] = [player.duration, 0];
    }
    if (name === "play" || name === "pause") {
      this.button.setAttribute("aria-label", player.paused ? "Play" : "Pause");
      this.button.querySelector("path").setAttribute("d", player.paused ? PLAY : PAUSE);
    }
    if (name === "timeupdate" || name === "loadedmetadata") {
      const clock = `${player.currentTime.toFixed(1)} / ${player.duration.toFixed(1)} s`;
      if (this.clock.textContent !== clock) this.clock.textContent = clock;
      this.slider.value = player.currentTime;
    }
    if (name === "error") this.show(error);
    if (name === "seeked" || name === "loadeddata") this.message.hidden = true;
  }

  show(error) {
    this.message.textContent = error.message;
    this.message.hidden = false;
  }

  pressed(e) {
    const { player } = this;
    if (!player?.clip || !this.hasAttribute("controls") || e.ctrlKey || e.metaKey || e.altKey) return;
    const act = {
      " ": () => this.toggle(),
      ArrowLeft: () => this.seek(player.currentTime - 1 / player.fps),
      ArrowRight: () => this.seek(player.currentTime + 1 / player.fps),
      Home: () => this.seek(0),
      End: () => this.seek(player.duration),
      r: () => this.home(),
    }[e.key];
    if (!act) return;
    e.preventDefault();
    act();
  }
}

customElements.define("streamsplat-player", StreamsplatPlayer);
