// Debian's Firefox, driven by WebDriver BiDi, which it supports itself. Pages have the calls of playwright-core that tests in both browsers use
// (playwright-core 1.65 sends this Firefox a command that it does not support).

import { spawn } from "node:child_process";
import { once } from "node:events";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";

/** Less motion, no first-run pages; `download` is the folder of downloads. */
const settings = (download) => ({
  "ui.prefersReducedMotion": 1,
  "datareporting.policy.dataSubmissionEnabled": false,
  "browser.shell.checkDefaultBrowser": false,
  "browser.download.folderList": 2,
  "browser.download.dir": download,
  "browser.download.alwaysOpenPanel": false,
  "gfx.color_management.mode": 0,
  "webgl.force-enabled": true,
  "dom.events.testing.asyncClipboard": true,
});

const KEYS = { Escape: "\uE00C", Space: " ", Home: "\uE011", End: "\uE010", ArrowLeft: "\uE012", ArrowRight: "\uE014", Shift: "\uE008" };

/** A browser without a window. */
export async function firefox(download) {
  const profile = mkdtempSync(join(tmpdir(), "firefox-"));
  const lines = Object.entries(settings(download)).map(([name, value]) => `user_pref(${JSON.stringify(name)}, ${JSON.stringify(value)});\n`);
  writeFileSync(join(profile, "user.js"), lines.join(""));
  const args = ["--no-remote", "--remote-debugging-port=0", "--profile", profile, "about:blank"];
  const child = spawn(process.env.FIREFOX ?? "/usr/bin/firefox-esr", args, { env: { ...process.env, LANG: "C.UTF-8" } });
  const end = () => child.kill();
  process.on("exit", end);
  const address = await new Promise((done, failed) => {
    let text = "";
    child.stderr.on("data", (data) => {
      const found = /WebDriver BiDi listening on (ws:\S+)/.exec((text += data));
      if (found) done(found[1]);
    });
    child.on("exit", () => failed(new Error(`Firefox ended: ${text}`)));
  });
  const socket = new WebSocket(`${address}/session`);
  await once(socket, "open");
  const [asked, log] = [new Map(), []];
  socket.onmessage = ({ data }) => {
    const { id, type, method, params, result, message, error } = JSON.parse(data);
    if (method === "log.entryAdded") log.push(`${params.level}: ${params.text}`);
    const call = asked.get(id);
    if (!call) return;
    asked.delete(id);
    if (type === "error") call.failed(new Error(`${error}: ${message}`));
    else call.done(result);
  };
  let last = 0;
  const send = (method, params) =>
    new Promise((done, failed) => {
      asked.set(++last, { done, failed });
      socket.send(JSON.stringify({ id: last, method, params }));
    });
  const { capabilities } = await send("session.new", { capabilities: {} });
  await send("session.subscribe", { events: ["log.entryAdded"] });
  return {
    version: () => capabilities.browserVersion,
    /** The pages' console messages. */
    log,
    async open([width, height]) {
      const { context } = await send("browsingContext.create", { type: "tab" });
      await send("browsingContext.setViewport", { context, viewport: { width, height }, devicePixelRatio: 1 });
      return new Page(send, context);
    },
    async close() {
      const gone = once(child, "exit");
      await send("browser.close", {}).catch(() => {});
      setTimeout(end, 5000).unref();
      await gone;
      process.off("exit", end);
      rmSync(profile, { recursive: true, force: true });
    },
  };
}

class Page {
  constructor(send, context) {
    this.send = (method, params) => send(method, { context, ...params });
    this.context = context;
    const pointer = (actions) => this.send("input.performActions", { actions: [{ type: "pointer", id: "mouse", actions }] });
    this.mouse = {
      move: (x, y, { steps = 1 } = {}) => {
        const [fromX, fromY] = this.place ?? [x, y];
        this.place = [x, y];
        const part = (from, to, i) => Math.round(from + ((to - from) * i) / steps);
        return pointer(Array.from({ length: steps }, (_, i) => ({ type: "pointerMove", x: part(fromX, x, i + 1), y: part(fromY, y, i + 1) })));
      },
      down: () => pointer([{ type: "pointerDown", button: 0 }]),
      up: () => pointer([{ type: "pointerUp", button: 0 }]),
      click: (x, y) => pointer([{ type: "pointerMove", x, y }, { type: "pointerDown", button: 0 }, { type: "pointerUp", button: 0 }]),
    };
    this.keyboard = {
      press: (name) => {
        const keys = (name.length > 1 ? name.split("+") : [name]).map((key) => KEYS[key] ?? key);
        const actions = [...keys.map((value) => ({ type: "keyDown", value })), ...keys.reverse().map((value) => ({ type: "keyUp", value }))];
        return this.send("input.performActions", { actions: [{ type: "key", id: "keys", actions }] });
      },
    };
  }

  goto(url) {
    return this.send("browsingContext.navigate", { url, wait: "complete" });
  }

  async evaluate(work, argument) {
    const expression = `Promise.resolve((${work})(${JSON.stringify(argument)})).then((found) => JSON.stringify(found) ?? "null")`;
    const { type, result, exceptionDetails } = await this.send("script.evaluate", {
      expression,
      target: { context: this.context },
      awaitPromise: true,
      userActivation: true,
    });
    if (type !== "success") throw new Error(exceptionDetails.text);
    return JSON.parse(result.value);
  }

  async waitForFunction(work, argument) {
    for (const end = Date.now() + 60_000; Date.now() < end; await new Promise((done) => setTimeout(done, 50))) {
      if (await this.evaluate(`async (argument) => Boolean(await (${work})(argument))`, argument)) return;
    }
    throw new Error(`expected within a minute: ${work}`);
  }

  async screenshot() {
    return Buffer.from((await this.send("browsingContext.captureScreenshot", { origin: "viewport" })).data, "base64");
  }

  close() {
    return this.send("browsingContext.close", {});
  }
}
