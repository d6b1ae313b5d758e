// Files of Gaussians with other descriptions than the program writes.

import { crc32 } from "node:zlib";

/** A binary glTF file whose document `change` has changed. */
export function documented(bytes, change) {
  const length = bytes.readUInt32LE(12);
  const document = JSON.parse(bytes.subarray(20, 20 + length));
  const text = change(document) ?? JSON.stringify(document);
  const json = Buffer.from(text.padEnd(Math.ceil(text.length / 4) * 4));
  const head = Buffer.from(bytes.subarray(0, 20));
  head.writeUInt32LE(bytes.length - length + json.length, 8);
  head.writeUInt32LE(json.length, 12);
  return Buffer.concat([head, json, bytes.subarray(20 + length)]);
}

/** A SOG file whose stored meta.json has `part` replaced by no longer a text, which blanks fill, and its checksums set. */
export function metaChanged(bytes, part, text) {
  const file = Buffer.from(bytes);
  const [local, entry] = [file.indexOf("meta.json") - 30, file.lastIndexOf("meta.json") - 46];
  const start = local + 30 + "meta.json".length;
  const meta = file.subarray(start, start + file.readUInt32LE(local + 22));
  const found = part.exec(meta.toString("latin1"));
  meta.write(text.padEnd(found[0].length), found.index, "latin1");
  const sum = crc32(meta);
  file.writeUInt32LE(sum, local + 14);
  file.writeUInt32LE(sum, entry + 16);
  return file;
}
