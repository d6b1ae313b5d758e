// both.mjs NODE-MODULES STREAMSPLAT SCRATCH-FOLDER BROWSER; from the repository's root. The page's features for visitors, in Chromium and in Firefox, on a
// desktop and on a phone. Pictures are written to the scratch folder for inspection.

import { existsSync, readFileSync, statSync, writeFileSync } from "node:fs";
import { check, chromium, differing, open, picture, psnr, run, start } from "../browser.mjs";
import { firefox } from "../firefox.mjs";

const [modules, streamsplat, scratch, name] = process.argv.slice(2);
const CLIP = "fixtures/clips/moving.y4m";
const [DESK, PHONE] = [[1280, 800], [390, 844]];
/** Time limit for moving pictures: drawing is in software here. */
const QUICK = [640, 400];
/** PSNR of the page's own pictures against ours, in dB. */
const ENOUGH = 50;
/** The same of a container's whole numbers, against the scene they were rounded from. */
const CLOSE = 47;
/** Milliseconds until the first picture of ten seconds from disk; a machine with other work gets three times as long. */
const FIRST = 2000;

const log = { said: [], asked: [] };
const compared = await chromium(modules);
const other = await compared.newPage();
const browser = name === "firefox" ? await firefox(scratch) : compared;
const opened = (size) => (name === "firefox" ? browser.open(size) : open(browser, size, log));

const scene = `${scratch}/scene`;
run(streamsplat, "run", CLIP, "--gap", "4", "--frames", "13", "--emit", "scene", "--quiet", "--out", scene);
run(streamsplat, "export", scene, "--format", "ssz", "--quiet", "--out", `${scratch}/scene.ssz`);
const view = start(streamsplat, ["view", scene, "--port", "0"], "stdout");
const address = (await view.line).split(" ")[0];

const shown = (page, time) => page.waitForFunction((time) => document.getElementById("canvas").dataset.shown === String(time), time);
const pause = (milliseconds) => new Promise((done) => setTimeout(done, milliseconds));
/** The angles in the address, once it has not changed for two seconds. */
const angles = (page) =>
  page.evaluate(async () => {
    for (let [last, since] = [location.hash, performance.now()]; performance.now() - since < 2000; await new Promise((done) => setTimeout(done, 100))) {
      if (location.hash !== last) [last, since] = [location.hash, performance.now()];
    }
    const said = new URLSearchParams(location.hash.slice(1));
    return ["yaw", "pitch"].map((key) => Number(said.get(key) ?? 0));
  });
const keep = async (page, what) => writeFileSync(`${scratch}/${name}-${what}.png`, await page.screenshot());

let visits = 0;
/** The page at an address; a different one each time, as otherwise nothing would be redrawn. */
async function visit(page, said, at = address) {
  await page.evaluate(() => delete document.getElementById("canvas")?.dataset.shown);
  await page.goto(`${at}#${new URLSearchParams({ ...said, visit: ++visits })}`);
  await shown(page, said.t);
}

/** Drags from the middle, step by step, and holds. */
async function drag(page, [width, height], right, down) {
  await page.mouse.move(width / 2, height / 2);
  await page.mouse.down();
  await page.mouse.move(width / 2 + right, height / 2 + down, { steps: 4 });
}

/** Our render at a time and size, from the source's own view or another. */
function ours(time, [width, height], more = []) {
  const out = `${scratch}/ours`;
  run(streamsplat, "render", scene, "--times", String(time), "--size", `${width}x${height}`, "--quiet", ...more, "--out", out);
  return `${out}/frames/000000.png`;
}

/** A scene in time turns slowly, resists beyond 15 degrees and springs back; with free turning it does not. */
async function turning(page, size) {
  await visit(page, { t: 0.25 });
  await drag(page, size, 100, 0);
  await page.waitForFunction(() => location.hash.includes("yaw="));
  await page.mouse.up();
  const [slow] = await angles(page);
  check(slow < -8 && slow > -13, `100 pixels: expected 12 degrees, found ${slow}`);
  const held = [];
  for (let i = 0; i < 2; i++) {
    await drag(page, size, 300, 0);
    held.push((await angles(page))[0]);
    await page.mouse.up();
    const [yaw] = await angles(page);
    check(Math.abs(yaw) <= 15.01, `let go: expected 15 degrees at most, found ${yaw}`);
  }
  check(held.every((yaw) => yaw < -15 && yaw > -30), `held: expected 15 to 30 degrees, found ${held}`);
  await page.keyboard.press("t");
  await drag(page, size, 180, 0);
  await page.mouse.up();
  const [free] = await angles(page);
  check(free < -45, `free turning: expected more than 45 degrees, found ${free}`);
  await page.keyboard.press("t");
  await page.keyboard.press("r");
  await page.waitForFunction(() => !/yaw|pitch/.test(location.hash));
}

/** Time: a frame forward and back, the end, with and without looping. */
async function time(page) {
  await visit(page, { t: 0.25 });
  const frame = 1 / 24;
  const at = (time) => page.waitForFunction((time) => Math.abs(Number(document.getElementById("canvas").dataset.shown) - time) < 1e-9, time);
  const click = (id) => page.evaluate((id) => document.getElementById(id).click(), id);
  await click("next");
  await at(0.25 + frame);
  await click("back");
  await page.keyboard.press(",");
  await at(0.25 - frame);
  await page.keyboard.press(".");
  await at(0.25);
  await click("loop");
  await page.keyboard.press("End");
  await at(0.5);
  await click("play");
  await page.waitForFunction(() => Number(document.getElementById("canvas").dataset.shown) < 0.4);
  await page.waitForFunction(() => document.getElementById("play").getAttribute("aria-label") === "Play");
  await at(0.5);
  await page.keyboard.press("l");
  check(await page.evaluate(() => document.getElementById("loop").getAttribute("aria-pressed") === "true"), "L begins again at the end");
  await click("play");
  await page.waitForFunction(() => Number(document.getElementById("canvas").dataset.shown) < 0.4);
  await click("play");
}

/** A saved picture of another size than the screen's equals that of `render`. */
async function saved(page) {
  await visit(page, { t: 0.3, background: 0.5 });
  await page.keyboard.press("i");
  const size = [480, 270];
  await page.evaluate(([width, height]) => {
    document.getElementById("across").value = width;
    document.getElementById("down").value = height;
    // The download is intercepted.
    HTMLAnchorElement.prototype.click = function () {
      window.saved = this.download;
    };
    const { createObjectURL } = URL;
    URL.createObjectURL = (blob) => ((window.blob = blob), createObjectURL(blob));
    document.querySelector("#size button").click();
  }, size);
  await page.waitForFunction(() => window.saved);
  const found = await page.evaluate(async () => {
    const bytes = new Uint8Array(await window.blob.arrayBuffer());
    return [window.saved, btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""))];
  });
  check(/^\w+-0\.300s-480x270\.png$/.test(found[0]), `the picture's name: found ${found[0]}`);
  const dB = await psnr(other, Buffer.from(found[1], "base64"), ours(0.3, size));
  console.log(`${name}: a saved picture beside ours: ${dB.toFixed(1)} dB`);
  check(dB >= ENOUGH, `a saved picture: expected ${ENOUGH} dB beside ours, found ${dB}`);
  await page.waitForFunction((width) => document.getElementById("canvas").width === width, QUICK[0]);
}

/** A link contains the view; full screen is requested. */
async function links(page) {
  await visit(page, { t: 0.3, zoom: 1.5 });
  await page.evaluate(() => {
    window.copied = [];
    navigator.clipboard.writeText = async (text) => void window.copied.push(text);
    document.documentElement.requestFullscreen = async () => void window.copied.push("whole");
  });
  await page.keyboard.press("+");
  await page.keyboard.press("c");
  await page.waitForFunction(() => window.copied.length === 1);
  const link = await page.evaluate(() => window.copied[0]);
  check(link.startsWith(address) && link.includes("t=0.3") && link.includes("zoom=1.65"), `a link: found ${link}`);
  await page.keyboard.press("v");
  await page.waitForFunction(() => window.copied[1] === "whole");
}

/** Our own container replaces a still scene, and shows the served picture; broken ones are refused in a line. */
async function containers(page) {
  const drop = (file, bytes) =>
    page.evaluate(([file, bytes]) => {
      const dataTransfer = new DataTransfer();
      dataTransfer.items.add(new File([Uint8Array.from(atob(bytes), (c) => c.charCodeAt(0))], file));
      document.getElementById("canvas").dispatchEvent(new DragEvent("drop", { dataTransfer, bubbles: true, cancelable: true }));
    }, [file, Buffer.from(bytes).toString("base64")]);
  const titled = (title) => page.waitForFunction((title) => document.getElementById("title").textContent === title && document.getElementById("message").hidden, title);
  const look = async (time) => {
    await page.evaluate((time) => (location.hash = `t=${time}&background=0.5&interface=none`), time);
    await shown(page, time);
    return picture(page);
  };
  await visit(page, { t: 0.1 });
  const served = [await look(0.45), await look(0.1), await look(0.3)];
  const whole = readFileSync(`${scratch}/scene.ssz`);
  run(streamsplat, "export", scene, "--format", "splat", "--times", "0.1", "--quiet", "--out", `${scratch}/still.splat`);
  await drop("still.splat", readFileSync(`${scratch}/still.splat`));
  await titled("still.splat");
  check(await page.evaluate(() => getComputedStyle(document.getElementById("dock")).display === "none"), "a still scene has no time line");
  await drop("scene.ssz", whole);
  await titled("scene.ssz");
  await page.evaluate(() => (document.getElementById("interface").hidden = false));
  check(await page.evaluate(() => getComputedStyle(document.getElementById("dock")).display !== "none"), "a scene in time has its time line again");
  check(await page.evaluate(() => document.getElementById("home").textContent === "Source view"), "and its words");
  // Out of order: chunks need those before them.
  for (const [k, time] of [[0, 0.45], [1, 0.1], [2, 0.3]]) {
    const dB = await psnr(other, await look(time), served[k]);
    console.log(`${name}: an opened container at ${time} s: ${dB.toFixed(1)} dB from what is served`);
    check(dB >= CLOSE, `an opened container at ${time} s: expected ${CLOSE} dB from what is served, found ${dB}`);
  }
  const last = served[2];
  const changed = (at, value) => ((bytes) => ((bytes[at] = value), bytes))(Buffer.from(whole));
  const place = Number(whole.readBigUInt64LE(whole.length - 48));
  for (const [file, bytes, expected] of [
    ["cut.ssz", whole.subarray(0, -9), "trailer: expected an index that ends where it begins"],
    ["short.ssz", whole.subarray(0, 40), "container: expected at least 64 bytes, found 40"],
    ["new.ssz", changed(8, 9), "header: expected version 1, found version 9"],
    ["many.ssz", changed(place + 43, 0x40), "index: expected 44 bytes and 96 for each of at least one interval"],
    ["far.ssz", changed(place + 44 + 96 + 1, 0x7f), "index: interval 1: place: expected its chunk after the one before"],
    ["huge.ssz", changed(place + 44 + 51, 0x7f), "index: interval 0: counts: expected at most 2^24"],
    ["short-column.ssz", changed(16, whole[16] ^ 1), "interval 0: column kind: expected"],
  ]) {
    await drop(file, bytes);
    await page.waitForFunction((file) => new RegExp(`^${file}: (?!reading)`).test(document.getElementById("message").textContent), file);
    const found = await page.evaluate(() => document.getElementById("message").textContent);
    check(found.includes(expected) && !found.includes("\n"), `${file}: expected "${expected}", found "${found}"`);
  }
  await page.keyboard.press("Escape");
  check((await psnr(other, await look(0.3), last)) >= ENOUGH, "what is refused leaves the scene as it is");
}

/** Packets of files of images and of binary numbers equal the served ones, to the byte. */
async function others() {
  for (const format of ["sog", "glb"]) {
    const path = `${scratch}/still.${format}`;
    run(streamsplat, "export", scene, "--times", "0.1", "--quiet", "--out", path);
    const served = start(streamsplat, ["view", path, "--port", "0"], "stdout");
    const page = await opened(QUICK);
    await page.goto((await served.line).split(" ")[0]);
    const bytes = await differing(page, path);
    console.log(`${name}: still.${format}: ${bytes} bytes of its packet differ from what is served`);
    check(bytes === 0, `still.${format}: expected the packet that is served, found ${bytes} other bytes`);
    await page.close();
    served.child.kill("SIGINT");
    await served.ended;
  }
}

/** On a phone the middle of the screen belongs to the scene, with the tools closed and open, and help describes touch. */
async function phone() {
  const page = await opened(PHONE);
  await visit(page, { t: 0.25 });
  for (const tools of ["closed", "open"]) {
    if (tools === "open") await page.evaluate(() => document.getElementById("more").click());
    await keep(page, `phone-${tools}`);
    const [covering, small] = await page.evaluate(() => {
      const boxes = [...document.querySelectorAll(".panel")].map((panel) => [panel.id, panel.getBoundingClientRect()]);
      const seen = boxes.filter(([, { width }]) => width > 0);
      const small = [...document.querySelectorAll("#interface button, #interface select")].map((control) => [control.id || control.textContent, control]);
      const room = ([, control]) => control.scrollWidth <= control.clientWidth;
      const large = ([, control]) => control.getBoundingClientRect().width >= 44 && control.getBoundingClientRect().height >= 44;
      const inside = ([, control]) => control.getBoundingClientRect().left >= 0 && control.getBoundingClientRect().right <= innerWidth;
      return [
        seen.filter(([, { top, bottom }]) => bottom > 80 && top < innerHeight / 2 + 140).map(([id]) => id),
        small.filter(([, control]) => control.offsetWidth).filter((one) => !(room(one) && large(one) && inside(one))).map(([id]) => id),
      ];
    });
    check(!covering.length, `tools ${tools}: ${covering} cover the scene`);
    check(!small.length, `tools ${tools}: ${small} are smaller than 44 pixels, off the screen or without room for their text`);
  }
  await page.evaluate(() => document.getElementById("help").click());
  await keep(page, "phone-help");
  const help = await page.evaluate(() => document.getElementById("keys").innerText);
  check(/one finger/i.test(help) && /pinch/.test(help) && !/Shift|wheel|Space/.test(help), `help on a telephone: found ${help}`);
  await page.close();
}

/** A single frame has no time line. */
async function instant() {
  const one = `${scratch}/one`;
  if (!existsSync(one)) run(streamsplat, "run", CLIP, "--frames", "1", "--emit", "scene", "--quiet", "--out", one);
  const view = start(streamsplat, ["view", one, "--port", "0"], "stdout");
  const page = await opened(DESK);
  await page.goto(`${(await view.line).split(" ")[0]}#t=0`);
  await shown(page, 0);
  check(await page.evaluate(() => getComputedStyle(document.getElementById("dock")).display === "none"), "one frame has no time line");
  await page.close();
  view.child.kill("SIGINT");
  await view.ended;
}

/** Time until ten seconds from disk are visible, as one file. */
async function soon() {
  const bytes = readFileSync(CLIP);
  const header = bytes.indexOf("\n") + 1;
  const frame = "FRAME\n".length + (256 * 144 * 3) / 2;
  const frames = Array.from({ length: Math.floor((bytes.length - header) / frame) }, (_, i) => bytes.subarray(header + i * frame, header + (i + 1) * frame));
  const there = [...frames, ...frames.toReversed()];
  const [clip, html] = [`${scratch}/ten.y4m`, `${scratch}/ten.html`];
  if (!existsSync(html)) {
    writeFileSync(clip, Buffer.concat([bytes.subarray(0, header), ...Array.from({ length: 240 }, (_, i) => there[i % there.length])]));
    run(streamsplat, "run", clip, "--quality", "realtime", "--emit", "scene", "--quiet", "--out", `${scratch}/ten`);
    run(streamsplat, "view", `${scratch}/ten`, "--html", html, "--quiet");
  }
  const times = [];
  for (let i = 0; i < 3; i++) {
    const page = await opened(DESK);
    const begun = performance.now();
    // The page is still loading when it shows its first picture.
    const loaded = page.goto(`file://${html}#t=0`);
    await page.waitForFunction(() => document.getElementById("canvas")?.dataset.shown === "0").catch(() => {});
    await shown(page, 0);
    times.push(performance.now() - begun);
    await loaded;
    await page.close();
  }
  const best = Math.min(...times);
  console.log(`${name}: first picture of ten seconds (${(statSync(html).size / 1e6).toFixed(1)} MB) after ${times.map((time) => time.toFixed(0)).join(", ")} ms`);
  check(best < 3 * FIRST, `expected the first picture after at most ${3 * FIRST} ms (${FIRST} on a quiet machine), found ${best}`);
}

let page = await opened(DESK);
await visit(page, { t: 0.25 });
await keep(page, "desk");
const dB = await (async () => {
  await visit(page, { t: 0.25, interface: "none", background: 0.5 });
  const theirs = await picture(page);
  await page.keyboard.press("h");
  writeFileSync(`${scratch}/camera.json`, await page.evaluate(() => document.getElementById("camera").value));
  await page.keyboard.press("Escape");
  return psnr(other, theirs, ours(0.25, DESK, ["--camera", `${scratch}/camera.json`]));
})();
console.log(`${name}: the source's view beside ours: ${dB.toFixed(1)} dB`);
check(dB >= ENOUGH, `the source's view: expected ${ENOUGH} dB beside ours, found ${dB}`);
await page.close();
page = await opened(QUICK);
await turning(page, QUICK);
await time(page);
await saved(page);
await page.evaluate(() => location.reload());
await pause(500);
await links(page);
await containers(page);
await page.close();
await others();
await phone();
await instant();
await soon();
view.child.kill("SIGINT");
await view.ended;
await browser.close();
if (browser !== compared) await compared.close();
const said = [...log.said, ...(browser.log ?? [])];
check(said.length === 0, `the console is not clean: ${said.join("; ")}`);
