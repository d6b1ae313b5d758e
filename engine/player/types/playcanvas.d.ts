import type { Clip, ClipOptions, Source } from "./clip.js";

/** A scene in time, and the entity that shows it. */
export interface Splats {
  /** A `pc.Entity`. */
  readonly entity: any;
  readonly clip: Clip;
  /** Width and height of the source's frames in the entity's own units. */
  readonly size: [number, number];
  readonly duration: number;
  currentTime: number;
  readonly playing: boolean;
  readonly clock: { loop: boolean; rate: number };
  /** Called where something came that changes the picture, and where an interval cannot be had. */
  onchange: () => void;
  onerror: (error: Error) => void;
  play(): void;
  pause(): void;
  /** Takes the time further by some seconds while it plays. */
  update(seconds: number): void;
  destroy(): void;
}

/** A scene in time for an application of PlayCanvas's engine on WebGL2. `pc` is the module `playcanvas`. */
export function load(pc: object, app: object, source: Source, options?: ClipOptions): Promise<Splats>;
