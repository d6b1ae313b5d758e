// Pixels of images as they are stored: a canvas would multiply them by their alpha.

/** The pixels of a WebP image, row by row: red, green, blue, alpha. */
async function pixelsOf(bytes, width, height, name) {
  const as = { premultiplyAlpha: "none", colorSpaceConversion: "none" };
  const bitmap = await createImageBitmap(new Blob([bytes], { type: "image/webp" }), as).catch((e) => {
    throw wrong(name, "a whole WebP image", e.message);
  });
  if (bitmap.width !== width || bitmap.height !== height) throw wrong(name, `${width}×${height} pixels`, `${bitmap.width}×${bitmap.height}`);
  const gl = new OffscreenCanvas(1, 1).getContext("webgl2");
  if (!gl) throw new Error("this browser offers no WebGL2");
  const largest = gl.getParameter(gl.MAX_TEXTURE_SIZE);
  if (Math.max(width, height) > largest) throw wrong(name, `at most ${largest} pixels a side in this browser`, `${width}×${height}`);
  gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
  gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, gl.getParameter(gl.TEXTURE_BINDING_2D), 0);
  const pixels = new Uint8Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  const failed = gl.getError();
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  bitmap.close();
  if (failed) throw wrong(name, "pixels that this browser can read", `error ${failed} of WebGL`);
  return pixels;
}
