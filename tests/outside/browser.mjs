// Shared by tests in a browser: headless Chromium with WebGL2 in software, running programs, comparison of pictures.

import { spawn, spawnSync } from "node:child_process";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { basename } from "node:path";

/** Debian's Chromium, driven by the playwright-core in the folder of packages `modules`. Colours are returned unchanged. */
export async function chromium(modules, ...more) {
  const { chromium } = createRequire(`${modules}/`)("playwright-core");
  const gpu = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"];
  return chromium.launch({
    executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
    args: ["--headless", "--no-sandbox", "--force-color-profile=srgb", ...gpu, ...more],
    env: { ...process.env, LANG: "C.UTF-8" },
  });
}

/** A page of width × height pixels; its console messages, errors and requests are added to `log`. */
export async function open(browser, [width, height], log) {
  const page = await browser.newPage({ viewport: { width, height }, deviceScaleFactor: 1, reducedMotion: "reduce" });
  page.setDefaultTimeout(60_000);
  page.on("console", (message) => log.said.push(`${message.type()}: ${message.text()}`));
  page.on("pageerror", (error) => log.said.push(`error: ${error}`));
  page.on("requestfailed", (request) => log.said.push(`failed: ${request.url()}`));
  page.on("request", (request) => log.asked.push(request.url()));
  return page;
}

/**
 * The picture of a page at rest, as PNG bytes. A canvas's drawing reaches the screen some frames later, in a slow browser after the next screenshot. So
 * pictures are taken until two in a row are equal.
 */
export async function picture(page) {
  let last = null;
  for (let i = 0; i < 50; i++) {
    const now = await page.screenshot();
    if (last?.equals(now)) return now;
    last = now;
    await page.evaluate(() => {
      document.querySelector("canvas")?.getContext("webgl2")?.finish();
      return new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
    });
  }
  throw new Error("expected a page at rest, found another picture each time");
}

/** Compares the packet that the worker of a page from `view` makes of the same file with the served one; returns the number of bytes that differ. */
export const differing = (page, path) =>
  page.evaluate(async ([name, bytes]) => {
    const file = new File([Uint8Array.from(atob(bytes), (c) => c.charCodeAt(0))], name);
    const worker = new Worker(URL.createObjectURL(new Blob([document.getElementById("worker").textContent])));
    const { buffer, still, error } = await new Promise((done) => {
      worker.onmessage = ({ data }) => done(data);
      worker.postMessage({ kind: "file", file, most: 1e6, ticket: 1 });
    });
    worker.terminate();
    if (error) throw new Error(error);
    const served = new Uint8Array(await (await fetch("interval/0")).arrayBuffer());
    const about = (await (await fetch("scene.json?from=0")).json()).still;
    const own = new Uint8Array(buffer);
    const same = Object.keys(about).filter((key) => key !== "view").every((key) => JSON.stringify(about[key]) === JSON.stringify(still[key]));
    if (!same || own.length !== served.length) throw new Error(`${JSON.stringify(still)}, served ${JSON.stringify(about)}`);
    return own.reduce((sum, byte, i) => sum + (byte === served[i] ? 0 : 1), 0);
  }, [basename(path), readFileSync(path).toString("base64")]);

/** Runs a program to its end; returns its standard output. */
export function run(program, ...args) {
  const { status, stdout, stderr, error } = spawnSync(program, args, { encoding: "utf8" });
  if (status !== 0) throw new Error(`${program} ${args.join(" ")}: ${error ?? ""} ${status} ${stderr}`);
  return stdout;
}

/** A running program: `line` is its first line on `stream`, `ended` its exit code. */
export function start(program, args, stream) {
  const child = spawn(program, args);
  const ended = new Promise((done) => child.on("exit", done));
  const line = new Promise((done, failed) => {
    let text = "";
    child[stream].on("data", (data) => (text += data).includes("\n") && done(text.split("\n")[0]));
    child.on("exit", () => failed(new Error(`${args.join(" ")}: ended before it said anything`)));
  });
  child[stream === "stdout" ? "stderr" : "stdout"].resume();
  const end = () => child.kill();
  process.on("exit", end);
  child.on("exit", () => process.off("exit", end));
  return { child, line, ended };
}

/** Peak signal-to-noise ratio in dB of two PNG files (names or bytes) of the same size, over red, green and blue. */
export async function psnr(page, ...files) {
  const pictures = files.map((file) => (typeof file === "string" ? readFileSync(file) : file).toString("base64"));
  return page.evaluate(async (pictures) => {
    const decode = async (picture) => {
      const bytes = Uint8Array.from(atob(picture), (c) => c.charCodeAt(0));
      const image = await createImageBitmap(new Blob([bytes], { type: "image/png" }));
      const context = new OffscreenCanvas(image.width, image.height).getContext("2d");
      context.drawImage(image, 0, 0);
      return context.getImageData(0, 0, image.width, image.height);
    };
    const [a, b] = await Promise.all(pictures.map(decode));
    if (a.width !== b.width || a.height !== b.height) throw new Error(`${a.width}×${a.height} beside ${b.width}×${b.height}`);
    let sum = 0;
    a.data.forEach((value, i) => (sum += i % 4 < 3 ? (value - b.data[i]) ** 2 : 0));
    return 10 * Math.log10((255 ** 2 * 3 * a.width * a.height) / sum);
  }, pictures);
}

/** A test: fails with `what` where `holds` is false. */
export function check(holds, what) {
  if (!holds) throw new Error(what);
}
