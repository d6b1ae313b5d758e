// A file behind an address, read by byte ranges (RFC 9110, section 14).

import { BlobFile } from "./blob.js";
import { wrong } from "./errors.js";

/** Bytes of the first request, and of the request for the file's end. */
const BLOCK = 2 ** 16;
/** Maximum bytes of a file that a server sends only as a whole. */
const MOST_WHOLE = 2 ** 30;

/** Returns the size in `bytes 0-99/1234`. */
const sizeIn = (range) => Number(/\/(\d+)$/.exec(range ?? "")?.[1] ?? NaN);

export class RemoteFile {
  /** Opens the file at an address and reads its first bytes. A server without ranges sends the whole file. */
  static async open(address, { signal } = {}) {
    const file = new RemoteFile(address, signal);
    const answer = await file.ask({ Range: `bytes=0-${BLOCK - 1}` });
    // Servers answer this for an empty file.
    if (answer.status === 416) throw wrong("file", "a container", "no bytes");
    if (answer.status === 200) return file.whole(answer);
    file.tag = answer.headers.get("etag");
    file.size = sizeIn(answer.headers.get("content-range"));
    // Another site's server may hide that header from this page.
    if (!Number.isFinite(file.size)) file.size = Number((await file.ask({}, "HEAD")).headers.get("content-length") ?? NaN);
    if (!(file.size >= 0)) throw wrong(address, "a Content-Range with the file's size", answer.headers.get("content-range") ?? "none that can be read");
    file.parts.push({ from: 0, bytes: await file.bytesOf(answer, Math.min(BLOCK, file.size)) });
    return file;
  }

  constructor(address, signal) {
    [this.address, this.signal, this.size, this.tag] = [address, signal, 0, null];
    /** Bytes in memory: the file's beginning and its end. */
    this.parts = [];
    /** Number of requests, and bytes received. */
    this.traffic = { requests: 0, bytes: 0 };
  }

  async ask(headers, method = "GET") {
    this.traffic.requests++;
    const answer = await fetch(this.address, { method, headers, signal: this.signal });
    if (!answer.ok && answer.status !== 416) throw wrong(this.address, "the file", `${answer.status} ${answer.statusText}`.trim());
    return answer;
  }

  async whole(answer) {
    const length = Number(answer.headers.get("content-length") ?? 0);
    if (length > MOST_WHOLE) {
      answer.body.cancel();
      throw wrong(this.address, `a server that sends parts of a file of more than ${MOST_WHOLE} bytes`, `${length} bytes`);
    }
    const blob = await answer.blob();
    const file = new BlobFile(blob);
    this.traffic.bytes += blob.size;
    file.traffic = this.traffic;
    return file;
  }

  /** Reads the body of an answer, which must be `length` bytes long. */
  async bytesOf(answer, length) {
    const said = answer.headers.get("content-length");
    const bytes = said === null ? await this.counted(answer, length) : Number(said) === length && new Uint8Array(await answer.arrayBuffer());
    if (bytes?.length !== length) {
      answer.body?.cancel().catch(() => {});
      throw wrong(this.address, `${length} bytes`, bytes ? bytes.length : said);
    }
    this.traffic.bytes += length;
    return bytes;
  }

  /** Reads a body without a Content-Length. */
  async counted(answer, length) {
    const [bytes, reader] = [new Uint8Array(length), answer.body.getReader()];
    for (let at = 0; ; ) {
      const { done, value } = await reader.read();
      if (done) return bytes.subarray(0, at);
      if (at + value.length > length) {
        reader.cancel().catch(() => {});
        throw wrong(this.address, `${length} bytes`, "more");
      }
      bytes.set(value, at);
      at += value.length;
    }
  }

  async read(from, length) {
    const held = this.parts.find((part) => from >= part.from && from < part.from + part.bytes.length);
    const had = held ? Math.min(length, held.from + held.bytes.length - from) : 0;
    const known = held?.bytes.subarray(from - held.from, from - held.from + had);
    if (had === length) return known.slice();
    // The index and the trailer are at the end, and are read together.
    const ends = from + length === this.size && length < BLOCK;
    const begin = ends ? Math.max(0, this.size - BLOCK) : from + had;
    const more = await this.range(begin, ends ? this.size - begin : length - had);
    if (ends) {
      this.parts.push({ from: begin, bytes: more });
      return this.read(from, length);
    }
    if (!had) return more;
    const bytes = new Uint8Array(length);
    bytes.set(known);
    bytes.set(more, had);
    return bytes;
  }

  async range(from, length) {
    const answer = await this.ask({ Range: `bytes=${from}-${from + length - 1}` });
    const [tag, range] = [answer.headers.get("etag"), answer.headers.get("content-range")];
    if (tag !== this.tag || (range && sizeIn(range) !== this.size)) throw wrong(this.address, "the file that was opened", "another one in its place");
    const said = range && /^bytes (\d+)-/.exec(range);
    if (answer.status !== 206 || (said && Number(said[1]) !== from)) {
      throw wrong(this.address, `bytes from ${from} on`, range ?? `an answer with status ${answer.status}`);
    }
    return this.bytesOf(answer, length);
  }

  /** Drops the file's end, which contained the index. */
  indexed() {
    this.parts.length = Math.min(1, this.parts.length);
  }
}
