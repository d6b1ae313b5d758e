import type { ClipOptions, Source } from "./clip.js";
import type { Playback } from "./placed.js";

/** A scene in time, and the entity that shows it. */
export interface Splats extends Playback {
  /** A `pc.Entity`. */
  readonly entity: any;
  /** Called when an interval cannot be loaded. */
  onerror: (error: Error) => void;
  destroy(): void;
}

/** A scene in time for an application of PlayCanvas's engine on WebGL2. `pc` is the module `playcanvas`. */
export function load(pc: object, app: object, source: Source, options?: ClipOptions): Promise<Splats>;
