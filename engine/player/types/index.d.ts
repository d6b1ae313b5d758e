import type { Source } from "./clip.js";
import type { Player, View } from "./player.js";

export { Clip, type ClipOptions, type Placement, type Source } from "./clip.js";
export { Player, type Colour, type Mode, type PlayerErrorEvent, type PlayerEvents, type PlayerOptions, type View } from "./player.js";

/** Whether this browser has a headset that a scene can be shown in. */
export function offersHeadset(): Promise<boolean>;

/** `<streamsplat-player src="clip.ssz" autoplay loop controls>`: importing the package defines it. */
export class StreamsplatPlayer extends HTMLElement {
  src: string;
  currentTime: number;
  readonly duration: number;
  readonly paused: boolean;
  readonly ended: boolean;
  readonly view: View | null;
  /** Null while the element is in no page. */
  readonly player: Player | null;
  load(source: Source): Promise<void>;
  play(): void;
  pause(): void;
  toggle(): void;
  seek(seconds: number): Promise<void>;
  look(view: Partial<View>): void;
  home(): void;
  enterVR(): Promise<void>;
  leaveVR(): Promise<void>;
}

declare global {
  interface HTMLElementTagNameMap {
    "streamsplat-player": StreamsplatPlayer;
  }
}
