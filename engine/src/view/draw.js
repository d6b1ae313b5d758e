// Drawing with WebGL2: splats front to back into sums of colour and alpha, then those onto the background.

const MODES = ["colour", "depth", "identity"];
/** Records in a row of the textures; each has two texels of 16 bytes, and one of its rates of colour. */
const PER_ROW = 1024;

class Drawing {
  constructor(canvas) {
    const options = { alpha: false, antialias: false, depth: false, stencil: false, powerPreference: "high-performance" };
    const gl = canvas.getContext("webgl2", options);
    if (!gl) throw new Error("this browser offers no WebGL2");
    this.canvas = canvas;
    this.gl = gl;
    // Sums in 16-bit floats where they can be drawn into, else in bytes.
    this.deep = Boolean(gl.getExtension("EXT_color_buffer_float") ?? gl.getExtension("EXT_color_buffer_half_float"));
    this.splat = this.program("splat.vert", "splat.frag");
    this.still = null; // its program, once there is a still scene
    this.resolve = this.program("resolve.vert", "resolve.frag");
    /** Gaussians of a packet at most. */
    this.room = PER_ROW * gl.getParameter(gl.MAX_TEXTURE_SIZE);
    /** Pixels of a side at most. */
    this.largest = Math.min(gl.getParameter(gl.MAX_TEXTURE_SIZE), ...gl.getParameter(gl.MAX_VIEWPORT_DIMS));
    this.packet = null;
    this.ordered = null;
    this.records = gl.createTexture();
    this.rates = gl.createTexture();
    this.rows = gl.createTexture();
    this.order = gl.createBuffer();
    this.splats = gl.createVertexArray();
    gl.bindVertexArray(this.splats);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(0, 1);
    this.nothing = gl.createVertexArray();
    this.blended = gl.createTexture();
    this.target = gl.createFramebuffer();
    this.size = [0, 0];
  }

  program(vertex, fragment) {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, name] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, document.getElementById(name).textContent);
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

  /** A texture without filtering. */
  bind(texture, unit) {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
  }

  /** Takes a packet's records to the graphics processor, as they are. */
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

  /** Fills a texture of so many rows with texels of four words, `each` per record. */
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

  /** Chooses the program for a packet and gives it what it needs of that. */
  choose(packet, t, view) {
    const { gl } = this;
    if (packet.still) {
      const { program, at } = (this.still ??= this.program("still.vert", "splat.frag"));
      gl.useProgram(program);
      this.bind(this.rows, 2);
      gl.uniform1i(at.rows, 2);
      gl.uniform1i(at.degree, packet.degree);
      gl.uniform1i(at.antialiased, packet.antialiased ? 1 : 0);
      gl.uniform2fv(at.ends, view.ends);
      return at;
    }
    const { program, at } = this.splat;
    gl.useProgram(program);
    this.bind(this.rates, 2);
    gl.uniform1i(at.rates, 2);
    gl.uniform1f(at.rateStep, packet.rateStep);
    for (const name of ["positionLow", "positionStep", "velocityLow", "velocityStep"]) gl.uniform3fv(at[name], packet[name]);
    gl.uniform1f(at.t, t);
    gl.uniform2fv(at.own, view.own);
    gl.uniform1f(at.units, view.units);
    return at;
  }

  /** Sums as large as the canvas. */
  resize() {
    const { gl, canvas } = this;
    const [width, height] = this.size;
    if (width === canvas.width && height === canvas.height) return;
    this.size = [canvas.width, canvas.height];
    this.bind(this.blended, 1);
    const [kept, kind] = this.deep ? [gl.RGBA16F, gl.HALF_FLOAT] : [gl.RGBA8, gl.UNSIGNED_BYTE];
    gl.texImage2D(gl.TEXTURE_2D, 0, kept, canvas.width, canvas.height, 0, gl.RGBA, kind, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.blended, 0);
  }

  /** Draws a packet's records in `order` at t in [0, 1]; `range` are the ends of the scale of inverse depths. */
  draw(packet, order, t, view, { mode, background, range }) {
    const { gl, resolve, canvas } = this;
    this.resize();
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (order.length) {
      this.upload(packet);
      const at = this.choose(packet, t, view);
      this.bind(this.records, 0);
      gl.uniform1i(at.records, 0);
      gl.uniform3fv(at.eye, view.eye);
      gl.uniformMatrix3fv(at.turn, false, view.axes.flat());
      gl.uniform2fv(at.focal, view.focal);
      gl.uniform1i(at.pinhole, view.pinhole ? 1 : 0);
      gl.uniform2f(at.size, canvas.width, canvas.height);
      gl.uniform1i(at.mode, mode);
      gl.bindVertexArray(this.splats);
      gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
      if (this.ordered !== order) gl.bufferData(gl.ARRAY_BUFFER, order, gl.DYNAMIC_DRAW);
      this.ordered = order;
      gl.enable(gl.BLEND);
      gl.blendFunc(gl.ONE_MINUS_DST_ALPHA, gl.ONE);
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, order.length);
      gl.disable(gl.BLEND);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.useProgram(resolve.program);
    this.bind(this.blended, 1);
    gl.uniform1i(resolve.at.blended, 1);
    gl.uniform3fv(resolve.at.background, background);
    gl.uniform1i(resolve.at.mode, mode);
    gl.uniform2fv(resolve.at.range, range);
    gl.bindVertexArray(this.nothing);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}
