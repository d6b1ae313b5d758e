import type { Clip, ClipOptions, Source } from "./clip.js";

/** A `THREE.Mesh` that shows a scene in time. */
export interface Splats {
  readonly clip: Clip;
  /** Width and height of the source's frames in the object's own units. */
  readonly size: [number, number];
  readonly duration: number;
  currentTime: number;
  readonly playing: boolean;
  readonly clock: { loop: boolean; rate: number };
  /** Called where something came that changes the picture. */
  onchange: () => void;
  play(): void;
  pause(): void;
  /** Takes the time further by some seconds while it plays. */
  update(seconds: number): void;
  dispose(): void;
}

/** A scene in time for a scene of three.js. `THREE` is the module `three`. */
export function load<T extends { Mesh: abstract new (...all: never[]) => unknown }>(
  THREE: T,
  source: Source,
  options?: ClipOptions,
): Promise<InstanceType<T["Mesh"]> & Splats>;
