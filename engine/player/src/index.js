// The package: the element, which is defined by importing it, and what it is made of.

export { Clip } from "./clip.js";
export { StreamsplatPlayer } from "./element.js";
export { offersHeadset } from "./headset.js";
export { Player } from "./player.js";
