// The worker: takes chunks apart and keeps records in order, so that the page only draws.

const chunks = new Chunks();
const sorters = new Map();
/** Chunks are taken apart one after another. */
let queue = Promise.resolve();

function taken(ticket, interval, buffer, more = {}) {
  sorters.set(interval, new Sorter(packetIn(buffer)));
  postMessage({ ticket, buffer, ...more }, [buffer]);
}

const WORK = {
  /** A packet as it came from the server. */
  packet({ ticket, interval, buffer }) {
    taken(ticket, interval, buffer);
  },

  /** The text of a still scene: the length of what follows, and that, compressed. */
  still({ ticket, interval, text }) {
    const bytes = bytesOf(text);
    const length = new DataView(bytes.buffer).getUint32(0, true);
    inflated(bytes.subarray(4, 4 + length)).then(
      (packet) => taken(ticket, interval, packet.buffer),
      (e) => postMessage({ ticket, error: e.message }),
    );
  },

  /** A file that was opened on the page. */
  file({ ticket, file, most, axes }) {
    opened(file, most, axes).then(
      ({ buffer, about, chunks, ...still }) => (buffer ? taken(ticket, 0, buffer, { still }) : postMessage({ ticket, about, chunks })),
      (e) => postMessage({ ticket, error: e.message }),
    );
  },

  /** The chunks of the intervals that end with this one, as texts or bytes. */
  parts({ ticket, interval, ...rest }) {
    queue = queue.then(async () => {
      try {
        taken(ticket, interval, await chunks.take(rest));
      } catch (e) {
        chunks.place = -1;
        postMessage({ ticket, error: e.message });
      }
    });
  },

  sort({ ticket, interval, t, view }) {
    const { order, work } = sorters.get(interval)?.sort(t, view) ?? { order: null };
    postMessage({ ticket, order, work }, order ? [order.buffer] : []);
  },

  forget({ interval }) {
    sorters.delete(interval);
  },
};

onmessage = ({ data }) => {
  try {
    WORK[data.kind](data);
  } catch (e) {
    postMessage({ ticket: data.ticket, error: e.message });
  }
};
