// test.mjs NODE-MODULES STREAMSPLAT SCRATCH-FOLDER; from the repository's root.
//
// Compares one scene, in every format we write and every viewer that opens it, with our render of the scene itself.
// Files with a wrong rotation, handedness or colour fail. docs/rasteriser.md describes the viewers' own differences;
// the bars below are a decibel or two under the measured values.

import { createReadStream, readFileSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { resolve } from "node:path";
import { check, chromium, open, picture, psnr, run } from "../browser.mjs";

const [modules, streamsplat, scratch] = process.argv.slice(2);
const SIZE = [480, 272];
const CAMERA = { position: [0.9, -0.6, -3.2], look_at: [0, 0, 0.2], up: [0, -1, 0], fov_y_degrees: 45 };
/** Least PSNR in decibels of each format in each viewer. A viewer does not open formats that are not listed. */
const BARS = {
  spark: { ply: 42, "compressed.ply": 42, spz: 40, sog: 42, splat: 44 },
  playcanvas: { ply: 49, "compressed.ply": 37, sog: 46, glb: 49 },
  babylon: { ply: 43, "compressed.ply": 43, spz: 43, sog: 42, glb: 43, splat: 46 },
  gaussiansplats3d: { ply: 33, "compressed.ply": 34, splat: 35 },
  threejs: { ply: 30, spz: 30, glb: 30, splat: 30 },
};
/** Largest PSNR in decibels of a scene rotated by half a turn. */
const TURNED = 18;
/** Measurements of the probe, and their tolerances. */
const FACTS = {
  ours: { end: 3.3, last: 1, middle: 229, bright: 204, light: 248 },
  "ours with --antialias": { options: ["--antialias"], end: 3.3, last: 1, middle: 229, bright: 204, light: 4 },
  spark: { end: 2.95, last: 4, middle: 230, bright: 102, light: 8 },
  playcanvas: { end: 2.75, last: 1, middle: 229, bright: 204, light: 0 },
  babylon: { end: 2.85, last: 4, middle: 230, bright: 102, light: 70 },
  threejs: { end: 2, last: 100, middle: 244, bright: 170, light: 71 },
};
const NEAR = { end: () => 0.06, last: (x) => 1 + 0.1 * x, middle: () => 2, bright: () => 2, light: (x) => 3 + 0.1 * x };

/** A PLY file of Gaussians, each its properties by name. */
function plyOf(gaussians) {
  const names = Object.keys(gaussians[0]);
  const head = `ply\nformat binary_little_endian 1.0\nelement vertex ${gaussians.length}\n${names.map((name) => `property float ${name}\n`).join("")}end_header\n`;
  const values = gaussians.flatMap((gaussian) => names.map((name) => gaussian[name]));
  return Buffer.concat([Buffer.from(head), Buffer.from(Float32Array.from(values).buffer)]);
}

/** Values as properties that are numbered. */
const numbered = (name, values) => Object.fromEntries(values.map((value, i) => [`${name}${i}`, value]));

/** Gaussians of all shapes and colours, with harmonics of degree 1, which look different from every side. */
function scene(count) {
  let state = 1;
  const random = () => ((state = (Math.imul(state, 1664525) + 1013904223) >>> 0) / 2 ** 32) * 2 - 1;
  const some = (length, value) => Array.from({ length }, value);
  return some(count, () => {
    const [x, y, z] = [random() + 0.3, 0.6 * random() - 0.1, random()];
    // Redder to the right, greener below, bluer behind.
    const colour = [x, y, z].map((at) => 1.5 * at + 0.4 * random());
    const harmonics = some(9, () => 0.15 * random());
    const opacity = 1 + 2 * random();
    const scale = some(3, () => -2.6 + 0.8 * random());
    return { x, y, z, ...numbered("f_dc_", colour), ...numbered("f_rest_", harmonics), opacity, ...numbered("scale_", scale), ...numbered("rot_", some(4, random)) };
  });
}

/** The viewers' own conventions show in three places: a large Gaussian, one brighter than white, and 400 far smaller than a pixel. */
const PROBE = { position: [0, 0, -10], look_at: [0, 0, 0], up: [0, -1, 0], fov_y_degrees: (360 / Math.PI) * Math.atan(SIZE[1] / 2000) };
const [LARGE, BRIGHT, SMALL, SIGMA] = [[120, 80], [360, 80], [240, 220], 20];
function probe() {
  let z = 0.4;
  const at = ([x, y], colour, opacity, pixels) => {
    const place = { x: (x - SIZE[0] / 2) / 100, y: (y - SIZE[1] / 2) / 100, z: (z -= 1e-3) };
    const f_dc = [colour, colour, colour].map((c) => (c - 0.5) / 0.28209479177387814);
    const scale = Math.log(pixels / 100);
    return { ...place, ...numbered("f_dc_", f_dc), opacity: Math.log(opacity / (1 - opacity)), ...numbered("scale_", [scale, scale, scale]), ...numbered("rot_", [1, 0, 0, 0]) };
  };
  const small = Array.from({ length: 400 }, (_, i) => at([SMALL[0] + 4 * ((i % 40) - 20) + 0.5, SMALL[1] + 4 * (Math.floor(i / 40) - 5) + 0.5], 1, 0.5, 0.1));
  return [...small, at(BRIGHT, 2, 0.4, SIGMA), at(LARGE, 1, 0.9, SIGMA)];
}

/** Measures a picture of the probe: standard deviations to the end of the large one, its last value, the middle value of the grey one, and the light of the small ones. */
const facts = (page, png) =>
  page.evaluate(
    async ([png, [large, bright, small, sigma]]) => {
      const bytes = Uint8Array.from(atob(png), (c) => c.charCodeAt(0));
      const image = await createImageBitmap(new Blob([bytes], { type: "image/png" }));
      const context = new OffscreenCanvas(image.width, image.height).getContext("2d");
      context.drawImage(image, 0, 0);
      const { data } = context.getImageData(0, 0, image.width, image.height);
      const red = (x, y) => data[4 * (y * image.width + x)];
      let [end, light] = [0, 0];
      while (red(large[0] + end, large[1]) > 0) end++;
      for (let y = small[1] - 30; y < image.height; y++) for (let x = 0; x < image.width; x++) light += red(x, y);
      return { end: end / sigma, last: red(large[0] + end - 1, large[1]), middle: red(...large), bright: red(...bright), light: light / 400 };
    },
    [png.toString("base64"), [LARGE, BRIGHT, SMALL, SIGMA]],
  );

/** Serves this folder, the packages and the scene. */
const KINDS = { html: "text/html", js: "text/javascript", mjs: "text/javascript", wasm: "application/wasm" };
const server = createServer((request, response) => {
  const path = decodeURIComponent(new URL(request.url, "http://here").pathname);
  const [, first, ...rest] = path.split("/");
  const folders = { viewers: "tests/outside/viewers", scene: scratch };
  const file = folders[first] ? resolve(folders[first], rest.join("/")) : resolve(modules, `.${path}`);
  response.setHeader("Content-Type", KINDS[file.split(".").pop()] ?? "application/octet-stream");
  createReadStream(file).on("error", () => response.writeHead(404).end()).pipe(response);
});
await new Promise((listening) => server.listen(0, "127.0.0.1", listening));
const address = `http://127.0.0.1:${server.address().port}`;

const ply = `${scratch}/scene.ply`;
writeFileSync(ply, plyOf(scene(400)));
for (const format of ["compressed-ply", "spz", "sog", "glb", "splat"]) {
  run(streamsplat, "export", ply, "--format", format, "--quiet", "--out", `${scratch}/scene.${format.replace("-", ".")}`);
}
/** Our picture of a file. */
const ours = (name, file, { up, ...camera }, ...options) => {
  writeFileSync(`${scratch}/camera.json`, JSON.stringify({ type: "pinhole", ...camera, aspect: SIZE[0] / SIZE[1] }));
  const more = ["--camera", `${scratch}/camera.json`, "--size", SIZE.join("x"), "--background", "0", "--quiet", ...options];
  run(streamsplat, "render", file, ...more, "-o", `${scratch}/${name}.png`);
  return `${scratch}/${name}.png`;
};
const rights = ["gaussian", "playcanvas"].map((footprint) => ours(footprint, ply, CAMERA, "--footprint", footprint));
/** The expected picture: PlayCanvas's footprints end like ours with that option, and .splat has no harmonics. */
const right = (viewer, format) => (viewer === "playcanvas" ? rights[1] : format === "splat" ? plain : rights[0]);
const flat = scene(400).map((gaussian) => Object.fromEntries(Object.entries(gaussian).filter(([name]) => !name.startsWith("f_rest_"))));
writeFileSync(`${scratch}/flat.ply`, plyOf(flat));
const plain = ours("plain", `${scratch}/flat.ply`, CAMERA);
writeFileSync(`${scratch}/probe.ply`, plyOf(probe()));

const browser = await chromium(modules);
const other = await browser.newPage();
const failures = [];

/** A viewer's picture of a file. */
async function shown(viewer, file, view) {
  const log = { said: [], asked: [] };
  const page = await open(browser, SIZE, log);
  const query = [viewer, `/scene/${file}`, JSON.stringify(view)].map(encodeURIComponent).join("&");
  try {
    await page.goto(`${address}/viewers/viewer.html?${query}`);
    await page.waitForFunction(() => document.body.dataset.shown, null, { timeout: 30_000 });
    return await picture(page);
  } catch (error) {
    failures.push(`${viewer} ${file}: ${error.message.split("\n")[0]}; ${log.said.join("; ")}`);
    return null;
  } finally {
    const elsewhere = log.asked.filter((url) => !url.startsWith(address) && !/^(data|blob):/.test(url));
    if (elsewhere.length > 0) failures.push(`${viewer} ${file}: asked ${elsewhere.join(", ")}`);
    await page.close();
  }
}

for (const [viewer, formats] of Object.entries(BARS)) {
  for (const [format, bar] of Object.entries(formats)) {
    // glTF's axes are x left, y up, z forward; all others are the scene's own.
    const turn = ([x, y, z]) => (format === "glb" ? [-x, -y, z] : [x, y, z]);
    const [position, look_at, up] = [CAMERA.position, CAMERA.look_at, CAMERA.up].map(turn);
    const theirs = await shown(viewer, `scene.${format}`, { ...CAMERA, position, look_at, up, linear: true });
    if (!theirs) continue;
    const dB = await psnr(other, theirs, right(viewer, format));
    console.log(`${viewer} ${format}: ${dB.toFixed(1)} dB`);
    if (!(dB >= bar)) failures.push(`${viewer} ${format}: expected ${bar} dB, found ${dB.toFixed(1)}`);
  }
}
for (const [viewer, expected] of Object.entries(FACTS)) {
  const here = viewer.startsWith("ours");
  const theirs = here ? readFileSync(ours("probe", `${scratch}/probe.ply`, PROBE, ...(expected.options ?? []))) : await shown(viewer, "probe.ply", PROBE);
  if (!theirs) continue;
  const found = await facts(other, theirs);
  const text = Object.entries(found).map(([name, value]) => `${name} ${value.toFixed(2)}`);
  console.log(`${viewer}: ${text.join(", ")}`);
  for (const [name, within] of Object.entries(NEAR)) {
    const wanted = expected[name];
    if (Math.abs(found[name] - wanted) > within(wanted)) failures.push(`${viewer}: expected ${name} ${wanted}, found ${found[name].toFixed(2)}`);
  }
}
// An upside-down scene does not match.
const turned = await psnr(other, ours("turned", ply, { ...CAMERA, position: CAMERA.position.map((x, axis) => (axis ? -x : x)), look_at: CAMERA.look_at.map((x, axis) => (axis ? -x : x)) }), rights[0]);
console.log(`half a turn about x: ${turned.toFixed(1)} dB`);
check(turned < TURNED, `expected less than ${TURNED} dB of a scene half a turn away, found ${turned}`);
await browser.close();
server.close();
check(failures.length === 0, failures.join("\n"));
