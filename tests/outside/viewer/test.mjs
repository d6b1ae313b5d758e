// test.mjs NODE-MODULES STREAMSPLAT SCRATCH-FOLDER; from the repository's root.
// Differences of the viewer: it cuts every Gaussian at √8 standard deviations (ours extend to α = 1/255), blends in bytes, and projects in binary32. Our
// picture is the render of the same file: a render of the scene folder widens its Gaussians where it is enlarged, which a file for other programs cannot
// request.

import { createReadStream, readFileSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { resolve } from "node:path";
import { check, chromium, open, picture, psnr, run } from "../browser.mjs";

const [modules, streamsplat, scratch] = process.argv.slice(2);
const SIZE = [640, 360];
const ENOUGH = 36;
/** A view of the whole scene: the viewer has another rule for Gaussians across an edge of the picture. */
const CAMERAS = {
  "from the left": { position: [-1.6, -0.7, -2.2], look_at: [0, 0, 0.3] },
  "from the lower right": { position: [1.4, 1.2, -2.4], look_at: [0.1, 0, 0.3] },
};
/** From the front, where nothing is drawn larger than in the model: the scene, its file, and the file in the viewer have the same picture. */
const FRONT = { position: [0, 0, -5.8], look_at: [0, 0, 0.3] };
/** The embedded model's Gaussians are many and nearly in one plane; those of a small model with seeded weights are few, large, and at all depths. */
const CLIP = "fixtures/clips/moving.y4m"; // 256×144
const SCENES = {
  embedded: { clip: CLIP, shape: 16 / 9 },
  upright: { clip: `${scratch}/upright.y4m`, shape: 9 / 16 },
  seeded: { clip: CLIP, model: ["--model", "fixtures/parity/tiny-nodino.safetensors"] },
};
const TIME = "0.06";

/** A clip in 4:2:0 with rows and columns exchanged. */
function turned(y4m) {
  const header = y4m.subarray(0, y4m.indexOf("\n") + 1).toString();
  const [width, height] = ["W", "H"].map((side) => Number(new RegExp(` ${side}(\\d+)`).exec(header)[1]));
  const parts = [Buffer.from(header.replace(/ W\d+ H\d+/, ` W${height} H${width}`))];
  for (let at = header.length; at < y4m.length; ) {
    parts.push(Buffer.from("FRAME\n"));
    at = y4m.indexOf("\n", at) + 1;
    for (const half of [1, 2, 2]) {
      const [w, h] = [width / half, height / half];
      parts.push(Buffer.from(Uint8Array.from({ length: w * h }, (_, i) => y4m[at + (i % h) * w + Math.floor(i / h)])));
      at += w * h;
    }
  }
  return Buffer.concat(parts);
}

/** Width and height of the area that is not black in a picture of the viewer. */
const extent = (page, picture) =>
  page.evaluate(async (picture) => {
    const bytes = Uint8Array.from(atob(picture), (c) => c.charCodeAt(0));
    const image = await createImageBitmap(new Blob([bytes], { type: "image/png" }));
    const context = new OffscreenCanvas(image.width, image.height).getContext("2d");
    context.drawImage(image, 0, 0);
    const { data } = context.getImageData(0, 0, image.width, image.height);
    const lit = { x: [], y: [] };
    for (let i = 0; i < image.width * image.height; i++) {
      if (Math.max(...data.subarray(4 * i, 4 * i + 3)) < 24) continue;
      lit.x.push(i % image.width);
      lit.y.push(Math.floor(i / image.width));
    }
    // Half a percent on either side is ignored: it may be a stray Gaussian.
    return [lit.x, lit.y].map((places) => {
      places.sort((a, b) => a - b);
      return places[Math.floor(0.995 * places.length)] - places[Math.floor(0.005 * places.length)];
    });
  }, picture.toString("base64"));

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
writeFileSync(`${scratch}/upright.y4m`, turned(readFileSync(CLIP)));
for (const [scene, { clip, shape, model = [] }] of Object.entries(SCENES)) {
  const folder = `${scratch}/of-${scene}`;
  run(streamsplat, "run", clip, "--frames", "5", "--gap", "4", ...model, "--emit", "scene", "--quiet", "--out", folder);
  run(streamsplat, "export", folder, "--format", "ply", "--times", TIME, "--quiet", "--out", `${scratch}/scene.ply`);
  const wanted = Number(/element vertex (\d+)/.exec(readFileSync(`${scratch}/scene.ply`, "latin1"))[1]);
  for (const [name, pose] of Object.entries(shape ? { "from the front": FRONT, ...CAMERAS } : CAMERAS)) {
    const camera = { type: "pinhole", ...pose, fov_y_degrees: 45, aspect: SIZE[0] / SIZE[1] };
    writeFileSync(`${scratch}/camera.json`, JSON.stringify(camera));
    const options = ["--camera", `${scratch}/camera.json`, "--size", SIZE.join("x"), "--background", "0"];
    run(streamsplat, "render", `${scratch}/scene.ply`, ...options, "--quiet", "--out", `${scratch}/ours`);
    const log = { said: [], asked: [] };
    const page = await open(browser, SIZE, log);
    await page.goto(address);
    await page.waitForFunction(() => document.body.dataset.splats);
    const splats = Number(await page.evaluate(() => document.body.dataset.splats));
    const theirs = await picture(page);
    await page.close();
    check(splats === wanted, `expected ${wanted} Gaussians, the viewer has ${splats}: ${log.said.join("; ")}`);
    const dB = await psnr(other, theirs, `${scratch}/ours/frames/000000.png`);
    console.log(`${scene} ${name}: ${splats} Gaussians, ${dB.toFixed(1)} dB`);
    check(dB >= ENOUGH, `${scene} ${name}: expected ${ENOUGH} dB beside our render, found ${dB}; ${log.said.join("; ")}`);
    if (pose !== FRONT) continue;
    run(streamsplat, "render", folder, "--times", TIME, ...options, "--quiet", "--out", `${scratch}/scene`);
    const same = await psnr(other, theirs, `${scratch}/scene/frames/000000.png`);
    const [width, height] = await extent(other, theirs);
    console.log(`${scene} ${name}: ${same.toFixed(1)} dB beside the scene, ${width}×${height} pixels for a picture of ${shape.toFixed(3)}`);
    check(same >= ENOUGH, `${scene} ${name}: expected ${ENOUGH} dB beside our render of the scene, found ${same}`);
    check(Math.abs(width / height / shape - 1) < 0.1, `${scene}: expected the proportions ${shape}, found ${width}×${height}`);
  }
}
await browser.close();
server.close();
