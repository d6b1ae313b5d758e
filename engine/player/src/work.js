// The worker: decodes chunks and keeps records in order, so that the page only draws.

import { Chunks } from "./chunk.js";
import { Packet } from "./packet.js";
import { Sorter } from "./sort.js";

const chunks = new Chunks();
const sorters = new Map();

/** Answers with a packet, whose records are kept in order from now on. */
export function taken(ticket, interval, packet, buffer, more = {}) {
  sorters.set(interval, new Sorter(packet));
  postMessage({ ticket, buffer, ...more }, [buffer]);
}

/** Tasks by kind of question. */
export const WORK = {
  /** Decodes the chunks of the intervals that end with this one. */
  parts({ ticket, interval, ...rest }) {
    try {
      const buffer = chunks.take(rest);
      if (!buffer) return void postMessage({ ticket, lost: true });
      taken(ticket, interval, new Packet(buffer), buffer);
    } catch (e) {
      chunks.place = -1;
      postMessage({ ticket, error: e.message });
    }
  },

  sort({ ticket, interval, t, view }) {
    const { order, work } = sorters.get(interval)?.sort(t, view) ?? { order: null };
    postMessage({ ticket, order, work }, order ? [order.buffer] : []);
  },

  forget({ interval }) {
    sorters.delete(interval);
  },
};

/** Runs the task of a question. */
export function answer({ data }) {
  try {
    WORK[data.kind](data);
  } catch (e) {
    postMessage({ ticket: data.ticket, error: e.message });
  }
}
