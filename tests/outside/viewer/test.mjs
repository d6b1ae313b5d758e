// test.mjs NODE-MODULES STREAMSPLAT SCRATCH-FOLDER; from the repository's root.
//
// What the viewer does otherwise, and how far that shows: it cuts every Gaussian at √8 standard deviations (ours go on to α = 1/255),
// blends in bytes, and projects in binary32. Ours is the render of the same file: that of the scene folder widens its Gaussians by the zoom,
// which a file for other programs cannot ask for.

import { createReadStream, readFileSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { resolve } from "node:path";
import { check, chromium, open, psnr, run } from "../browser.mjs";

const [modules, streamsplat, scratch] = process.argv.slice(2);
const SIZE = [640, 360];
const ENOUGH = 36;
/** From where the whole scene is in view: what lies across an edge of the picture, the viewer leaves out by another rule. */
const CAMERAS = {
  "from the left": { position: [-1.6, -0.7, -2.2], look_at: [0, 0, 0.3] },
  "from the lower right": { position: [1.4, 1.2, -2.4], look_at: [0.1, 0, 0.3] },
};
/** The embedded model's Gaussians are many and nearly in one plane; those of a small model with seeded weights few, large, and at all depths. */
const SCENES = { embedded: [], seeded: ["--model", "fixtures/parity/tiny-nodino.safetensors"] };
const TIME = "0.06";

/** Serves the test's files, and the packages. */
const KINDS = { html: "text/html", js: "text/javascript", json: "application/json" };
const server = createServer((request, response) => {
  const path = decodeURIComponent(new URL(request.url, "http://here").pathname);
  const own = { "/": "tests/outside/viewer/viewer.html", "/scene.ply": `${scratch}/scene.ply`, "/camera.json": `${scratch}/camera.json` };
  const file = own[path] ?? resolve(modules, `.${path}`);
  response.setHeader("Content-Type", KINDS[file.split(".").pop()] ?? "application/octet-stream");
  createReadStream(file).on("error", () => response.writeHead(404).end()).pipe(response);
});
await new Promise((listening) => server.listen(0, "127.0.0.1", listening));
const address = `http://127.0.0.1:${server.address().port}/`;

const browser = await chromium(modules);
const other = await browser.newPage();
for (const [scene, model] of Object.entries(SCENES)) {
  const folder = `${scratch}/${scene}`;
  run(streamsplat, "run", "fixtures/clips/moving.y4m", "--frames", "5", "--gap", "4", ...model, "--emit", "scene", "--quiet", "--out", folder);
  run(streamsplat, "export", folder, "--format", "ply", "--times", TIME, "--quiet", "--out", `${scratch}/scene.ply`);
  const wanted = Number(/element vertex (\d+)/.exec(readFileSync(`${scratch}/scene.ply`, "latin1"))[1]);
  for (const [name, pose] of Object.entries(CAMERAS)) {
    const camera = { type: "pinhole", ...pose, fov_y_degrees: 45, aspect: SIZE[0] / SIZE[1] };
    writeFileSync(`${scratch}/camera.json`, JSON.stringify(camera));
    const options = ["--camera", `${scratch}/camera.json`, "--size", SIZE.join("x"), "--background", "0"];
    run(streamsplat, "render", `${scratch}/scene.ply`, ...options, "--quiet", "--out", `${scratch}/ours`);
    const log = { said: [], asked: [] };
    const page = await open(browser, SIZE, log);
    await page.goto(address);
    await page.waitForFunction(() => document.body.dataset.splats);
    const splats = Number(await page.evaluate(() => document.body.dataset.splats));
    const theirs = await page.screenshot();
    await page.close();
    check(splats === wanted, `expected ${wanted} Gaussians, the viewer has ${splats}: ${log.said.join("; ")}`);
    const dB = await psnr(other, theirs, `${scratch}/ours/frames/000000.png`);
    console.log(`${scene} ${name}: ${splats} Gaussians, ${dB.toFixed(1)} dB`);
    check(dB >= ENOUGH, `${scene} ${name}: expected ${ENOUGH} dB beside our render, found ${dB}; ${log.said.join("; ")}`);
  }
}
await browser.close();
server.close();
