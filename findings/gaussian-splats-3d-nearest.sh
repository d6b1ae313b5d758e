#!/usr/bin/env bash
# Package: @mkkellogg/gaussian-splats-3d 0.4.7 (npm, with three 0.187.0), in Chromium, on a valid PLY file of 100 white Gaussians on a grid.
# Behaviour: the Gaussian nearest to the camera is not drawn, unless it is the last of the file. Of 100 dots facing the camera, 99 are drawn where depths grow
#   with the position in the file, and the first is missing. Where depths fall, 100 are drawn. The viewer's count of splats is 100 both times.
# Guess beforehand: 100 dots in both, as the order of the file has no meaning.
#
# Output of 2026-11-27:
#   nearest first in the file: 99 of 100 dots
#   nearest last in the file: 100 of 100 dots
#
# Needs node, npm and a Chromium at $CHROMIUM (/usr/bin/chromium, as Debian's package has it). Fails where the behaviour differs.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
npm init -y >/dev/null
npm install --silent --no-audit --no-fund @mkkellogg/gaussian-splats-3d@0.4.7 three@0.187.0 playwright-core@1.65.1
cat >page.html <<'HTML'
<!doctype html>
<style>body { margin: 0; background: #000; overflow: hidden; }</style>
<script type="importmap">{ "imports": { "three": "/node_modules/three/build/three.module.js" } }</script>
<script type="module">
import * as THREE from "three";
import * as Splats from "/node_modules/@mkkellogg/gaussian-splats-3d/build/gaussian-splats-3d.module.js";
const camera = new THREE.PerspectiveCamera(20, 1, 0.01, 100);
camera.up.set(0, -1, 0);
camera.position.set(0, 0, -10);
camera.lookAt(0, 0, 0);
camera.updateMatrixWorld();
const renderer = new THREE.WebGLRenderer({ preserveDrawingBuffer: true });
renderer.setSize(innerWidth, innerHeight);
document.body.append(renderer.domElement);
const viewer = new Splats.Viewer({
  renderer, camera, selfDrivenMode: false, useBuiltInControls: false, sharedMemoryForWorkers: false,
  enableSIMDInSort: false, gpuAcceleratedSort: false, sceneRevealMode: Splats.SceneRevealMode.Instant, logLevel: Splats.LogLevel.None,
});
await viewer.addSplatScene(location.search.slice(1), { format: Splats.SceneFormat.Ply, showLoadingUI: false, progressiveLoad: false });
const end = performance.now() + 3000;
(function draw() {
  viewer.update();
  viewer.render();
  if (performance.now() < end) requestAnimationFrame(draw);
  else document.body.dataset.shown = viewer.splatMesh.getSplatCount();
})();
</script>
HTML
cat >test.mjs <<'JS'
import { createReadStream, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { chromium } from "playwright-core";
const names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"];
const properties = names.map((name) => `property float ${name}\n`).join("");
for (const step of [1e-2, -1e-2]) {
  const rows = Array.from({ length: 100 }, (_, i) => [(i % 10 - 4.5) * 0.3, (Math.floor(i / 10) - 4.5) * 0.3, i * step, 1.7, 1.7, 1.7, 4, -4, -4, -4, 1, 0, 0, 0]);
  const head = `ply\nformat binary_little_endian 1.0\nelement vertex 100\n${properties}end_header\n`;
  writeFileSync(`step-${step}.ply`, Buffer.concat([Buffer.from(head), Buffer.from(Float32Array.from(rows.flat()).buffer)]));
}
const kinds = { html: "text/html", js: "text/javascript" };
const server = createServer(({ url }, response) => {
  const file = `.${new URL(url, "http://here").pathname}`;
  response.setHeader("Content-Type", kinds[file.split(".").pop()] ?? "application/octet-stream");
  createReadStream(file).on("error", () => response.writeHead(404).end()).pipe(response);
});
await new Promise((listening) => server.listen(0, "127.0.0.1", listening));
const args = ["--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"];
const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args });
/** Dots of a picture: bright pixels, those that touch taken together. */
const dots = async (step) => {
  const page = await browser.newPage({ viewport: { width: 400, height: 400 }, deviceScaleFactor: 1 });
  await page.goto(`http://127.0.0.1:${server.address().port}/page.html?step-${step}.ply`);
  await page.waitForFunction(() => document.body.dataset.shown === "100", null, { timeout: 120_000 });
  await page.waitForTimeout(1000);
  const png = (await page.screenshot()).toString("base64");
  return page.evaluate(async (png) => {
    const image = await createImageBitmap(await (await fetch(`data:image/png;base64,${png}`)).blob());
    const context = new OffscreenCanvas(image.width, image.height).getContext("2d");
    context.drawImage(image, 0, 0);
    const { data } = context.getImageData(0, 0, image.width, image.height);
    const seen = new Uint8Array(400 * 400);
    let found = 0;
    for (let first = 0; first < seen.length; first++) {
      if (seen[first] || data[4 * first] < 60) continue;
      found++;
      for (const left = [first]; left.length; ) {
        const at = left.pop();
        if (at < 0 || at >= seen.length || seen[at] || data[4 * at] < 60) continue;
        seen[at] = 1;
        left.push(at - 1, at + 1, at - 400, at + 400);
      }
    }
    return found;
  }, png);
};
const [first, last] = [await dots(1e-2), await dots(-1e-2)];
console.log(`nearest first in the file: ${first} of 100 dots\nnearest last in the file: ${last} of 100 dots`);
await browser.close();
server.close();
if (first !== 99 || last !== 100) process.exit(1);
JS
node test.mjs
