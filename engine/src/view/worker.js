// The page's worker: what the player's does, packets as they come from the server, still scenes, and files that were opened.

/** A packet of either kind. */
const packed = (ticket, interval, buffer, more) => taken(ticket, interval, packetIn(buffer), buffer, more);

async function stillOf(text) {
  const bytes = bytesOf(text);
  const stream = new Blob([bytes.subarray(4, 4 + new DataView(bytes.buffer).getUint32(0, true))]).stream();
  return new Response(stream.pipeThrough(new DecompressionStream("deflate-raw"))).arrayBuffer();
}

Object.assign(WORK, {
  /** A packet as it came from the server. */
  packet({ ticket, interval, buffer }) {
    packed(ticket, interval, buffer);
  },

  /** The text of a still scene: the length of what follows, and that, compressed. */
  still({ ticket, interval, text }) {
    stillOf(text).then(
      (buffer) => packed(ticket, interval, buffer),
      (e) => postMessage({ ticket, error: e.message }),
    );
  },

  /** A file that was opened on the page. */
  file({ ticket, file, most, axes }) {
    opened(file, most, axes).then(
      ({ buffer, scene, ...still }) => (buffer ? packed(ticket, 0, buffer, { still }) : postMessage({ ticket, scene })),
      (e) => postMessage({ ticket, error: e.message }),
    );
  },
});

onmessage = answer;
