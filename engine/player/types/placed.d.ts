import type { Clip } from "./clip.js";

/** What the objects for other engines share. */
export interface Playback {
  readonly clip: Clip;
  /** Width and height of the source's frames in the object's own units. */
  readonly size: [number, number];
  readonly duration: number;
  currentTime: number;
  readonly playing: boolean;
  readonly clock: { loop: boolean; rate: number };
  /** Called when something was loaded that changes the picture. */
  onchange: () => void;
  play(): void;
  pause(): void;
  /** Advances the time by some seconds while it plays. */
  update(seconds: number): void;
}
