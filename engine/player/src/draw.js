// Drawing with WebGL2: splats are blended front to back into sums of colour and alpha, which are then composited onto the background.

import { SHADERS } from "./shaders.js";

export const MODES = ["colour", "depth", "identity"];
/** Records per row of the textures. Each record has two texels of 16 bytes, one texel of its rates of colour, and one in the order. */
export const PER_ROW = 1024;

/** Returns whether a program draws instead of a graphics processor: SwiftShader, which takes twice as long for 16-bit floats as for others. */
function isSwiftShader(gl) {
  const name = gl.getParameter(gl.RENDERER);
  // Chromium exposes the name by an extension, about which Firefox warns.
  const more = /^WebKit/.test(name) && gl.getExtension("WEBGL_debug_renderer_info");
  return /SwiftShader/.test(more ? gl.getParameter(more.UNMASKED_RENDERER_WEBGL) : name);
}

/** Format and type of the sums: 16-bit floats, 32-bit floats in software, or bytes if floats cannot be drawn into. */
function sumsOf(gl) {
  const float = gl.getExtension("EXT_color_buffer_float");
  if (float && isSwiftShader(gl) && gl.getExtension("EXT_float_blend")) return [gl.RGBA32F, gl.FLOAT];
  if (float ?? gl.getExtension("EXT_color_buffer_half_float")) return [gl.RGBA16F, gl.HALF_FLOAT];
  return [gl.RGBA8, gl.UNSIGNED_BYTE];
}

export class Drawing {
  constructor(canvas) {
    const options = { alpha: false, antialias: false, depth: false, stencil: false, powerPreference: "high-performance" };
    const gl = canvas.getContext("webgl2", options);
    if (!gl) throw new Error("this browser offers no WebGL2");
    this.canvas = canvas;
    this.gl = gl;
    this.sums = sumsOf(gl);
    this.prepare = this.program("resolve.vert", "prepare.frag");
    this.splat = this.program("quad.vert", "splat.frag");
    this.still = null; // program for still scenes, created on demand
    this.resolve = this.program("resolve.vert", "resolve.frag");
    /** Maximum number of Gaussians of a packet. */
    this.room = PER_ROW * gl.getParameter(gl.MAX_TEXTURE_SIZE);
    /** Maximum number of pixels per side. */
    this.largest = Math.min(gl.getParameter(gl.MAX_TEXTURE_SIZE), ...gl.getParameter(gl.MAX_VIEWPORT_DIMS));
    this.packet = null;
    this.ordered = null;
    this.orderRows = 0;
    this.records = gl.createTexture();
    this.rates = gl.createTexture();
    this.rows = gl.createTexture();
    this.order = gl.createTexture();
    // Four corners of each record in a row of the order, as two triangles.
    const corners = Uint16Array.from({ length: 6 * PER_ROW }, (_, k) => 4 * Math.floor(k / 6) + [0, 1, 2, 2, 1, 3][k % 6]);
    this.splats = gl.createVertexArray();
    gl.bindVertexArray(this.splats);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
    this.nothing = gl.createVertexArray();
    /** Output of prepare.frag for the records in the order. */
    this.prepared = [gl.createTexture(), gl.createTexture()];
    this.preparing = gl.createFramebuffer();
    this.preparedRows = 0;
    this.blended = gl.createTexture();
    this.target = gl.createFramebuffer();
    this.size = [0, 0];
  }

  program(vertex, fragment) {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, name] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, SHADERS[name]);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
      const logs = gl.getAttachedShaders(program).map((shader) => gl.getShaderInfoLog(shader));
      throw new Error(`${vertex}, ${fragment}: ${[gl.getProgramInfoLog(program), ...logs].join(" ")}`);
    }
    const at = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(program, i);
      at[name] = gl.getUniformLocation(program, name);
    }
    return { program, at };
  }

  /** Creates a texture without filtering. */
  bind(texture, unit) {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
  }

  /** Uploads a packet's records to the graphics processor, unchanged. */
  upload(packet) {
    if (this.packet === packet) return;
    const { gl } = this;
    const rows = Math.max(1, Math.ceil(packet.count / PER_ROW));
    const tooMany = (what) => new Error(`${packet.count} Gaussians are more than ${what}`);
    if (packet.count > this.room) throw tooMany("this browser draws");
    this.packet = null;
    const whole = Math.floor(packet.count / PER_ROW);
    this.fill(this.records, 0, rows, 2, packet.words, packet.count);
    if (packet.still) {
      this.fill(this.rows, 2, rows, packet.degree, packet.rows, packet.count);
      if (gl.getError() === gl.OUT_OF_MEMORY) throw tooMany("the graphics processor has memory for");
      this.packet = packet;
      return;
    }
    this.packet = packet;
    this.bind(this.rates, 2);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    const [across, down] = packet.rates.length ? [PER_ROW, rows] : [1, 1];
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8I, across, down, 0, gl.RGB_INTEGER, gl.BYTE, null);
    const paint = (row, width, height, rates) => {
      if (width && height && rates.length) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, row, width, height, gl.RGB_INTEGER, gl.BYTE, rates);
    };
    paint(0, PER_ROW, whole, packet.rates.subarray(0, whole * PER_ROW * 3));
    paint(whole, packet.count % PER_ROW, 1, packet.rates.subarray(whole * PER_ROW * 3));
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 4);
  }

  /** Fills a texture with texels of four words, `each` per record, in this number of rows. */
  fill(texture, unit, rows, each, words, count) {
    const { gl } = this;
    const whole = Math.floor(count / PER_ROW);
    this.bind(texture, unit);
    const [across, down] = each ? [each * PER_ROW, rows] : [1, 1];
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32UI, across, down, 0, gl.RGBA_INTEGER, gl.UNSIGNED_INT, null);
    const put = (row, width, height, part) => {
      if (width && height) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, row, width, height, gl.RGBA_INTEGER, gl.UNSIGNED_INT, part);
    };
    const cut = whole * PER_ROW * each * 4;
    put(0, each * PER_ROW, whole, words.subarray(0, cut));
    put(whole, each * (count % PER_ROW), 1, words.subarray(cut));
  }

  /** Sets the view's uniforms, and the records in their order. */
  setView(at, view, order, { mode, share }) {
    const { gl } = this;
    gl.uniform1f(at.grow, 1 / Math.sqrt(share));
    this.bind(this.records, 0);
    gl.uniform1i(at.records, 0);
    gl.uniform3fv(at.eye, view.eye);
    gl.uniformMatrix3fv(at.turn, false, view.axes.flat());
    gl.uniform2fv(at.focal, view.focal);
    gl.uniform1i(at.pinhole, view.pinhole ? 1 : 0);
    gl.uniform1i(at.mode, mode);
    if (this.ordered !== order) this.arrange(order);
    this.bind(this.order, 3);
    gl.uniform1i(at.order, 3);
    gl.uniform1i(at.total, order.length);
  }

  /** Activates a still scene's program. */
  useStill(packet, order, view, looks) {
    const { gl } = this;
    const { program, at } = (this.still ??= this.program("still.vert", "splat.frag"));
    gl.useProgram(program);
    this.bind(this.rows, 2);
    gl.uniform1i(at.rows, 2);
    gl.uniform1i(at.degree, packet.degree);
    gl.uniform1i(at.antialiased, packet.antialiased ? 1 : 0);
    gl.uniform2fv(at.ends, view.ends);
    this.setView(at, view, order, looks);
    return at;
  }

  /** Prepares a packet's records, and activates the program that draws them. */
  useMoving(packet, order, t, view, looks) {
    const { gl, prepare: { program, at } } = this;
    gl.useProgram(program);
    this.bind(this.rates, 2);
    gl.uniform1i(at.rates, 2);
    gl.uniform1f(at.rateStep, packet.rateStep);
    gl.uniform1f(at.beyond, packet.beyond);
    for (const name of ["positionLow", "positionStep", "velocityLow", "velocityStep"]) gl.uniform3fv(at[name], packet[name]);
    gl.uniform1f(at.t, t);
    gl.uniform2fv(at.own, view.own);
    gl.uniform1f(at.units, view.units);
    this.setView(at, view, order, looks);
    const rows = Math.ceil(order.length / PER_ROW);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.preparing);
    if (rows > this.preparedRows) {
      this.prepared.forEach((texture, i) => {
        this.bind(texture, 4 + i);
        gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32UI, PER_ROW, rows, 0, gl.RGBA_INTEGER, gl.UNSIGNED_INT, null);
        gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + i, gl.TEXTURE_2D, texture, 0);
      });
      gl.drawBuffers([gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1]);
      this.preparedRows = rows;
    }
    // A texture must not be read while it is written.
    for (const unit of [4, 5]) {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, null);
    }
    gl.viewport(0, 0, PER_ROW, rows);
    gl.bindVertexArray(this.nothing);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.useProgram(this.splat.program);
    this.prepared.forEach((texture, i) => this.bind(texture, 4 + i));
    gl.uniform1i(this.splat.at.places, 4);
    gl.uniform1i(this.splat.at.others, 5);
    gl.uniform1i(this.splat.at.total, order.length);
    gl.uniform1i(this.splat.at.mode, looks.mode);
    return this.splat.at;
  }

  /** Uploads an order to the graphics processor. */
  arrange(order) {
    const { gl } = this;
    const rows = Math.ceil(order.length / PER_ROW);
    this.bind(this.order, 3);
    if (rows > this.orderRows) {
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32UI, PER_ROW, rows, 0, gl.RED_INTEGER, gl.UNSIGNED_INT, null);
      this.orderRows = rows;
    }
    const whole = Math.floor(order.length / PER_ROW);
    const put = (row, width, height, part) => {
      if (width && height) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, row, width, height, gl.RED_INTEGER, gl.UNSIGNED_INT, part);
    };
    put(0, PER_ROW, whole, order.subarray(0, whole * PER_ROW));
    put(whole, order.length % PER_ROW, 1, order.subarray(whole * PER_ROW));
    this.ordered = order;
  }

  /** Creates sums of width × height pixels. */
  resize(width, height) {
    const { gl } = this;
    if (this.size[0] === width && this.size[1] === height) return;
    this.size = [width, height];
    this.bind(this.blended, 1);
    const [kept, kind] = this.sums;
    gl.texImage2D(gl.TEXTURE_2D, 0, kept, width, height, 0, gl.RGBA, kind, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.blended, 0);
  }

  /**
   * Draws a packet's records in `order` at t in [0, 1]; `range` are the ends of the scale of inverse depths, `share` the fraction of the records that
   * the order was chosen from, whose Gaussians are drawn larger by its root. The view determines the size of the picture. It is drawn to the canvas, or to another framebuffer with its lower left corner at x, y.
   */
  draw(packet, order, t, view, { mode, background, range, share = 1 }, { framebuffer = null, x = 0, y = 0 } = {}) {
    const { gl, resolve } = this;
    const { width, height } = view;
    this.resize(width, height);
    let at = null;
    if (order.length) {
      this.upload(packet);
      at = packet.still ? this.useStill(packet, order, view, { mode, share }) : this.useMoving(packet, order, t, view, { mode, share });
    }
    gl.viewport(0, 0, width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (at) {
      gl.uniform2f(at.size, width, height);
      gl.uniform2fv(at.middle, view.middle ?? [0, 0]);
      gl.bindVertexArray(this.splats);
      gl.enable(gl.BLEND);
      gl.blendFunc(gl.ONE_MINUS_DST_ALPHA, gl.ONE);
      gl.drawElementsInstanced(gl.TRIANGLES, 6 * Math.min(PER_ROW, order.length), gl.UNSIGNED_SHORT, 0, Math.ceil(order.length / PER_ROW));
      gl.disable(gl.BLEND);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.viewport(x, y, width, height);
    gl.useProgram(resolve.program);
    gl.uniform2i(resolve.at.corner, x, y);
    this.bind(this.blended, 1);
    gl.uniform1i(resolve.at.blended, 1);
    gl.uniform3fv(resolve.at.background, background);
    gl.uniform1i(resolve.at.mode, mode);
    gl.uniform2fv(resolve.at.range, range);
    gl.bindVertexArray(this.nothing);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}
