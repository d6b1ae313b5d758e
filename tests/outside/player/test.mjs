// test.mjs NODE-MODULES STREAMSPLAT SCRATCH-FOLDER BROWSER [rate]; from the repository's root. The player in Chromium or Firefox. Pictures are written to the
// scratch folder for inspection. `rate` measures the pictures per second alone, also with all pixels, and where the processor's time goes.

import { existsSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { check, chromium, open, psnr, run } from "../browser.mjs";
import { firefox } from "../firefox.mjs";
import { indexOf, longer } from "./long.mjs";
import { serve } from "./server.mjs";

const [modules, streamsplat, scratch, name, part] = process.argv.slice(2);
const CLIP = "fixtures/clips/moving.y4m";
const SIZE = [512, 288];
/** PSNR of the player's pictures against those of `render`, in dB: of its own drawing, and of other engines, which blend bytes. */
const [ENOUGH, BLENDED] = [50, 36];
/** Pictures per second on two free cores; a sixth of them is enough on a machine with other work. */
const RATE = 30;
/** Limit of packet bytes that the long clip keeps, and of the growth of the browser's memory while it plays. */
const ROOM = 24 * 2 ** 20;
const GROWTH = 32 * 2 ** 20;
/** The long clip is played as often as this until its memory no longer grows. */
const TIMES = 5;

const log = { said: [], asked: [] };
const compared = await chromium(modules);
const other = await compared.newPage();
const browser = name === "firefox" ? await firefox(scratch) : compared;
const opened = (size) => (name === "firefox" ? browser.open(size) : open(browser, size, log));
const keep = async (page, what) => writeFileSync(`${scratch}/${name}-${what}.png`, await page.screenshot());

const [scene, short, long] = ["scene", "scene.ssz", "long.ssz"].map((file) => `${scratch}/${file}`);
if (!existsSync(long)) {
  run(streamsplat, "run", CLIP, "--gap", "4", "--frames", "13", "--depth", "auto", "--emit", "scene", "--quiet", "--out", scene);
  run(streamsplat, "export", scene, "--format", "ssz", "--quiet", "--out", short);
  writeFileSync(long, longer(readFileSync(short), 60));
}
const index = indexOf(readFileSync(short));
const server = await serve({
  player: "engine/player",
  "player/examples/node_modules": modules,
  test: "tests/outside/player",
  scratch,
});

const pause = (milliseconds) => new Promise((done) => setTimeout(done, milliseconds));

/** A page with an element of these attributes that shows a clip. */
async function put(page, attributes) {
  await page.evaluate((attributes) => window.put(attributes), attributes);
}
const shown = (page) => page.waitForFunction(() => window.first);

/** The canvas at a time, as PNG bytes. */
async function at(page, time) {
  await page.evaluate((time) => window.element.seek(time), time);
  // With all pixels, in the order of exactly this time and view.
  await page.waitForFunction(() => {
    const { detail, shown, stale, due } = window.element.player;
    return detail === 1 && shown.exact && !stale && !due;
  });
  let last = null;
  for (let i = 0; i < 50; i++) {
    const now = await page.screenshot();
    if (last?.equals(now)) return now;
    last = now;
    await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
  }
  throw new Error("expected a player at rest, found another picture each time");
}

/** Our render at a time. */
function ours(time, more = []) {
  run(streamsplat, "render", short, "--times", String(time), "--size", SIZE.join("x"), "--quiet", ...more, "--out", `${scratch}/ours`);
  return `${scratch}/ours/frames/000000.png`;
}

/** The first picture appears before the rest of the file has arrived; pictures equal ours; events have a video's order. */
async function streaming(page) {
  server.asked.length = 0;
  await put(page, { src: "/scratch/long.ssz", background: "0.5" });
  await shown(page);
  const [first, size] = [await page.evaluate(() => window.first), readFileSync(long).length];
  // The header, the index at the end, the rest of the first chunk, and up to two chunks read ahead.
  check(first.requests <= 6 && first.bytes < size / 20, `first picture: expected it after six requests, found ${first.requests} and ${first.bytes} of ${size} bytes`);
  check(server.asked.every(({ range }) => range), "requests have a range");
  const events = await page.evaluate(() => window.events);
  check(events.slice(0, 2).join() === "loadedmetadata,loadeddata", `expected loadedmetadata and loadeddata, found ${events}`);
  console.log(`${name}: first picture of a minute (${(size / 1e6).toFixed(0)} MB) after ${first.requests} requests and ${(first.bytes / 1e6).toFixed(2)} MB`);
}

/** A seek takes one request, for the chunks back to an independent one; seeking there again takes none. */
async function seeking(page) {
  const { entries } = indexOf(readFileSync(long));
  const place = entries.findIndex(({ start, back }) => start > 40 && back === 3);
  const { start, at: begin, bytes } = entries[place];
  const from = entries[place - 3].at;
  /** Waits until two seconds pass without a request. */
  const rests = async () => {
    for (let last = -1; last !== server.asked.length; await pause(2000)) last = server.asked.length;
  };
  await rests();
  server.asked.length = 0;
  const time = start - entries[0].start + 0.05;
  const seconds = await page.evaluate(async (time) => {
    const before = performance.now();
    await window.element.seek(time);
    return (performance.now() - before) / 1000;
  }, time);
  const [asked] = server.asked;
  check(asked.from === from && asked.length === begin + bytes - from, `a jump: expected bytes ${from} to ${begin + bytes}, found ${asked.length} from ${asked.from}`);
  const ahead = server.asked.slice(1);
  check(ahead.every(({ from }) => from >= begin + bytes), `read ahead: expected what follows, found ${JSON.stringify(ahead)}`);
  await rests();
  const more = server.asked.length;
  const seekable = entries.filter((entry) => entry.start >= start && entry.end <= start + 2.5).length;
  check(more <= seekable + 1, `a jump: expected ${seekable} intervals of the next seconds at most, found ${more} requests`);
  await page.evaluate((time) => window.element.seek(time), time);
  check(server.asked.length === more, `there again: expected no request, found ${server.asked.length - more}`);
  console.log(`${name}: a jump to 40 s: one request for its picture, ${asked.length} bytes, ${seconds.toFixed(2)} s`);
}

async function pictures(page) {
  await put(page, { src: "/scratch/scene.ssz", background: "0.5" });
  await shown(page);
  // Out of order: chunks need those before them.
  for (const time of [0.45, 0.1, 0.3]) {
    const dB = await psnr(other, await at(page, time), ours(time));
    console.log(`${name}: ${time} s from our render: ${dB.toFixed(1)} dB`);
    check(dB >= ENOUGH, `${time} s: expected ${ENOUGH} dB from our render, found ${dB}`);
  }
  const before = await at(page, 0.3);
  await page.evaluate(() => window.element.look({ yaw: 12, pitch: -5, zoom: 1.2, lens: "perspective" }));
  await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
  await keep(page, "turned");
  const view = await page.evaluate(() => window.element.view);
  check(view.yaw === 12 && view.pitch === -5 && Math.abs(view.zoom - 1.2) < 1e-9 && view.lens === "perspective", `the view: found ${JSON.stringify(view)}`);
  check((await psnr(other, await at(page, 0.3), before)) < 30, "a turned scene looks other");
  await page.evaluate(() => window.element.home());
  check((await psnr(other, await at(page, 0.3), before)) >= 50, "the source's view comes back");
}

/** Playing to the end, again from the beginning, and the controls. */
async function playing(page) {
  await put(page, { src: "/scratch/scene.ssz", controls: "" });
  await shown(page);
  await page.evaluate(() => (window.element.play(), (window.events.length = 0)));
  await page.waitForFunction(() => window.element.ended);
  const ended = await page.evaluate(() => [window.events.filter((event) => event !== "waiting" && event !== "playing").join(), window.element.paused, window.element.currentTime]);
  check(ended[0] === "pause,ended" && ended[1] && Math.abs(ended[2] - 0.5) < 1e-9, `the end: found ${ended}`);
  const inside = (what) => page.evaluate((what) => window.element.shadowRoot.querySelector(what).click(), what);
  await inside("button");
  await page.waitForFunction(() => !window.element.paused && window.element.currentTime < 0.4);
  await inside("button");
  check(await page.evaluate(() => window.element.paused), "the button pauses");
  await page.evaluate(() => {
    const slider = window.element.shadowRoot.querySelector("input");
    slider.value = "0.25";
    slider.dispatchEvent(new Event("input", { bubbles: true }));
  });
  await page.waitForFunction(() => Math.abs(window.element.player.shown?.time - 0.25) < 1e-9);
  await keep(page, "controls");
  await page.mouse.move(256, 100);
  await page.mouse.down();
  await page.mouse.move(306, 100, { steps: 4 });
  const yaw = await page.evaluate(() => window.element.view.yaw);
  await page.mouse.up();
  check(yaw < -3 && yaw > -8, `a drag of 50 pixels: expected 6 degrees, found ${yaw}`);
  await page.evaluate(() => {
    window.element.player.loop = true;
    window.element.player.playbackRate = 4;
    window.element.play();
  });
  const turns = await page.evaluate(async () => {
    let [turns, last] = [0, 0];
    for (const end = performance.now() + 20000; turns < 2 && performance.now() < end; ) {
      await new Promise(requestAnimationFrame);
      if (window.element.currentTime < last) turns++;
      last = window.element.currentTime;
    }
    return turns;
  });
  check(turns === 2, "a loop begins again");
}

/** Errors are one line; a server without ranges works. */
async function errors(page) {
  const whole = readFileSync(short);
  const damaged = Buffer.from(whole);
  damaged.writeUInt32LE(2 ** 31, index.entries[2].at);
  writeFileSync(`${scratch}/damaged.ssz`, damaged);
  writeFileSync(`${scratch}/cut.ssz`, whole.subarray(0, -9));
  writeFileSync(`${scratch}/other.ssz`, readFileSync("README.md"));
  writeFileSync(`${scratch}/empty.ssz`, "");
  const failing = async (file, expected) => {
    await put(page, { src: `/scratch/${file}` });
    await page.waitForFunction(() => window.errors.length || window.first);
    // An interval that is not needed at once fails when it is.
    await page.evaluate(() => window.first && window.element.player.play());
    await page.waitForFunction(() => window.errors.length);
    const found = await page.evaluate(() => [window.errors[0], window.element.shadowRoot.querySelector(".message").textContent]);
    check(expected.test(found[0]) && !found[0].includes("\n") && expected.test(found[1]), `${file}: expected ${expected}, found ${found}`);
  };
  await failing("cut.ssz", /^trailer: expected an index that ends where it begins, found /);
  await failing("other.ssz", /^header: expected a container's first bytes, found others$/);
  await failing("empty.ssz", /^file: expected a container, found no bytes$/);
  await failing("none.ssz", /^\/scratch\/none\.ssz: expected the file, found 404/);
  await failing("damaged.ssz", /^interval 2: column kind: expected at most \d+ numbers, found 2147483648$/);
  server.change = ({ from }) => (from > 0 ? { headers: { ETag: '"another"' } } : null);
  await failing("scene.ssz", /^\/scratch\/scene\.ssz: expected the file that was opened, found another one in its place$/);
  server.change = ({ from, size }) => (from > 0 ? { bytes: Buffer.alloc(size - from - 1) } : null);
  await failing("scene.ssz", /^\/scratch\/scene\.ssz: expected \d+ bytes, found \d+$/);
  server.change = ({ from }) => (from > 0 ? { headers: { "Content-Range": "bytes 1-2/3" } } : null);
  await failing("scene.ssz", /^\/scratch\/scene\.ssz: expected the file that was opened, found another one/);
  server.change = null;
  server.ranges = false;
  await put(page, { src: "/scratch/scene.ssz", background: "0.5" });
  await shown(page);
  const dB = await psnr(other, await at(page, 0.3), ours(0.3));
  check(dB >= ENOUGH, `a server without ranges: expected ${ENOUGH} dB from our render, found ${dB}`);
  server.ranges = true;
  // Bytes in memory, and invalid data.
  const said = await page.evaluate(async () => {
    const bytes = await (await fetch("/scratch/scene.ssz")).arrayBuffer();
    await window.element.load(new File([bytes], "a.ssz"));
    const duration = window.element.duration;
    const told = [];
    for (const wrong of [() => window.element.load(7), () => window.element.seek(NaN), () => window.element.look({ yaw: "a" }), () => (window.element.player.mode = "x")]) {
      try {
        await wrong();
        told.push("nothing");
      } catch (e) {
        told.push(e.message);
      }
    }
    return [duration, ...told];
  });
  const expected = [0.5, "source: expected an address, a Blob or bytes, found number", "time: expected a number of seconds, found NaN", "yaw: expected a number, found a", "mode: expected colour, depth, identity, found x"];
  check(said.join("; ") === expected.join("; "), `expected ${expected.join("; ")}, found ${said.join("; ")}`);
}

/** Resident bytes of this process's children and theirs: the browser's. */
function memory() {
  const all = readdirSync("/proc").filter((name) => /^\d+$/.test(name)).flatMap((pid) => {
    try {
      const fields = readFileSync(`/proc/${pid}/stat`, "utf8").split(") ").pop().split(" ");
      return [{ pid: Number(pid), parent: Number(fields[1]), ticks: Number(fields[11]) + Number(fields[12]), bytes: 4096 * Number(fields[21]) }];
    } catch {
      return [];
    }
  });
  const [ours, found] = [new Set([process.pid]), []];
  for (let more = true; more; ) {
    more = false;
    for (const one of all) {
      if (!ours.has(one.pid) && ours.has(one.parent)) (ours.add(one.pid), found.push(one), (more = true));
    }
  }
  const sum = (what) => found.reduce((sum, one) => sum + one[what], 0);
  return { bytes: sum("bytes"), seconds: sum("ticks") / 100, found };
}

/**
 * A minute is played again and again, small, so that drawing does not take the time. From the second time on, the second half takes no more memory than the
 * first. On a busy machine the browser's heap may grow longer before it is collected; what is never freed grows each time.
 */
async function minute(page) {
  await put(page, { src: "/scratch/long.ssz", room: String(ROOM), playbackrate: "4", loop: "", style: "width: 128px; height: 72px" });
  await shown(page);
  const began = performance.now();
  await page.evaluate(() => window.element.play());
  const megabytes = (bytes) => `${(bytes / 2 ** 20).toFixed(0)} MiB`;
  let [last, laps, most, grown, halves] = [0, 0, 0, Infinity, [[], []]];
  while (laps < 2 || (laps < TIMES && grown > GROWTH)) {
    check(performance.now() - began < 900_000, `a minute: expected its end ${TIMES} times within 900 s, found it at ${last} s`);
    await pause(500);
    const { time, kept, errors } = await page.evaluate(() => ({ time: window.element.currentTime, kept: window.element.player.clip.kept, errors: window.errors }));
    check(!errors.length, `a minute: ${errors}`);
    if (time < last) {
      laps++;
      if (laps > 1) {
        const [early, late] = halves.map((half) => half.sort((a, b) => a - b)[half.length >> 1]);
        grown = late - early;
        const seconds = (performance.now() - began) / 1000;
        console.log(`${name}: a minute, ${laps} times in ${seconds.toFixed(0)} s: ${megabytes(early)} and ${megabytes(late)} in the last one's halves`);
      }
      halves = [[], []];
    }
    [last, most] = [time, Math.max(most, kept)];
    halves[time < 30 ? 0 : 1].push(memory().bytes);
  }
  console.log(`${name}: packets of ${megabytes(most)}`);
  check(most <= ROOM + 2 ** 21, `a minute: expected packets of ${ROOM} bytes, found ${most}`);
  check(grown <= GROWTH, `a minute: expected ${megabytes(GROWTH)} more at most, found ${megabytes(grown)}`);
}

/** Pictures per second while it plays; `whole`: with all pixels, however long they take. */
async function rate(page, whole = false) {
  await put(page, { src: "/scratch/scene.ssz", loop: "" });
  await shown(page);
  if (whole) await page.evaluate(() => (window.element.player.pace.turn = () => false));
  await page.evaluate(() => window.element.play());
  // The level of detail settles.
  await pause(4000);
  const drawn = () => page.evaluate(() => [window.element.player.pictures, window.element.player.pace, performance.now()].map((x) => (typeof x === "number" ? x : [x.detail, x.share])));
  const [before, work, threads] = [await drawn(), memory().seconds, part && threadTimes()];
  await pause(6000);
  const [after, worked] = [await drawn(), memory().seconds];
  const pictures = after[0] - before[0];
  const second = (1000 * pictures) / (after[2] - before[2]);
  const each = (1000 * (worked - work)) / pictures;
  const { gaussians } = index.entries[1];
  console.log(`${name}: ${second.toFixed(1)} pictures a second of ${SIZE.join("x")}, ${gaussians} Gaussians, sides at ${after[1][0].toFixed(2)}, ${after[1][1].toFixed(2)} of the Gaussians; ${each.toFixed(0)} ms of processors' time each`);
  if (part) {
    for (const [thread, time] of threadTimes()) threads.set(thread, time - (threads.get(thread) ?? 0));
    const most = [...threads].sort((a, b) => b[1] - a[1]).slice(0, 9);
    console.log(most.map(([thread, time]) => `  ${((1000 * time) / pictures).toFixed(1)} ms a picture: ${thread}`).join("\n"));
    return;
  }
  check(second >= RATE / 6, `expected ${RATE} pictures a second, a sixth of them on a machine with other work, found ${second}`);
  // At rest all pixels and all Gaussians are there again.
  await page.evaluate(() => window.element.pause());
  const rest = () => window.element.player.detail === 1 && window.element.player.shown.share === 1 && window.element.player.shown.exact;
  await page.waitForFunction(rest);
}

/** Seconds of the processor by process and thread, of this process's descendants. */
function threadTimes() {
  const times = new Map();
  for (const { pid } of memory().found) {
    const kind = /--type=(\S+)/.exec(readFileSync(`/proc/${pid}/cmdline`, "latin1").replaceAll("\0", " "))?.[1] ?? "main";
    for (const thread of readdirSync(`/proc/${pid}/task`)) {
      const [, called, rest] = /\((.*)\) (.*)/s.exec(readFileSync(`/proc/${pid}/task/${thread}/stat`, "latin1"));
      const fields = rest.split(" ");
      times.set(`${kind} ${pid}, ${called} ${thread}`, (Number(fields[11]) + Number(fields[12])) / 100);
    }
  }
  return times;
}

/** The package and the clip on another site, whose headers the page may read or not. */
async function elsewhere(page) {
  const far = await serve({ player: "engine/player", scratch });
  for (const exposed of ["Content-Range, ETag", ""]) {
    far.exposed = exposed;
    far.asked.length = 0;
    await page.goto(`${server.address}/test/page.html?player=${encodeURIComponent(`${far.address}/player/src/index.js`)}`);
    await page.waitForFunction(() => window.ready);
    await put(page, { src: `${far.address}/scratch/scene.ssz`, background: "0.5" });
    await shown(page);
    const dB = await psnr(other, await at(page, 0.3), ours(0.3));
    check(dB >= ENOUGH, `another site: expected ${ENOUGH} dB from our render, found ${dB}`);
    const heads = far.asked.filter(({ method }) => method === "HEAD").length;
    check(heads === (exposed ? 0 : 1), `another site: expected ${exposed ? "no" : "one"} question about the file's size, found ${heads}`);
  }
  far.close();
  await page.goto(`${server.address}/test/page.html`);
  await page.waitForFunction(() => window.ready);
}

/** Waits until an engine has drawn the received data. */
const settled = (page) => page.evaluate(async () => {
  const turns = async () => {
    for (let i = 0; i < 6; i++) await new Promise(requestAnimationFrame);
  };
  await turns();
  await new Promise((done) => setTimeout(done, 500));
  await turns();
});

/** Colours of some pixels of a picture. */
const coloursOf = (png, places) => other.evaluate(async ([png, places]) => {
  const bytes = Uint8Array.from(atob(png), (c) => c.charCodeAt(0));
  const image = await createImageBitmap(new Blob([bytes], { type: "image/png" }));
  const context = new OffscreenCanvas(image.width, image.height).getContext("2d");
  context.drawImage(image, 0, 0);
  return places.map(([x, y]) => [...context.getImageData(x, y, 1, 1).data].slice(0, 3));
}, [png.toString("base64"), places]);

/** The example of another engine: the scene and two boxes hide each other. Returns its page. */
async function among(engine, hide) {
  const page = await opened([800, 500]);
  await page.goto(`${server.address}/player/examples/${engine}.html?src=/scratch/scene.ssz&t=0.4&turn=10`);
  await page.waitForFunction(() => window.video?.packet);
  await settled(page);
  const both = await page.screenshot();
  await keep(page, engine);
  await page.evaluate(hide, false);
  await settled(page);
  const without = await page.screenshot();
  await page.evaluate(hide, true);
  // The box in front; the one behind, where it is visible and where the scene hides it; the scene alone.
  const places = [[190, 420], [690, 210], [560, 210], [400, 330]];
  const [a, b] = [await coloursOf(both, places), await coloursOf(without, places)];
  const same = places.map((_, i) => a[i].every((level, k) => Math.abs(level - b[i][k]) <= 8));
  check(same.join() === "true,true,false,false", `${engine}: expected both boxes and the scene, found ${JSON.stringify([a, b])}`);
  check(a[0][0] > 180 && a[1][1] > 120, `${engine}: expected the boxes' colours, found ${JSON.stringify(a)}`);
  return page;
}

/** An engine's picture from the source's camera is our render. */
async function fromSource(page, engine, draw) {
  await page.evaluate(draw, SIZE);
  await settled(page);
  const picture = Buffer.from(await page.evaluate(() => (window.draw(), window.canvas.toDataURL("image/png").split(",")[1])), "base64");
  writeFileSync(`${scratch}/${name}-${engine}-source.png`, picture);
  const dB = await psnr(other, picture, ours(0.3));
  console.log(`${name}: ${engine} from the source's camera from our render: ${dB.toFixed(1)} dB`);
  check(dB >= BLENDED, `${engine}: expected ${BLENDED} dB from our render, found ${dB}`);
  await page.close();
}

async function three() {
  const page = await among("three", (on) => (window.video.visible = on));
  await fromSource(page, "three", ([width, height]) => {
    const { THREE, renderer, video } = window;
    renderer.setAnimationLoop(null);
    renderer.setSize(width, height);
    const scene = new THREE.Scene();
    scene.background = new THREE.Color(0x808080);
    scene.add(video);
    const [across, down] = video.size.map((side) => side / 2);
    const camera = new THREE.OrthographicCamera(-across, across, down, -down, 0.1, 40);
    camera.position.z = 20;
    window.video.currentTime = 0.3;
    window.canvas = renderer.domElement;
    window.draw = () => renderer.render(scene, camera);
    renderer.setAnimationLoop(window.draw);
  });
}

async function playcanvas() {
  const page = await among("playcanvas", (on) => (window.video.entity.enabled = on));
  await fromSource(page, "playcanvas", ([width, height]) => {
    const { pc, app, camera, video, front, behind } = window;
    for (const entity of [front, behind]) entity.destroy();
    app.off("update");
    app.setCanvasFillMode(pc.FILLMODE_NONE, width, height);
    app.setCanvasResolution(pc.RESOLUTION_FIXED, width, height);
    camera.setPosition(0, 0, 20);
    camera.setEulerAngles(0, 0, 0);
    Object.assign(camera.camera, { projection: pc.PROJECTION_ORTHOGRAPHIC, orthoHeight: video.size[1] / 2, clearColor: new pc.Color(0.5, 0.5, 0.5) });
    video.currentTime = 0.3;
    window.canvas = app.graphicsDevice.canvas;
    window.draw = () => app.render();
  });
}

/** A headset, emulated by iwer: each eye's picture equals our render from there; time continues, a trigger stops it, and the canvas returns at the end. */
async function headset() {
  const [width, height] = SIZE;
  const page = await opened([2 * width, height]);
  await page.goto(`${server.address}/test/page.html`);
  await page.addScriptTag({ url: "/player/examples/node_modules/iwer/build/iwer.min.js" });
  await page.evaluate(async ([width, height]) => {
    const { XRDevice, metaQuest3 } = window.IWER;
    const device = (window.device = new XRDevice(metaQuest3, { stereoEnabled: true, fovy: 0.9 }));
    device.installRuntime({ forceInstall: true });
    const { Player, offersHeadset } = await import("/player/src/index.js");
    if (!(await offersHeadset())) throw new Error("expected a headset, found none");
    document.body.innerHTML = `<div><canvas style="display: block; width: ${width}px; height: ${height}px"></canvas></div>`;
    const player = (window.player = new Player(document.querySelector("canvas"), { background: 0.5 }));
    window.events = [];
    for (const name of ["vrenter", "vrleave"]) player.addEventListener(name, () => window.events.push(name));
    await player.load("/scratch/scene.ssz");
    await player.seek(0.3);
    const { draw } = player.drawing;
    player.drawing.draw = function (...all) {
      (window.views ??= []).push(all[3]);
      draw.apply(this, all);
    };
    await player.enterVR();
    const { x, y, z } = device.position;
    device.position.set(x + 0.3, y - 0.1, z + 0.2);
    device.quaternion.set(0.02988, 0.08984, -0.0027, 0.9955); // turned and raised, not rolled
  }, [2 * width, height]);
  await settled(page);
  const both = await page.screenshot();
  await keep(page, "headset");
  const views = await page.evaluate(async () => {
    const { cameraFile } = await import("/player/src/camera.js");
    return window.views.slice(-2).map(cameraFile);
  });
  const apart = Math.hypot(...views[0].position.map((x, i) => x - views[1].position[i]));
  check(apart > 0.01 && apart < 1, `eyes: expected them apart, found ${apart}`);
  for (const [eye, camera] of views.entries()) {
    writeFileSync(`${scratch}/eye.json`, JSON.stringify(camera));
    const dB = await psnr(other, await cut(both, eye * width), ours(0.3, ["--camera", `${scratch}/eye.json`]));
    console.log(`${name}: eye ${eye} from our render: ${dB.toFixed(1)} dB`);
    check(dB >= ENOUGH, `eye ${eye}: expected ${ENOUGH} dB from our render, found ${dB}`);
  }
  const times = await page.evaluate(async () => {
    const { player, device } = window;
    const turns = async () => {
      for (let i = 0; i < 10; i++) await new Promise(requestAnimationFrame);
    };
    player.loop = true;
    const before = player.currentTime;
    const pressed = async () => {
      device.controllers.right.updateButtonValue("trigger", 1);
      await turns();
      device.controllers.right.updateButtonValue("trigger", 0);
      await turns();
      return !player.paused;
    };
    const [on, moved, off] = [await pressed(), player.currentTime !== before, await pressed()];
    await player.leaveVR();
    return [on, moved, off, window.events.join(), player.headset];
  });
  check(times.join() === "true,true,false,vrenter,vrleave,", `a headset: found ${times}`);
  // Eyes look past the middle of their pictures: the same picture, shifted to the side by that many pixels.
  const shifts = await page.evaluate(async ([width, height]) => {
    const { roomOf, viewFrom } = await import("/player/src/headset.js");
    const { clip, drawing, shown } = window.player;
    const [matrix, looks] = [[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1], window.player.found(shown.view).looks];
    const drawn = (across, up) => {
      const projection = [2, 0, 0, 0, 0, 2, 0, 0, (2 * across) / width, (2 * up) / height, -1, -1, 0, 0, 0, 0];
      drawing.draw(shown.packet, shown.order, shown.t, viewFrom(roomOf(clip.camera), { matrix, projection }, width, height), looks);
      const pixels = new Uint8Array(width * height * 4);
      drawing.gl.readPixels(0, 0, width, height, drawing.gl.RGBA, drawing.gl.UNSIGNED_BYTE, pixels);
      return pixels;
    };
    const [plain, moved] = [drawn(0, 0), drawn(40, 20)];
    // Rows are from below: to the left, and down.
    let [most, spread] = [0, 0];
    for (let y = 60; y < height - 60; y++) {
      for (let x = 80; x < 4 * (width - 80); x++) {
        most = Math.max(most, Math.abs(plain[4 * width * y + x + 160] - moved[4 * width * (y - 20) + x]));
        spread = Math.max(spread, Math.abs(plain[4 * width * y + x] - moved[4 * width * y + x]));
      }
    }
    return [most, spread];
  }, SIZE);
  check(shifts[0] <= 2 && shifts[1] > 40, `past the middle: expected the same picture 40 and 20 pixels away, found levels ${shifts} apart`);
  await page.close();
}

/** Part of a picture of two, from its left end on. */
async function cut(png, left) {
  const cut = await other.evaluate(async ([png, left, [width, height]]) => {
    const bytes = Uint8Array.from(atob(png), (c) => c.charCodeAt(0));
    const canvas = Object.assign(document.createElement("canvas"), { width, height });
    canvas.getContext("2d").drawImage(await createImageBitmap(new Blob([bytes], { type: "image/png" })), -left, 0);
    return canvas.toDataURL("image/png").split(",")[1];
  }, [png.toString("base64"), left, SIZE]);
  return Buffer.from(cut, "base64");
}

/** The example of the element, and the page of docs/recipes.md with another scene's name. */
async function example() {
  const page = await opened([960, 700]);
  const [, recipe] = /^```html\n(.*?)^```/ms.exec(readFileSync("docs/recipes.md", "utf8"));
  writeFileSync(`${scratch}/recipe.html`, `<!doctype html><link rel="icon" href="data:,"><base href="/">${recipe.replace("drawn.ssz", "scratch/scene.ssz")}`);
  await page.goto(`${server.address}/scratch/recipe.html`);
  // The page is left when it has read everything: a request that is given up is an error in the log.
  await page.waitForFunction(() => {
    const { pictures, clip } = document.querySelector("streamsplat-player").player ?? {};
    return pictures > 0 && clip.store.kept.size === clip.intervals.length;
  });
  await page.goto(`${server.address}/player/examples/player.html?src=/scratch/scene.ssz`);
  await page.waitForFunction(() => document.querySelector("streamsplat-player").player?.pictures > 3);
  await keep(page, "example");
  await page.close();
}

const page = await opened(SIZE);
await page.goto(`${server.address}/test/page.html`);
await page.waitForFunction(() => window.ready);
if (part === "rate") {
  await rate(page);
  await rate(page, true);
  await browser.close();
  if (browser !== compared) await compared.close();
  process.exit();
}
await streaming(page);
await seeking(page);
await pictures(page);
await playing(page);
await rate(page);
await minute(page);
check([...log.said, ...(browser.log ?? [])].length === 0, `the console is not clean: ${[...log.said, ...(browser.log ?? [])].join("; ")}`);
await elsewhere(page);
await errors(page);
log.said.length = 0;
if (browser.log) browser.log.length = 0;
await page.close();
await three();
await playcanvas();
await example();
// Firefox is driven without scripts from other addresses; the headset's code is the same.
if (name === "chromium") await headset();
await browser.close();
if (browser !== compared) await compared.close();
server.close();
const said = [...log.said, ...(browser.log ?? [])];
check(said.length === 0, `the console is not clean: ${said.join("; ")}`);
