import type { ClipOptions, Source } from "./clip.js";
import type { Playback } from "./placed.js";

/** A `THREE.Mesh` that shows a scene in time. */
export interface Splats extends Playback {
  dispose(): void;
}

/** A scene in time for a scene of three.js. `THREE` is the module `three`. */
export function load<T extends { Mesh: abstract new (...all: never[]) => unknown }>(
  THREE: T,
  source: Source,
  options?: ClipOptions,
): Promise<InstanceType<T["Mesh"]> & Splats>;
