// Byte access to files. A file is any object with a `size` that reads bytes: { size, read(from, length) }.

import { wrong } from "./errors.js";

/** A file or another Blob. */
export class BlobFile {
  constructor(blob) {
    [this.blob, this.size] = [blob, blob.size];
  }

  async read(from, length) {
    const buffer = await this.blob.slice(from, from + length).arrayBuffer();
    if (buffer.byteLength !== length) throw wrong("file", `${length} bytes from byte ${from} on`, buffer.byteLength);
    return new Uint8Array(buffer);
  }
}
