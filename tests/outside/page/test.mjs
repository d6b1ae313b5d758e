// test.mjs NODE-MODULES STREAMSPLAT SCRATCH-FOLDER; from the repository's root.

import { once } from "node:events";
import { readFileSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { basename } from "node:path";
import { gzipSync } from "node:zlib";
import { check, chromium, differing, open, picture, psnr, run, start } from "../browser.mjs";
import { documented, metaChanged } from "./files.mjs";

const [modules, streamsplat, scratch] = process.argv.slice(2);
const CLIP = "fixtures/clips/moving.y4m"; // 256×144
const SIZE = [640, 360];
/** PSNR of the page's own pictures against ours: quantisation for the page and 16-bit sums leave more than 50 dB. */
const ENOUGH = 45;
/** The same for still scenes, whose packets are finer. */
const STILL = 50;

const scene = `${scratch}/scene`;
// With found depth, so that thickness matters from the side.
run(streamsplat, "run", CLIP, "--gap", "4", "--frames", "13", "--depth", "auto", "--emit", "scene", "--quiet", "--out", scene);
const browser = await chromium(modules);
const log = { said: [], asked: [] };
const page = await open(browser, SIZE, log);
const other = await browser.newPage();

/** Waits until the picture at `time` is on the screen. */
const shown = (page, time) => page.waitForFunction((time) => document.getElementById("canvas").dataset.shown === String(time), time);

/** The page at the address's view. */
async function visit(page, address, said) {
  // A picture of the previous view may have the same time.
  await page.evaluate(() => delete document.getElementById("canvas")?.dataset.shown);
  await page.goto(`${address}#${new URLSearchParams(said)}`);
  await shown(page, said.t);
}

/** The picture on the page, and ours at the same time from the same camera. */
async function compare(page, address, said, source = scene) {
  await visit(page, address, { interface: "none", background: 0.5, ...said });
  const theirs = await picture(page);
  await page.keyboard.press("?");
  const camera = await page.locator("#camera").inputValue();
  await page.keyboard.press("Escape");
  writeFileSync(`${scratch}/camera.json`, camera);
  const [width, height] = SIZE;
  const from = said.canonical ? [] : ["--camera", `${scratch}/camera.json`];
  const options = ["--times", String(said.t), "--size", `${width}x${height}`, "--quiet", "--out", `${scratch}/ours`];
  run(streamsplat, "render", source, ...from, ...options);
  return { theirs, dB: await psnr(other, theirs, `${scratch}/ours/frames/000000.png`) };
}

async function pictures(address) {
  const cameras = {
    "the source's view": { canonical: true },
    "perspective from the side": { yaw: -20, pitch: 10, zoom: 1.3, x: 0.2, lens: "perspective" },
  };
  for (const [name, camera] of Object.entries(cameras)) {
    for (const t of [0.1, 0.43]) {
      const { dB } = await compare(page, address, { t, ...camera });
      console.log(`${name} at ${t} s: ${dB.toFixed(1)} dB`);
      check(dB >= ENOUGH, `${name} at ${t} s: expected ${ENOUGH} dB beside our render, found ${dB}`);
    }
  }
}

/** Colours that change, from both ends of the interval. */
async function changing() {
  const source = "fixtures/containers/version-1.ssz";
  const view = start(streamsplat, ["view", source, "--port", "0"], "stdout");
  const address = (await view.line).split(" ")[0];
  const pictures = [];
  for (const t of [0.002, 0.02, 0.04]) {
    const { theirs, dB } = await compare(page, address, { t, canonical: true }, source);
    console.log(`colours that change at ${t} s: ${dB.toFixed(1)} dB`);
    check(dB >= ENOUGH, `colours that change at ${t} s: expected ${ENOUGH} dB beside our render, found ${dB}`);
    pictures.push(theirs);
  }
  check((await psnr(other, pictures[0], pictures[2])) < 40, "colours change");
  view.child.kill("SIGINT");
  check((await view.ended) === 0, "Ctrl-C ends the server well");
}

async function controls(address) {
  await visit(page, address, { t: 0.1 });
  const time = () => page.locator("#canvas").getAttribute("data-shown").then(Number);
  const still = await picture(page);

  await page.locator("#time").fill("0.3");
  await shown(page, 0.3);
  check((await page.locator("#clock").textContent()).startsWith("0.30 / 0.50"), "the clock shows the slider's time");
  await page.locator("#play").click();
  await page.waitForFunction(() => Number(document.getElementById("canvas").dataset.shown) > 0.35);
  await page.locator("#play").click();
  const stopped = await time();
  await page.waitForTimeout(300);
  check((await time()) === stopped, "a paused scene stays");
  await page.locator("#canvas").click({ position: { x: 5, y: 200 }, button: "middle" });
  await page.keyboard.press("Home");
  await shown(page, 0);
  await page.keyboard.press("Shift+ArrowRight");
  await page.waitForFunction((end) => Math.abs(Number(document.getElementById("canvas").dataset.shown) - end) < 1e-9, 4 / 24);

  const pictures = [still];
  for (const mode of ["Depth", "Identity", "Colour"]) {
    await page.getByRole("button", { name: mode, exact: true }).click();
    check((await page.locator("#legend").isVisible()) === (mode === "Depth"), "the depth has a legend");
    pictures.push(await picture(page));
  }
  for (const [a, b] of [[1, 2], [2, 3], [1, 3]]) check((await psnr(other, pictures[a], pictures[b])) < 25, "modes differ");

  await page.mouse.move(300, 150);
  await page.mouse.down();
  await page.mouse.move(400, 150, { steps: 4 });
  await page.mouse.up();
  await page.waitForFunction(() => location.hash.includes("yaw=-"));
  await page.getByRole("button", { name: "Source view" }).click();
  await page.waitForFunction(() => !location.hash.includes("yaw="));
  // An entered address counts, though the page was about to write its own.
  await page.evaluate(() => {
    location.hash = "t=0.3";
    history.replaceState(null, "", "#t=0.1");
  });
  await shown(page, 0.3);
}

/** A click selects the identity that `streamsplat track` finds, where the page has the source's size. */
async function picking(address) {
  const small = await open(browser, [256, 144], log);
  await visit(small, address, { t: 0.25, interface: "none" });
  for (const [x, y] of [[128, 72], [30, 20], [150, 110]]) {
    await small.mouse.click(x, y);
    const found = await small.locator("#identity").textContent();
    run(streamsplat, "track", scene, "--at", "0.25", "--point", `${x - 0.5},${y - 0.5}`, "--times", "0.25", "--json", `${scratch}/track.json`);
    const { identity } = JSON.parse(readFileSync(`${scratch}/track.json`));
    check(found === String(identity), `the pixel ${x},${y}: expected identity ${identity}, found ${found}`);
  }
  await small.close();
}

/** The same picture from a file, which makes no requests. */
async function file(address) {
  const html = `${scratch}/scene.html`;
  run(streamsplat, "view", scene, "--html", html, "--url", "https://example.org/p/scene.html");
  check(readFileSync(`${scratch}/scene.png`).subarray(1, 4).toString() === "PNG", "a poster lies beside the file");
  const { theirs, dB } = await compare(page, address, { t: 0.2, yaw: 10, zoom: 0.8 });
  check(dB >= ENOUGH, `parallel rays from the side: expected ${ENOUGH} dB beside our render, found ${dB}`);
  const before = log.asked.length;
  const alone = await open(browser, SIZE, log);
  await visit(alone, `file://${html}`, { t: 0.2, yaw: 10, zoom: 0.8, interface: "none", background: 0.5 });
  const like = await psnr(other, await picture(alone), theirs);
  console.log(`a file beside what is served: ${like.toFixed(1)} dB`);
  check(like >= 40, `expected a file to show what is served, found ${like} dB`);
  check((await alone.locator("#poster").count()) === 0, "the picture takes the poster's place");
  const tags = await alone.locator("meta[property^='og:']").evaluateAll((all) => all.map((tag) => [tag.getAttribute("property"), tag.content]));
  check(Object.fromEntries(tags)["og:image"] === "https://example.org/p/scene.png", `tags of a link: found ${tags}`);
  // Back and forth, so that chunks that need earlier ones are read in another order.
  for (const t of [0.45, 0.05, 0.3, 0.2]) {
    // The interface is hidden here.
    await alone.locator("#time").evaluate((input, value) => {
      input.value = value;
      input.dispatchEvent(new Event("input", { bubbles: true }));
    }, String(t));
    await shown(alone, t);
  }
  check((await psnr(other, await picture(alone), theirs)) >= 34, "a file shows the same again after others");
  const asked = log.asked.splice(before).filter((url) => !/^(file|data|blob):/.test(url));
  check(asked.length === 0, `the file asked for ${asked}`);
  await alone.close();
}

/** A picture at rest keeps all its pixels in a slow browser, however late the sorted orders arrive. */
async function resting(address) {
  const slow = await open(browser, SIZE, log);
  await visit(slow, address, { t: 0.1 });
  await slow.evaluate(() => {
    const [turn, post] = [window.requestAnimationFrame, Worker.prototype.postMessage];
    window.requestAnimationFrame = (work) => setTimeout(() => turn(work), 50);
    Worker.prototype.postMessage = function (...question) {
      setTimeout(() => post.apply(this, question), 1500);
    };
  });
  await slow.locator("#play").click();
  await slow.waitForFunction((width) => document.getElementById("canvas").width < width, SIZE[0]);
  await slow.locator("#play").click();
  await visit(slow, address, { t: 0.3, yaw: 20 });
  const fewest = await slow.evaluate(async () => {
    const canvas = document.getElementById("canvas");
    let fewest = canvas.width;
    for (const end = performance.now() + 2500; performance.now() < end; ) {
      await new Promise(requestAnimationFrame);
      fewest = Math.min(fewest, canvas.width);
    }
    return fewest;
  });
  check(fewest === SIZE[0], `expected ${SIZE[0]} pixels across at rest, found ${fewest}`);
  await slow.close();
}

/** A PLY file of needles, discs and balls with harmonics of degree 3, away from the origin, with distant floaters. `lines` are added to its header. */
function cloud(count = 4000, lines = "") {
  let seed = 1;
  const next = () => (seed = (seed * 48271) % 2147483647) / 1073741823.5 - 1;
  const some = (n, low, high) => Array.from({ length: n }, () => low + 0.5 * (high - low) * (next() + 1));
  const names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", ...Array.from({ length: 45 }, (_, i) => `f_rest_${i}`)];
  names.push("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3");
  const header = `ply\nformat binary_little_endian 1.0\n${lines}element vertex ${count}\n${names.map((name) => `property float ${name}\n`).join("")}end_header\n`;
  const rows = Array.from({ length: count }, (_, i) => {
    const place = i % 200 ? [10 + 3 * next(), -20 + 2 * next(), 5 + 4 * next()] : some(3, -500, 500);
    return [...place, ...some(3, -1.5, 1.5), ...some(45, -0.3, 0.3), ...some(1, -4, 4), ...some(3, -5, -1), ...some(4, -1, 1)];
  });
  return Buffer.concat([Buffer.from(header), Buffer.from(new Float32Array(rows.flat()).buffer)]);
}

/** A still scene: from `render`'s default view, from other sides, from within, by parallel rays; as a file; picked; without time. */
async function stills() {
  const source = `${scratch}/garden.ply`;
  writeFileSync(source, cloud());
  const view = start(streamsplat, ["view", source, "--port", "0"], "stdout");
  const address = (await view.line).split(" ")[0];
  const cameras = {
    "where render looks from": { canonical: true },
    "the side": { yaw: 70, pitch: -20, zoom: 1.6, x: 0.1 },
    within: { yaw: 150, zoom: 6 },
    "parallel rays": { yaw: 30, zoom: 1.3, lens: "parallel" },
  };
  let first = null;
  for (const [name, camera] of Object.entries(cameras)) {
    const { theirs, dB } = await compare(page, address, { t: 0, ...camera }, source);
    console.log(`a still scene, ${name}: ${dB.toFixed(1)} dB`);
    check(dB >= STILL, `a still scene, ${name}: expected ${STILL} dB beside our render, found ${dB}`);
    first ??= theirs;
  }
  await visit(page, address, { t: 0, mode: "depth" });
  check(await page.locator("#dock").isHidden(), "a still scene has no time line");
  check((await page.locator("#facts").textContent()).includes("PLY · harmonics of degree 3"), "the page says what it shows");
  check((await page.locator("#near").textContent()).startsWith("near "), "the depth has a legend");
  await page.getByRole("button", { name: "Gaussians", exact: true }).click();
  await page.mouse.click(SIZE[0] / 2, SIZE[1] / 2);
  await page.waitForFunction(() => /^\d+$/.test(document.getElementById("identity").textContent));
  check(Number(await page.locator("#identity").textContent()) < 4000, "a Gaussian has a number of the file");
  await page.keyboard.press("Space");
  await page.getByRole("button", { name: "Whole scene" }).click();
  await page.waitForFunction(() => location.hash.includes("mode=identity") && !location.hash.includes("yaw="));

  const html = `${scratch}/garden.html`;
  run(streamsplat, "view", source, "--html", html, "--quiet");
  const before = log.asked.length;
  await visit(page, `file://${html}`, { t: 0, interface: "none", background: 0.5 });
  const asked = log.asked.splice(before).filter((url) => !/^(file|data|blob):/.test(url));
  check(asked.length === 0, `a still scene's file asked for ${asked}`);
  const like = await psnr(other, await picture(page), first);
  check(like === Infinity, `a still scene's file: expected the picture of what is served, found ${like} dB from it`);
  view.child.kill("SIGINT");
  check((await view.ended) === 0, "Ctrl-C ends the server well");
}

/** A file that was exported from a scene is seen first from the source's camera, as `render` sees it. */
async function exported() {
  const path = `${scratch}/exported.ply`;
  run(streamsplat, "export", scene, "--times", "0.1", "--quiet", "--out", path);
  const view = start(streamsplat, ["view", path, "--port", "0"], "stdout");
  const address = (await view.line).split(" ")[0];
  const { dB } = await compare(page, address, { t: 0, canonical: true }, path);
  console.log(`a file exported from a scene, from the source's camera: ${dB.toFixed(1)} dB`);
  check(dB >= STILL, `a file exported from a scene: expected ${STILL} dB beside our render, found ${dB}`);
  check((await page.locator("#home").textContent()) === "Source view", "the button is that of the source's view");
  view.child.kill("SIGINT");
  await view.ended;
}

/** Marks of anti-aliased training: drawn as `render` draws them, with opacities lowered by √(det before / det after), and picked likewise. */
async function antialiased() {
  const [marked, dots] = [`${scratch}/marked.ply`, `${scratch}/dots.ply`];
  writeFileSync(marked, cloud(4000, "comment SplatRenderMode: mip\n"));
  const view = start(streamsplat, ["view", marked, "--port", "0"], "stdout");
  const address = (await view.line).split(" ")[0];
  for (const camera of [{ canonical: true }, { yaw: 70, pitch: -20, zoom: 0.3 }, { yaw: 30, zoom: 0.4, lens: "parallel" }]) {
    const { theirs, dB } = await compare(page, address, { t: 0, ...camera }, marked);
    const [width, height] = SIZE;
    const from = camera.canonical ? [] : ["--camera", `${scratch}/camera.json`];
    run(streamsplat, "render", marked, ...from, "--size", `${width}x${height}`, "--antialias", "off", "--quiet", "--out", `${scratch}/plain`);
    const plain = await psnr(other, theirs, `${scratch}/plain/frames/000000.png`);
    console.log(`with the mark of anti-aliasing, ${JSON.stringify(camera)}: ${dB.toFixed(1)} dB, without it ${plain.toFixed(1)} dB`);
    check(dB >= STILL, `with the mark of anti-aliasing: expected ${STILL} dB beside our render, found ${dB}`);
    check(plain < dB - 12, `expected another picture than without anti-aliasing, found ${plain} dB beside it, and ${dB} beside ours`);
  }
  check((await page.locator("#facts").textContent()).endsWith(" · trained with anti-aliasing"), "the page shows the mark");
  view.child.kill("SIGINT");
  check((await view.ended) === 0, "Ctrl-C ends the server well");

  // Three dots of a twentieth of a pixel, one in the middle: less than 1/255 remains of the light after the low-pass.
  const names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"];
  const rows = [-1, 0, 1].map((x) => [x, 0, 0, 1, 1, 1, 4, -10, -10, -10, 1, 0, 0, 0]);
  const dotted = (lines) => {
    const header = `ply\nformat binary_little_endian 1.0\n${lines}element vertex 3\n${names.map((name) => `property float ${name}\n`).join("")}end_header\n`;
    return Buffer.concat([Buffer.from(header), Buffer.from(new Float32Array(rows.flat()).buffer)]);
  };
  for (const [lines, found] of [["", true], ["comment antialiased 1\n", false], ["comment antialiased 1\ncomment Antialiased 0\n", true]]) {
    writeFileSync(dots, dotted(lines));
    const view = start(streamsplat, ["view", dots, "--port", "0"], "stdout");
    await visit(page, (await view.line).split(" ")[0], { t: 0 });
    await page.mouse.click(SIZE[0] / 2, SIZE[1] / 2);
    check((await page.locator("#card").isVisible()) === found, `${JSON.stringify(lines)}: expected ${found ? "a Gaussian" : "none"} under the middle`);
    view.child.kill("SIGINT");
    await view.ended;
  }
}

/** An SPZ file of version 1, 2 or 3 with positions of `width` bytes, which none of our programs writes: `plain` changes the bytes before compression. */
function spz(version, degree, plain = (bytes) => bytes, flags = 0, width = version === 1 ? 6 : 9) {
  const count = 3000;
  let seed = 7;
  const bytes = (each, low, high) => Buffer.from(Array.from({ length: each * count }, () => low + ((seed = (seed * 48271) % 2147483647) % (high - low))));
  const header = Buffer.alloc(16);
  header.write("NGSP");
  [version, count].forEach((value, k) => header.writeUInt32LE(value, 4 + 4 * k));
  header[12] = degree;
  header[13] = 12;
  header[14] = flags;
  // Within ±16 as fixed point, within ±2 as binary16.
  const placed = { 6: (byte, k) => (k % 2 ? (byte & 0x8f) | 0x30 : byte), 9: (byte, k) => (k % 3 < 2 ? byte : byte & 1 ? 255 : 0) };
  const positions = Buffer.from(bytes(width, 0, 256).map(placed[width]));
  const attributes = [positions, bytes(1, 0, 256), bytes(3, 60, 200), bytes(3, 80, 144), bytes(version < 3 ? 3 : 4, 0, 256), bytes(3 * ((degree + 1) ** 2 - 1), 100, 156)];
  return gzipSync(plain(Buffer.concat([header, ...attributes])));
}

/** Drops files on the page, given by their names and bytes. */
async function drop(page, ...files) {
  const parts = files.map(([name, bytes]) => [name, Buffer.from(bytes).toString("base64")]);
  await page.evaluate((parts) => {
    const dataTransfer = new DataTransfer();
    for (const [name, bytes] of parts) dataTransfer.items.add(new File([Uint8Array.from(atob(bytes), (c) => c.charCodeAt(0))], name));
    for (const kind of ["dragover", "drop"]) document.getElementById("canvas").dispatchEvent(new DragEvent(kind, { dataTransfer, bubbles: true, cancelable: true }));
  }, parts);
}

/** The picture of an opened file, once the page shows it, from the view of `view`. */
async function opened(page, name) {
  await page.waitForFunction((name) => {
    const find = (id) => document.getElementById(id);
    return find("message").hidden && find("title").textContent === name && find("canvas").dataset.shown === "0";
  }, name);
  await page.evaluate((said) => (location.hash = said), `${new URLSearchParams({ interface: "none", background: 0.5 })}`);
  await shown(page, 0);
  return picture(page);
}

/** Files that are dropped on the page or chosen: each equals that of `view`, to the byte; invalid files leave the scene unchanged. */
async function files(address) {
  const source = `${scratch}/cloud.ply`;
  writeFileSync(source, cloud());
  const paths = [source];
  for (const name of ["cloud.compressed.ply", "cloud.splat", "cloud.sog", "cloud.glb"]) {
    paths.push(`${scratch}/${name}`);
    run(streamsplat, "export", source, "--out", paths.at(-1), "--quiet");
  }
  // Far from the origin: the translation's whole numbers are the scene's offset.
  const glb = readFileSync(paths.at(-1));
  paths.push(`${scratch}/far.glb`);
  writeFileSync(paths.at(-1), documented(glb, ({ nodes }) => void (nodes[0].translation = [5000.75, -4096.5, 1.25])));
  for (const [version, degree, flags = 0, width] of [[2, 0], [3, 3], [3, 4], [3, 1, 1], [1, 1], [1, 0, 0, 9]]) {
    paths.push(`${scratch}/version-${version}-${degree}-${flags}-${width ?? "own"}.spz`);
    writeFileSync(paths.at(-1), spz(version, degree, undefined, flags, width));
  }
  for (const version of ["3", "4"]) {
    paths.push(`${scratch}/cloud-${version}.spz`);
    run(streamsplat, "export", source, "--spz-version", version, "--out", paths.at(-1), "--quiet");
  }
  for (const [name, lines] of [["brush", "comment SplatRenderMode: mip\n"], ["postshot", "comment Antialiased 1\n"], ["neither", "comment antialiased 1\ncomment SplatRenderMode: default\ncomment antialiased 1 x\n"]]) {
    paths.push(`${scratch}/${name}.ply`);
    writeFileSync(paths.at(-1), cloud(4000, lines));
  }
  paths.push(`${scratch}/marked.compressed.ply`);
  run(streamsplat, "export", `${scratch}/brush.ply`, "--out", paths.at(-1), "--quiet");
  const own = await open(browser, SIZE, log);
  await visit(own, address, { t: 0.1 });
  for (const path of paths) {
    const view = start(streamsplat, ["view", path, "--port", "0"], "stdout");
    await visit(page, (await view.line).split(" ")[0], { t: 0, interface: "none", background: 0.5 });
    const name = basename(path);
    await drop(own, [name, readFileSync(path)]);
    let dB = await psnr(other, await opened(own, name), await picture(page));
    // Gaussians are sorted in the background: on a busy machine two equal pictures may both precede the sorting.
    for (let again = 0; again < 20 && dB !== Infinity; again++) {
      await new Promise((done) => setTimeout(done, 250));
      dB = await psnr(other, await picture(own), await picture(page));
    }
    check(dB === Infinity, `${name}, dropped: expected the picture of what is served, found ${dB} dB from it`);
    const facts = (page) => page.locator("#facts").textContent();
    check((await facts(own)) === (await facts(page)), `${name}: expected ${await facts(page)}, found ${await facts(own)}`);
    const bytes = await differing(page, path);
    console.log(`${name}, dropped: the picture of what is served, ${bytes} bytes of its packet differ`);
    check(bytes === 0, `${name}: expected the packet that is served, found ${bytes} other bytes`);
    view.child.kill("SIGINT");
    await view.ended;
  }
  // By key and by button; of two files the later one.
  own.on("filechooser", (chooser) => chooser.setFiles(source));
  for (const ask of [() => own.keyboard.press("o"), () => own.locator("#open").click()]) {
    await own.evaluate(() => (document.getElementById("interface").hidden = false));
    await drop(own, ["earlier.splat", readFileSync(paths[2])]);
    await ask();
    await opened(own, "cloud.ply");
  }
  const last = await picture(own);
  await refused(own, paths, `${scratch}/cloud-4.spz`);
  check((await psnr(other, await picture(own), last)) === Infinity, "what is refused leaves the scene as it is");
  await own.mouse.click(SIZE[0] / 2, SIZE[1] / 2);
  check(/^\d+$/.test(await own.locator("#identity").textContent()), "a Gaussian of an opened file is picked");
  await own.close();

  const before = log.asked.length;
  const alone = await open(browser, SIZE, log);
  await visit(alone, `file://${scratch}/scene.html`, { t: 0.2 });
  await drop(alone, ["cloud.ply", readFileSync(source)]);
  check((await psnr(other, await opened(alone, "cloud.ply"), last)) === Infinity, "a page that is a file opens one too");
  const asked = log.asked.splice(before).filter((url) => !/^(file|data|blob):/.test(url));
  check(asked.length === 0, `a page that is a file asked for ${asked}`);
  await alone.close();
}

/** Files whose content does not match their name, one message each. */
async function refused(page, [ply, packed, splat, sog, glb], newer) {
  const [whole, compressed, records, zipped, binary] = [ply, packed, splat, sog, glb].map((path) => readFileSync(path));
  const changed = (bytes, from, to) => Buffer.from(bytes.toString("latin1").replace(from, to), "latin1");
  const flipped = (bytes, at) => ((bytes = Buffer.from(bytes)), (bytes[at] ^= 1), bytes);
  const header = (at, value) => (bytes) => (bytes.writeUInt32LE(value, at), bytes);
  const negative = Buffer.from(records);
  negative.writeFloatLE(-1, 32 + 12);
  const bomb = Buffer.concat([Buffer.from("NGSP"), Buffer.from([3, 0, 0, 0, 0x40, 0x42, 0x0f, 0, 0, 12, 0, 0]), Buffer.alloc(20_000_000)]);
  const view = "(open it with: streamsplat view FILE)";
  const newest = readFileSync(newer);
  /** Changes the first byte of the first frame. */
  const broken = (bytes) => ((bytes = Buffer.from(bytes)), (bytes[bytes.readUInt32LE(16) + 16 * bytes[15]] ^= 1), bytes);
  const chunks = (bytes) => {
    const file = Buffer.concat([bytes.subarray(0, 12), Buffer.alloc(8 * 1000), bytes.subarray(12)]);
    return header(8, file.length)(file);
  };
  const all = [
    ["cut.ply", whole.subarray(0, -5), "element vertex: expected 4000 of 236 bytes each, found 943995 bytes"],
    ["long.ply", Buffer.concat([whole, records]), "file: expected its end after the last element, found"],
    ["many.ply", changed(whole, "vertex 4000", "vertex 99999999999999999999"), "element vertex: expected 100000000000000000000 of 236 bytes each, found"],
    ["types.ply", changed(whole, "float x", "int x"), "property x of vertex: expected float, found int"],
    ["list.ply", changed(whole, "float x", "list uchar int x"), 'expected a number of an element, once, found "list"'],
    ["text.ply", Buffer.from("ply\nformat ascii 1.0\nelement vertex 0\nend_header\n"), `format: expected binary_little_endian, found "ascii" ${view}`],
    ["endless.ply", Buffer.concat([Buffer.from("ply\n"), Buffer.alloc(70_000, 32)]), "header: expected end_header within the first 4194304 bytes"],
    ["cut.compressed.ply", compressed.subarray(0, -5), "element sh: expected 4000 of 45 bytes each"],
    ["many.compressed.ply", changed(compressed, "chunk 16", "chunk 99"), "element sh: expected 4000 of 45 bytes each"],
    ["magic.compressed.ply", changed(compressed, "ply", "plx"), 'format: expected PLY, compressed PLY, SPZ, SOG, glb, splat or ssz, found a file that begins with "plx\\nform"'],
    ["cut.splat", records.subarray(0, -5), `file: expected records of 32 bytes, found ${records.length - 5} bytes`],
    ["negative.splat", negative, "record 1: expected standard deviations of 0 or more, found -1"],
    ["nowhere.splat", Buffer.alloc(32, 255), "centres: expected Gaussians at finite places, found none to look at"],
    ["cut.spz", spz(3, 1).subarray(0, -9), "gzip stream: expected a whole one, found "],
    ["more.spz", spz(3, 1, (bytes) => Buffer.concat([bytes, Buffer.from([0])])), "attributes: expected 87000 bytes, found more"],
    ["between.spz", spz(1, 1, (bytes) => Buffer.concat([bytes, Buffer.from([0])])), "attributes: expected 75000 bytes, or 84000 with positions in fixed point, found 75001"],
    ["fewer.spz", spz(3, 1, (bytes) => bytes.subarray(0, -1)), "attributes: expected 87000 bytes, found 86999"],
    ["many.spz", spz(2, 0, header(8, 99_999_999)), "header: points: expected at most"],
    ["bomb.spz", gzipSync(bomb), "header: points: expected at most"],
    ["version.spz", spz(3, 0, header(4, 5)), "header: version: expected 1 to 3 in a file of this kind, found 5"],
    ["magic.spz", spz(3, 0, header(0, 0x20202020)), 'header: first word: expected NGSP, found "    "'],
    ["new.spz", Buffer.from("NGSP\x04\x00\x00\x00"), "header: expected 32 bytes, found 8"],
    ["cut.4.spz", newest.subarray(0, -5), "harmonics: expected "],
    ["more.4.spz", Buffer.concat([newest, Buffer.alloc(1)]), "file: expected its end after the last stream, found 1 more bytes"],
    ["frame.4.spz", broken(newest), "positions: expected a zstd frame of 36000 bytes, found damaged: no frame"],
    ["many.4.spz", header(8, 99_999_999)(Buffer.from(newest)), "header: points: expected at most"],
    ["a.sog", Buffer.from("PK\x03\x04aaaa"), "zip file: expected its directory's end, found none"],
    ["cut.sog", zipped.subarray(1000), 'found a file that begins with'],
    ["version.sog", changed(zipped, '"version":2', '"version":7'), "meta.json: expected the checksum of its bytes, found another"],
    ["flipped.sog", flipped(zipped, zipped.indexOf("WEBPVP8L") + 60), ".webp: expected the checksum of its bytes, found another"],
    ["a.glb", Buffer.from("glTF\x02\x00\x00\x00"), "header: expected 12 bytes, found 8"],
    ["cut.glb", binary.subarray(0, -4), `header: length: expected ${binary.length - 4} bytes, found ${binary.length}`],
    ["mesh.glb", changed(binary, '"mode":0', '"mode":4'), `mesh: primitives: expected one of points with KHR_gaussian_splatting, without indices, found`],
    ["short.glb", changed(binary, '"type":"SCALAR"', '"type":"MATRIX"'), "attribute KHR_gaussian_splatting:OPACITY: expected binary32 numbers of the type SCALAR, found"],
    ["many.glb", changed(binary, '"count":4000', '"count":4001'), "attribute POSITION: expected 48012 bytes in the file's buffer, found"],
    ["indices.glb", documented(binary, ({ meshes }) => void (meshes[0].primitives[0].indices = 0)), "mesh: primitives: expected one of points with KHR_gaussian_splatting, without indices, found"],
    ["packed.glb", documented(binary, ({ bufferViews }) => void (bufferViews[0].extensions = { EXT_meshopt_compression: {} })), "attribute POSITION: expected numbers one after another in the file, found"],
    ["word.glb", documented(binary, ({ nodes }) => void (nodes[0].translation = 1)), 'node: translation: expected three numbers, found "1"'],
    ["list.glb", documented(binary, ({ meshes }) => void (meshes[0].primitives[0].attributes = [])), "attribute POSITION: expected one in the file, found"],
    ["none.glb", documented(binary, ({ meshes }) => void delete meshes[0].primitives[0].attributes), "primitive: attributes: expected those of Gaussians, found"],
    ["deep.glb", documented(binary, (all) => JSON.stringify(all).replace('"mesh":0', `"mesh":0,"matrix":${"[".repeat(1e5)}${"]".repeat(1e5)}`)), "node: matrix: expected none, found"],
    ["chunks.glb", chunks(binary), "chunks: expected at most 64, found more"],
    ["infinite.sog", metaChanged(zipped, /(?<="mins":\[)[^,]+/, "1e999"), "meta.json: means.mins: expected 3 of the type number, found"],
    ["named.sog", metaChanged(zipped, /"means_l.webp"/, '"means\\nx.web"'), '"means\\nx.web": expected a file in the zip file, found none'],
    ["count.sog", metaChanged(zipped, /"count":\d+/, '"count":-9'), 'meta.json: count: expected 0 to 9007199254740991, found "-9"'],
    ["scene.json", Buffer.from("{}"), `found JSON that names other files ${view}`],
    ["a.mp4", Buffer.from("\x00\x00\x00\x20ftypisom"), "found a video (make a scene of it with: streamsplat run FILE)"],
    ["empty", Buffer.alloc(0), "found an empty file"],
  ];
  const message = page.locator("#message");
  for (const [name, bytes, expected] of all) {
    await drop(page, [name, bytes]);
    await page.waitForFunction((name) => new RegExp(`^${name}: (?!reading)`).test(document.getElementById("message").textContent), name);
    const found = await message.textContent();
    check(found.includes(expected) && !found.includes("\n"), `${name}: expected "${expected}", found "${found}"`);
    check((await page.locator("#title").textContent()) === "cloud.ply", `${name} leaves the title`);
  }
  await drop(page, ["a.ply", whole], ["b.ply", whole]);
  check((await message.textContent()).includes("expected one file, found 2"), "one file is opened at a time");
  await page.keyboard.press("Escape");
  check(await message.isHidden(), "a message goes with what is done next");
}

/** The first picture appears before most of the file has arrived; time waits for the rest. */
async function slowly() {
  const bytes = readFileSync(`${scratch}/scene.html`);
  const first = bytes.indexOf('id="interval-2"');
  let rest = null;
  const server = createServer((request, response) => {
    response.setHeader("Content-Type", "text/html; charset=utf-8");
    response.write(bytes.subarray(0, first));
    rest = () => response.end(bytes.subarray(first));
  }).listen(0, "127.0.0.1");
  await once(server, "listening");
  const waiting = await open(browser, SIZE, log);
  await waiting.goto(`http://127.0.0.1:${server.address().port}/#t=0`, { waitUntil: "commit" });
  await shown(waiting, 0);
  check((await waiting.evaluate(() => document.readyState)) === "loading", "the picture came before the file's end");
  rest();
  await waiting.waitForFunction(() => document.readyState === "complete");
  await waiting.locator("#time").fill("0.45");
  await shown(waiting, 0.45);
  await waiting.close();
  server.close();
}

/** Counts the work of a picture while the scene plays and while it is turned; checks that the page sways until it is touched. */
async function work(address) {
  const swaying = await browser.newPage({ viewport: { width: 1280, height: 720 }, reducedMotion: "no-preference" });
  swaying.setDefaultTimeout(60_000);
  await swaying.goto(address);
  await swaying.waitForFunction(() => document.getElementById("canvas").work?.().pictures > 20);
  const rate = async (name) => {
    const read = () => swaying.evaluate(() => ({ ...document.getElementById("canvas").work(), now: performance.now() }));
    const before = await read();
    // Work is counted, as the time of a picture here does not predict a graphics card's.
    await swaying.waitForFunction((count) => document.getElementById("canvas").work().pictures >= count, before.pictures + 8);
    const after = await read();
    const [pictures, orders, records, moved] = ["pictures", "orders", "records", "moved"].map((what) => after[what] - before[what]);
    const perSecond = (1000 * pictures) / (after.now - before.now);
    console.log(`${name}: ${perSecond.toFixed(1)} pictures a second, ${orders} orders, ${((100 * moved) / Math.max(1, records)).toFixed(1)} % of records moved`);
    return { moved: moved / Math.max(1, records) };
  };
  await rate("swaying and playing");
  await swaying.mouse.click(600, 300);
  await swaying.waitForTimeout(700);
  const hash = await swaying.evaluate(() => location.hash.replace(/t=[^&]*/, ""));
  await swaying.waitForTimeout(700);
  check((await swaying.evaluate(() => location.hash.replace(/t=[^&]*/, ""))) === hash, "a touch ends the sway");
  // From the source's view, and slowly, so that pictures follow each other as on a graphics card.
  await swaying.getByRole("button", { name: "Source view" }).click();
  await swaying.locator("#speed").selectOption("0.125");
  const played = await rate("playing");
  check(played.moved < 0.5, `expected most records to stay in order while a scene plays, found ${played.moved} moved`);
  await swaying.close();
}

/** A stream whose frames arrive one by one is on the page before it ends. */
async function live() {
  const bytes = readFileSync(CLIP);
  const header = bytes.indexOf("\n") + 1;
  const frame = "FRAME\n".length + (256 * 144 * 3) / 2;
  const out = `${scratch}/live`;
  const { child, line, ended } = start(streamsplat, ["run", "-", "--gap", "2", "--serve=0", "--out", out], "stderr");
  child.stdin.write(bytes.subarray(0, header + 3 * frame));
  const address = await line;
  const watching = await open(browser, SIZE, log);
  await watching.goto(address);
  const reaches = (time) => watching.waitForFunction((time) => Number(document.getElementById("time").max) >= time - 1e-9, time);
  await reaches(2 / 24);
  await watching.waitForFunction(() => document.getElementById("canvas").dataset.shown);
  await watching.locator("#live").click();
  check((await watching.locator("#live").getAttribute("aria-pressed")) === "true", "a stream is followed");
  child.stdin.write(bytes.subarray(header + 3 * frame, header + 7 * frame));
  await reaches(6 / 24);
  await watching.waitForFunction((end) => Number(document.getElementById("canvas").dataset.shown) === end, 6 / 24);
  child.stdin.end(bytes.subarray(header + 7 * frame, header + 9 * frame));
  await reaches(8 / 24);
  await watching.waitForFunction(() => document.getElementById("live").textContent === "Ended");
  check(await watching.locator("#message").isHidden(), "a stream that ended is no server that has gone");
  await watching.waitForFunction(() => document.getElementById("time").getAttribute("aria-valuetext")?.includes(" seconds of "));
  // The page is served until Ctrl-C.
  check(child.exitCode === null, "the run serves on");
  child.kill("SIGINT");
  check((await ended) === 0, "the run ends well");
  // The last picture stays on the page.
  await watching.locator("#time").fill("0.05");
  await shown(watching, 0.05);
  await watching.close();

  const again = `${scratch}/again`;
  run(streamsplat, "run", CLIP, "--gap", "2", "--frames", "9", "--quiet", "--out", again);
  const outputs = (folder) => JSON.stringify(JSON.parse(readFileSync(`${folder}/run.json`)).outputs);
  check(outputs(out) === outputs(again), "a stream that is watched gives the same digests");
}

/** On a phone's screen every control is large enough to touch, and none covers the middle of the picture. */
async function narrow(address) {
  const phone = await open(browser, [390, 844], log);
  await visit(phone, address, { t: 0.25 });
  await phone.locator("#more").click();
  await phone.screenshot({ path: `${scratch}/390x844.png` });
  const middle = 844 / 2;
  for (const control of await phone.locator("button:visible, select:visible, #time").all()) {
    const { x, y, width, height } = await control.boundingBox();
    const name = await control.evaluate((element) => element.id || element.textContent);
    check(height >= 44 && width >= 44, `${name}: expected 44 pixels a side, found ${width}×${height}`);
    check(await control.evaluate((element) => element.scrollWidth <= element.clientWidth), `${name}: expected room for its text`);
    check(x >= 0 && x + width <= 390, `${name}: lies off the screen`);
    check(y > middle + 150 || y + height < 120, `${name}: covers the picture at ${y}`);
  }
  await phone.close();
}

/** A page whose server has stopped reports it, without a burst of requests; a page without WebGL2 reports that. */
async function nothing() {
  const view = start(streamsplat, ["view", scene, "--port", "0"], "stdout");
  const address = (await view.line).split(" ")[0];
  const quiet = { said: [], asked: [] };
  const left = await open(browser, SIZE, quiet);
  await visit(left, address, { t: 0 });
  view.child.kill("SIGINT");
  await view.ended;
  await left.locator("#time").fill("0.45");
  await left.waitForFunction(() => document.getElementById("message").textContent.includes("does not answer"));
  const before = quiet.asked.length;
  await left.waitForTimeout(1500);
  check(quiet.asked.length - before <= 2, `expected a question now and then, found ${quiet.asked.length - before} in 1.5 s`);
  await left.close();

  const without = await open(browser, SIZE, quiet);
  await without.addInitScript(() => (HTMLCanvasElement.prototype.getContext = () => null));
  await without.goto(`file://${scratch}/scene.html`);
  await without.waitForFunction(() => document.getElementById("message").textContent.includes("WebGL2"));
  check((await without.locator("#facts").textContent()) === "The scene cannot be shown", "nothing loads for ever");
  await without.close();
}

const view = start(streamsplat, ["view", scene, "--port", "0"], "stdout");
const address = (await view.line).split(" ")[0];
await pictures(address);
await narrow(address);
await controls(address);
await picking(address);
await resting(address);
await file(address);
await files(address);
await slowly();
await work(address);
view.child.kill("SIGINT");
check((await view.ended) === 0, "Ctrl-C ends the server well");
await nothing();
await changing();
await stills();
await exported();
await antialiased();
await live();
await browser.close();
check(log.said.length === 0, `the console is not clean: ${log.said.join("; ")}`);
const strangers = log.asked.filter((url) => !/^(blob:|http:\/\/127\.0\.0\.1:\d+\/|data:)/.test(url));
check(strangers.length === 0, `the page asked for ${strangers}`);
