// A scene in time among the objects of another engine: the uniforms of splat.vert for its cameras, and its program.

import { SHADERS } from "./shaders.js";

/** Converts a direction between an engine's space, in which y is up and z towards the viewer, and scene space; the conversion is its own inverse. */
const flipped = ([x, y, z]) => [x, -y, -z];

/**
 * Returns the view of a clip for an engine's camera, in an image of width × height pixels. `modelView` maps the clip's own space to the camera's,
 * `projection` that to clip coordinates, both by columns. The clip's own space has the camera's target in its middle, x right, y up, z towards the
 * viewer, and units of half the model input's height. `scale` is the number of the camera's units per own unit.
 */
export function viewOf(camera, modelView, projection, width, height) {
  const m = modelView;
  const scale = Math.hypot(m[0], m[1], m[2]);
  const row = (i) => [m[i] / scale, m[i + 4] / scale, m[i + 8] / scale];
  const rows = [row(0), row(1), row(2)];
  const eye = [0, 1, 2].map((axis) => -rows.reduce((sum, row, i) => sum + row[axis] * m[12 + i], 0) / scale);
  const [right, up, back] = rows.map(flipped);
  const axes = [right, up.map((x) => -x), back.map((x) => -x)];
  const pinhole = projection[15] === 0;
  const pixels = [(projection[0] * width) / 2, (projection[5] * height) / 2];
  const target = camera.target;
  return {
    width,
    height,
    axes,
    eye: flipped(eye).map((x, i) => x + target[i]),
    focal: pixels.map((f) => (pinhole ? f : f * scale)),
    own: camera.own,
    units: camera.units,
    pinhole,
    scale,
  };
}

/** The vertex program: as on the page, at its depth among other objects. */
export const VERTEX = `${SHADERS["splat.vert"].replace("#version 300 es\n", "").replace("void main()", "void drawn()")}
uniform mat4 projection;
uniform float scale;  // the camera's units to one of the clip's own

void main() {
  ahead = 0.0;
  drawn();
  if (splat.a <= 0.0) return;
  vec4 middle = projection * vec4(0.0, 0.0, -scale * ahead, 1.0);
  gl_Position.xy += middle.xy / middle.w;
  gl_Position.z = middle.z / middle.w;
}
`;

/** The fragment program. */
export const FRAGMENT = SHADERS["splat.frag"].replace("#version 300 es\n", "");

/** Writes an order from farthest to nearest at the beginning of an array. */
export function backToFront(order, into) {
  for (let i = 0, j = order.length - 1; j >= 0; i++, j--) into[i] = order[j];
}

/** Pads triples to four values: engines have no integer textures of three. */
export function inFours(triples, into) {
  for (let i = 0, j = 0; i < triples.length; i += 3, j += 4) {
    into[j] = triples[i];
    into[j + 1] = triples[i + 1];
    into[j + 2] = triples[i + 2];
  }
}

/** Returns a class derived from `Base`, with a `clip` and a `clock` that another program's loop drives. */
export const playback = (Base) =>
  class extends Base {
    /** Width and height of the source's frames in the object's own units. */
    get size() {
      return this.clip.camera.half.map((half) => 2 * half);
    }

    get duration() {
      return this.clip.end - this.clip.start;
    }

    get currentTime() {
      return this.clock.current;
    }

    set currentTime(seconds) {
      this.clock.current = seconds;
    }

    get playing() {
      return this.clock.playing;
    }

    play() {
      this.clock.playing = true;
    }

    pause() {
      this.clock.playing = false;
    }

    /** Advances the time by some seconds while it plays. It waits for intervals that are not loaded yet. */
    update(seconds) {
      if (this.clip.has(this.clock.time)) this.clock.advance(seconds);
    }
  };
