// packets.mjs STREAMSPLAT CONTAINER…: compares the player's packets of containers, in Node, with those that `streamsplat view` serves.

import { openAsBlob, readFileSync } from "node:fs";
import { BlobFile } from "../../../engine/player/src/blob.js";
import { Chunks, decode } from "../../../engine/player/src/chunk.js";
import { readIndex } from "../../../engine/player/src/container.js";
import { check, start } from "../browser.mjs";
import { columnOf } from "../column.mjs";

const [streamsplat, ...containers] = process.argv.slice(2);

/** The packet of an interval, through the chunks back to an independent one or after the interval before. */
async function packetOf(file, { about, chunks }, taken, i, from) {
  const parts = [];
  for (let k = from; k <= i; k++) {
    const { at, bytes, index, back } = chunks[k];
    parts.push({ bytes: await file.read(at, bytes), index, alone: back === 0, count: about.intervals[k].gaussians });
  }
  const { start, end } = about.intervals[i];
  return Buffer.from(taken.take({ place: from, parts, times: { start, end } }));
}

for (const container of containers) {
  const view = start(streamsplat, ["view", container, "--port", "0"], "stdout");
  const address = (await view.line).split(" ")[0];
  const file = new BlobFile(await openAsBlob(container));
  const index = await readIndex(file);
  const one = new Chunks();
  let bytes = 0;
  for (const [i, { back }] of index.chunks.entries()) {
    const rust = Buffer.from(await (await fetch(new URL(`interval/${i}`, address))).arrayBuffer());
    const follows = await packetOf(file, index, one, i, i);
    const alone = await packetOf(file, index, new Chunks(), i, i - back);
    for (const [how, packet] of [["after the one before", follows], ["by itself", alone]]) {
      const differs = packet.findIndex((byte, k) => byte !== rust[k]);
      check(packet.length === rust.length && differs < 0, `${container}: interval ${i} ${how}: expected ${rust.length} bytes as Rust makes them, found ${packet.length}, the first other one at ${differs}`);
    }
    bytes += rust.length;
  }
  check(new Chunks().take({ place: 1, parts: [{ alone: false }] }) === null, "a chunk without the one before is not taken");
  console.log(`${container.split("/").pop()}: ${index.chunks.length} packets, ${bytes} bytes as Rust makes them`);
  view.child.kill("SIGINT");
  await view.ended;
}

// Errors of a chunk whose lengths differ from its index, before memory is allocated.
const [container] = containers;
const whole = readFileSync(container);
const { about, chunks } = await readIndex(new BlobFile(new Blob([whole])));
const { at, bytes } = chunks[0];
const changed = (change) => {
  const chunk = Buffer.from(whole.subarray(at, at + bytes));
  change(chunk);
  return chunk;
};
const count = about.intervals[0].gaussians;
for (const [chunk, number, expected] of [
  [changed((chunk) => chunk.writeUInt32LE(2 ** 31, 0)), count, /^interval 0: column kind: expected at most \d+ numbers, found 2147483648$/],
  [changed((chunk) => chunk.writeUInt32LE(2 ** 31, 4)), count, /^interval 0: column kind: expected two lengths and as many bytes, found \d+ bytes$/],
  [changed((chunk) => chunk.writeUInt32LE(0, 0)), count, /^interval 0: column kind: expected no bytes without numbers, found \d+ bytes$/],
  [changed((chunk) => chunk.writeUInt32LE(count - 1, 0)), count, /^interval 0: column kind: expected \d+ numbers, found \d+$/],
  [changed((chunk) => (chunk[8] = 2)), count, /^interval 0: column kind: expected 1 or 8 tables, found 2$/],
  [changed((chunk) => chunk.fill(0, 10, 10 + chunk[9])), count, /^interval 0: column kind: expected a table with a weight above 0, found none$/],
  [changed(() => {}), count + 1, /^interval 0: column kind: expected \d+ numbers, found \d+$/],
  [changed(() => {}), count - 1, /^interval 0: column kind: expected at most \d+ numbers, found \d+$/],
  [changed(() => {}).subarray(0, -1), count, /^interval 0: column merge_other: expected two lengths/],
  [Buffer.concat([changed(() => {}), Buffer.alloc(1)]), count, /^interval 0: chunk: expected its end after the last column, found 1 more bytes$/],
]) {
  const times = about.intervals[0];
  const parts = [{ bytes: new Uint8Array(chunk), index: 0n, alone: true, count: number }];
  let found = "a packet";
  try {
    new Chunks().take({ place: 0, parts, times });
  } catch (e) {
    found = e.message;
  }
  check(expected.test(found), `expected ${expected}, found ${found}`);
}

// Identities, births and key frames are 64-bit numbers, modulo 2⁶⁴.
const MODULUS = 2n ** 64n;
const folded = (x) => (x >= 0n ? 2n * x : -2n * x - 1n);
let state = 1n;
const random = () => BigInt.asIntN(64, (state = (state * 6364136223846793005n + 1442695040888963407n) % MODULUS) ^ (state >> 29n));
const differences = [3, 4, 5].map(() => Array.from({ length: 200 }, random));
const columns = Array.from({ length: 31 }, (_, column) => {
  const differs = differences[column - 4];
  return columnOf(column === 1 || column === 2 || column > 23 ? [] : differs ? differs.map(folded) : new Array(200).fill(0));
});
const wide = decode(Buffer.concat(columns), null, { count: 200 });
const at64 = (words, i) => (BigInt(words[2 * i + 1]) << 32n) | BigInt(words[2 * i]);
let [expected, frame] = [0n, 0n];
for (let i = 0; i < 200; i++) {
  const [identity, birth, key] = differences.map((column) => column[i]);
  frame = BigInt.asUintN(64, frame + key);
  const own = BigInt.asUintN(64, expected + identity);
  expected = own + 1n;
  const found = [wide.identity, wide.birth, wide.frame].map((words) => at64(words, i));
  check(found[0] === own && found[1] === BigInt.asUintN(64, frame - birth) && found[2] === frame, `record ${i}: expected ${own}, ${frame}, found ${found}`);
}
