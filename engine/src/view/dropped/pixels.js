// Pixels of images as they are stored: a canvas would multiply them by their alpha.

/** An image of four pixels of which browsers that multiply by alpha, or add noise against recognition, return others; and those pixels. */
const PROBE = "UklGRkIAAABXRUJQVlA4TDYAAAAvAwAAEB+gIAABRP1wzXWvBAJEjC49upwpaNuG6SFV/qx2paBtA+Tg3zFF/Qw7lX6OLkX0PwA=";
const PROBED = [200, 100, 50, 0, 7, 131, 250, 1, 93, 31, 254, 252, 128, 127, 1, 255];
/** Whether this browser returns the stored pixels; null before the first image. */
let isExact = null;

/** The pixels of a WebP image, row by row: red, green, blue, alpha. */
async function pixelsOf(bytes, width, height, name) {
  isExact ??= await decoded(Uint8Array.from(atob(PROBE), (c) => c.charCodeAt(0)), 4, 1, name).then((found) => PROBED.every((value, k) => found[k] === value));
  if (!isExact) throw wrong(name, "a browser that reads pixels as they are stored", `others, as of protection against recognition ${program()}`);
  return decoded(bytes, width, height, name);
}

async function decoded(bytes, width, height, name) {
  const as = { premultiplyAlpha: "none", colorSpaceConversion: "none" };
  const bitmap = await createImageBitmap(new Blob([bytes], { type: "image/webp" }), as).catch((e) => {
    throw wrong(name, "a whole WebP image", quoted(e.message));
  });
  const gl = new OffscreenCanvas(1, 1).getContext("webgl2");
  try {
    if (bitmap.width !== width || bitmap.height !== height) throw wrong(name, `${width}×${height} pixels`, `${bitmap.width}×${bitmap.height}`);
    if (!gl) throw wrong(name, "WebGL2 in this browser, which reads its pixels", `none ${program()}`);
    const largest = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    if (Math.max(width, height) > largest) throw wrong(name, `at most ${largest} pixels a side in this browser`, `${width}×${height}`);
    const pixels = roomFor(4 * width * height, name);
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
    gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, gl.getParameter(gl.TEXTURE_BINDING_2D), 0);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    const failed = gl.getError();
    if (failed) throw wrong(name, "pixels that this browser can read", `error ${failed} of WebGL`);
    return pixels;
  } finally {
    gl?.getExtension("WEBGL_lose_context")?.loseContext();
    bitmap.close();
  }
}
