import type { Clip, Source } from "./clip.js";

export type Mode = "colour" | "depth" | "identity";
/** One level of grey from 0 to 1, red, green and blue from 0 to 1, or #rrggbb. */
export type Colour = number | [number, number, number] | string;

export interface View {
  /** Angles in degrees; 0 and 0 are the source's own. */
  yaw: number;
  pitch: number;
  /** Magnification. */
  zoom: number;
  /** What the camera looks at, moved right, down and forward; half the model input's height is 1. */
  x: number;
  y: number;
  z: number;
  lens: "parallel" | "perspective";
}

export interface PlayerOptions {
  background?: Colour;
  loop?: boolean;
  rate?: number;
  /** Bytes of packets that are kept at most (64 MiB unless set). */
  room?: number;
  /** Gaussians of an interval at most. */
  gaussians?: number;
  /** Whether drags, two fingers and the wheel move the camera (true unless set). */
  interactive?: boolean;
  /** Whether drags are resisted beyond 15 degrees, as the scene was filmed from one side (true unless set). */
  bounded?: boolean;
}

/** An error, and the interval it is about, if any. */
export interface PlayerErrorEvent extends Event {
  error: Error;
  interval?: number;
}

export interface PlayerEvents {
  loadedmetadata: Event;
  /** The first picture is drawn. */
  loadeddata: Event;
  play: Event;
  pause: Event;
  /** An interval that is needed is not loaded yet; it was loaded. */
  waiting: Event;
  playing: Event;
  seeking: Event;
  seeked: Event;
  timeupdate: Event;
  ended: Event;
  error: PlayerErrorEvent;
  /** The camera was moved. */
  viewchange: Event;
  /** The canvas was touched without a drag. */
  tap: Event;
  /** The scene is shown in a headset; it is no longer. */
  vrenter: Event;
  vrleave: Event;
}

/** A scene in time on a canvas. */
export class Player extends EventTarget {
  constructor(canvas: HTMLCanvasElement, options?: PlayerOptions);
  /** Resolves when the index is read; the scene before is shown until then. */
  load(source: Source): Promise<void>;
  play(): void;
  pause(): void;
  /** Shows a time, in seconds since the start; resolves when its picture is drawn. */
  seek(seconds: number): Promise<void>;
  /** Sets what is named of the view. */
  look(view?: Partial<View>): void;
  /** Back to the source's own view. */
  home(): void;
  /** Shows the scene in a headset (WebXR), two metres ahead; in answer to a click. Resolves when it is entered. */
  enterVR(): Promise<void>;
  leaveVR(): Promise<void>;
  /** Ends everything. */
  close(): void;
  currentTime: number;
  readonly duration: number;
  readonly paused: boolean;
  readonly ended: boolean;
  readonly seeking: boolean;
  readonly fps: number;
  readonly view: View;
  loop: boolean;
  playbackRate: number;
  get background(): [number, number, number];
  set background(colour: Colour);
  mode: Mode;
  /** Null before a scene is there. */
  readonly clip: Clip | null;
  /** Pictures drawn so far. */
  readonly pictures: number;
  /** The part of a side's pixels that is drawn: less than 1 while drawing is too slow. */
  readonly detail: number;
  addEventListener<K extends keyof PlayerEvents>(type: K, listener: (event: PlayerEvents[K]) => void, options?: boolean | AddEventListenerOptions): void;
  addEventListener(type: string, listener: EventListenerOrEventListenerObject | null, options?: boolean | AddEventListenerOptions): void;
}
