#!/usr/bin/env bash
# Package: iwer 2.5.0 (npm), the emulator of WebXR headsets, in desktop Chromium (its page from 127.0.0.1, a secure context).
# Behaviour: `new XRDevice(metaQuest3).installRuntime()` installs nothing there, as Chromium always has a `navigator.xr` of its own, without a headset. Nothing
#   is thrown; a warning is printed on the console. `isSessionSupported("immersive-vr")` stays false, and a test looks as if the page were at fault. With
#   `installRuntime({ forceInstall: true })` it is true.
# Guess beforehand: true in both; the package is for desktops without a headset.
#
# Output of 2026-11-28 (Chromium 156):
#   installRuntime(): immersive-vr false, 1 warning
#   installRuntime({ forceInstall: true }): immersive-vr true, 0 warnings
#
# Consequence: tests/outside/player/test.mjs forces it.
# Needs node, npm and a Chromium at $CHROMIUM (/usr/bin/chromium, as Debian's package has it). Fails where the behaviour differs.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
npm init -y >/dev/null
npm install --silent --no-audit --no-fund iwer@2.5.0 playwright-core@1.65.1
cat >test.mjs <<'JS'
import { readFileSync } from "node:fs";
import { createServer } from "node:http";
import { chromium } from "playwright-core";
const script = readFileSync("node_modules/iwer/build/iwer.min.js");
const server = createServer(({ url }, response) => {
  response.setHeader("Content-Type", url === "/iwer.js" ? "text/javascript" : "text/html");
  response.end(url === "/iwer.js" ? script : '<!doctype html><link rel="icon" href="data:,"><script src="/iwer.js"></script>');
});
await new Promise((listening) => server.listen(0, "127.0.0.1", listening));
const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: ["--headless", "--no-sandbox"] });
const found = [];
for (const [options, text] of [[undefined, ""], [{ forceInstall: true }, "{ forceInstall: true }"]]) {
  const page = await browser.newPage();
  let warnings = 0;
  page.on("console", (message) => (warnings += message.type() === "warning"));
  await page.goto(`http://127.0.0.1:${server.address().port}/`);
  const vr = await page.evaluate(async (options) => {
    new IWER.XRDevice(IWER.metaQuest3).installRuntime(options);
    return isSecureContext && navigator.xr.isSessionSupported("immersive-vr");
  }, options);
  console.log(`installRuntime(${text}): immersive-vr ${vr}, ${warnings} warning${warnings === 1 ? "" : "s"}`);
  found.push(vr, warnings);
}
await browser.close();
server.close();
if (found.join() !== "false,1,true,0") process.exit(1);
JS
node test.mjs
