// fuzz.mjs INPUTS READER…; from the repository's root. The readers run in a watched thread. A reader that does not return, or takes too much memory, is a
// finding, and so is an error of no reader's own kind.

import { isMainThread, parentPort, Worker, workerData } from "node:worker_threads";
import { fileURLToPath } from "node:url";
import { prepared, readers } from "./readers.mjs";
import { mutated, random } from "./mutate.mjs";

/** Limits: seconds for every input, and bytes of the whole process. */
const [LONGEST, MOST] = [20, 1.5 * 2 ** 30];

if (isMainThread) {
  const [inputs = "3000", ...named] = process.argv.slice(2);
  const known = Object.keys(readers());
  const other = named.find((name) => !known.includes(name));
  if (other || !/^[1-9]\d*$/.test(inputs)) {
    console.error(other ? `${other}: expected one of ${known.join(", ")}` : `${inputs}: expected a number of inputs`);
    process.exit(2);
  }
  for (const name of named.length ? named : known) await watched(name, Number(inputs));
} else {
  await fuzz(workerData);
}

/** Runs a reader's inputs in a thread, and ends with its finding. */
function watched(name, inputs) {
  const began = performance.now();
  const progress = new Float64Array(new SharedArrayBuffer(8));
  const worker = new Worker(fileURLToPath(import.meta.url), { workerData: { name, inputs, progress } });
  const failed = (what) => {
    console.error(`${name}: input ${progress[0]}: ${what}`);
    process.exit(1);
  };
  let [last, since, peak] = [-1, performance.now(), 0];
  const clock = setInterval(() => {
    peak = Math.max(peak, process.memoryUsage.rss());
    if (peak > MOST) failed(`${Math.round(peak / 2 ** 20)} MiB`);
    if (progress[0] !== last) [last, since] = [progress[0], performance.now()];
    else if (performance.now() - since > 1000 * LONGEST) failed(`no answer in ${LONGEST} seconds`);
  }, 50);
  return new Promise((done) => {
    worker.on("error", (error) => failed(error.stack));
    worker.on("message", ({ finding, read, refused }) => {
      if (finding) failed(finding);
      const seconds = ((performance.now() - began) / 1000).toFixed(0);
      console.log(`${name}: ${inputs} inputs, ${read} read, ${refused} refused, ${Math.round(peak / 2 ** 20)} MiB, ${seconds} s`);
      clearInterval(clock);
      done();
    });
  });
}

/** Reads inputs of one reader; each is a function of its number alone. */
async function fuzz({ name, inputs, progress }) {
  const { seeds, read, refusal } = await prepared(name);
  let [good, refused] = [0, 0];
  for (let i = 0; i < inputs; i++) {
    progress[0] = i;
    const chance = random(i);
    // The unchanged seeds come first: they must be accepted.
    const input = i < seeds.length ? seeds[i] : mutated(seeds[chance(seeds.length)], seeds, chance);
    try {
      await read(input, chance);
      good++;
    } catch (error) {
      if (i < seeds.length || !refusal(error)) {
        const text = Buffer.from(input).toString("base64").slice(0, 4000);
        parentPort.postMessage({ finding: `${error.stack}\n${text}` });
        return;
      }
      refused++;
    }
  }
  parentPort.postMessage({ read: good, refused });
}
