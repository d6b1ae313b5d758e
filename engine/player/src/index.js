// The package: importing it defines the element; it also exports the element's parts.

export { Clip } from "./clip.js";
export { StreamsplatPlayer } from "./element.js";
export { offersHeadset } from "./headset.js";
export { Player } from "./player.js";
