// A typed program that uses the player. It is compiled, not run.

import { Player, type PlayerOptions } from "../../../engine/player/types/index.js";
import { load as loadInto, type Splats } from "../../../engine/player/types/playcanvas.js";
import { load } from "../../../engine/player/types/three.js";

declare const canvas: HTMLCanvasElement;
const options: PlayerOptions = { background: "#202020", loop: true };
const player = new Player(canvas, options);
player.addEventListener("error", ({ error, interval }) => console.error(error.message, interval));
await player.load("clip.ssz");
await player.load(new Uint8Array(10));
player.look({ yaw: 10, lens: "perspective" });
player.background = 0.5;
const [red]: [number, number, number] = player.background;
const element = document.createElement("streamsplat-player");
await element.seek(1.5 + red);
element.player?.clip?.traffic.bytes.toFixed();

declare class Mesh {
  visible: boolean;
}
const mesh = await load({ Mesh }, new URL("clip.ssz", "https://example.org"), { room: 2 ** 25 });
mesh.visible = mesh.playing;
mesh.update(0.1);
const splats: Splats = await loadInto({}, {}, new Blob());
splats.entity.enabled = false;

// @ts-expect-error a mode that is none
player.mode = "color";
// @ts-expect-error a lens that is none
player.look({ lens: "fisheye" });
// @ts-expect-error no address
player.load(7);
