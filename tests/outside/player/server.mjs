// A server of files with ranges, which records requests.

import { closeSync, fstatSync, openSync, readSync } from "node:fs";
import { createServer } from "node:http";
import { once } from "node:events";
import { extname, resolve, sep } from "node:path";

const TYPES = { ".html": "text/html", ".js": "text/javascript", ".mjs": "text/javascript", ".json": "application/json" };

/** Bytes of a file, which is opened for one response. */
function part(path, from, length) {
  const file = openSync(path);
  try {
    const bytes = Buffer.alloc(length);
    return bytes.subarray(0, readSync(file, bytes, 0, length, from));
  } finally {
    closeSync(file);
  }
}

function sizeOf(path) {
  const file = openSync(path);
  try {
    const found = fstatSync(file);
    return found.isFile() ? found.size : -1;
  } finally {
    closeSync(file);
  }
}

/**
 * Serves `folders`, selected by the start of the address. `asked` lists every request for a `.ssz`: { path, from, length, range, method }. `change` may replace
 * the response: a function of these and of the file's `size` that returns { status, headers, bytes } or nothing. Without `ranges`, files are sent whole. Other
 * sites may use everything, and read the headers in `exposed`.
 */
export async function serve(folders) {
  const state = { asked: [], change: null, ranges: true, exposed: "Content-Range, ETag" };
  const server = createServer((request, response) => {
    const path = decodeURIComponent(new URL(request.url, "http://localhost").pathname);
    const begins = Object.keys(folders).filter((name) => path.startsWith(`/${name}/`)).sort((a, b) => b.length - a.length)[0];
    const folder = begins && resolve(folders[begins]);
    const file = folder && resolve(folder, path.slice(begins.length + 2));
    let size = -1;
    try {
      if (file?.startsWith(folder + sep)) size = sizeOf(file);
    } catch {
      // There is none.
    }
    if (size < 0) {
      response.writeHead(404).end();
      return;
    }
    const range = state.ranges && /^bytes=(\d+)-(\d+)$/.exec(request.headers.range ?? "");
    const from = range ? Number(range[1]) : 0;
    const length = range ? Math.min(Number(range[2]) + 1, size) - from : size;
    if (length < 0 || (range && !length)) {
      response.writeHead(416, { "Content-Range": `bytes */${size}` }).end();
      return;
    }
    const shared = { "Access-Control-Allow-Origin": "*", "Access-Control-Expose-Headers": state.exposed };
    const headers = { ...shared, "Content-Type": TYPES[extname(file)] ?? "application/octet-stream", "Cache-Control": "no-store", ETag: `"${size}"` };
    if (range) headers["Content-Range"] = `bytes ${from}-${from + length - 1}/${size}`;
    if (file.endsWith(".ssz")) state.asked.push({ path, from, length, range: Boolean(range), method: request.method });
    const changed = file.endsWith(".ssz") && state.change?.({ path, from, length, size, headers });
    const { status = range ? 206 : 200, bytes = null } = changed || {};
    const body = bytes ?? part(file, from, length);
    response.writeHead(status, { ...headers, ...changed?.headers, "Content-Length": body.length });
    response.end(request.method === "HEAD" ? null : body);
  });
  server.listen(0, "127.0.0.1");
  await once(server, "listening");
  return Object.assign(state, { address: `http://127.0.0.1:${server.address().port}`, close: () => server.close() });
}
