// The camera: a target, and the side from which it is seen.
//
// Scene space is x right, y down, z forward. Cameras use its square units: x and z times the aspect of the model's input, so that a unit is half the
// input's height. From straight ahead, orthographic, the view is the source's own: the content of the input fills the image. With perspective,
// objects at the target's distance keep their size.
//
// A still scene has no source view. It is seen in perspective from the position that still/framing.rs computes, in the file's own units.

const TURN = Math.PI / 180;
export const STEEPEST = 85;
/** Distance of an orthographic camera, in half widths: in front of everything, as depths end at 5. */
const BEHIND = 12;
/** Distance of a perspective camera, in half longer sides, which then fill 45 degrees. */
const AWAY = 2.4;
/**
 * For still scenes, as in still/framing.rs: half the vertical field of view, the elevation, the filled part of the image, and the ratio of depth to
 * width above which a scene is seen from its side.
 */
const FRAMING = { half: 22.5, elevation: 12, fill: 0.8, deeper: 1.25 };

/**
 * Degrees on each side through which a scene in time turns freely, and the limit of the additional degrees, which it approaches ever more slowly. The
 * scene was filmed from one side only.
 */
const FREE = 15;
const GIVE = 15;
/** Time constant, in seconds, of springing back to the free range. */
const SPRING = 0.15;

export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const clamp = (x, low, high) => Math.min(high, Math.max(low, x));

/** Returns a camera's right, down and forward. */
export function axesOf({ yaw, pitch }) {
  const [sy, cy] = [Math.sin(yaw * TURN), Math.cos(yaw * TURN)];
  const [sp, cp] = [Math.sin(pitch * TURN), Math.cos(pitch * TURN)];
  return [[cy, 0, -sy], [-sp * sy, cp, -sp * cy], [sy * cp, sp, cy * cp]];
}

export class Camera {
  constructor() {
    this.half = [16 / 9, 1]; // half extents of the content, in square units
    this.own = [1, 1];
    this.middle = [0, 0]; // its middle
    this.aspect = 16 / 9; // of the source's frames
    this.units = 16 / 9; // square units along x and z per unit of scene space
    this.depth = 0.5; // depth of the target, in scene space
    this.perspective = false;
    this.box = null; // of a still scene: its middle and half extents
    this.source = null; // of a still scene with a camera from straight ahead: the middle and half extents of its image
    this.unit = 1; // unit of shifts, in scene units
    /** Whether turning beyond FREE is resisted. */
    this.bounded = false;
    this.home = { yaw: 0, pitch: 0, lens: "parallel" };
    this.reset();
  }

  /** Returns to the source's view, or to the view of a whole still scene. */
  reset() {
    this.yaw = this.home.yaw;
    this.pitch = this.home.pitch;
    this.zoom = 1;
    this.shift = [0, 0, 0];
  }

  /** Sets the position of the content in the model's input. */
  place({ source, model, offset, content }) {
    this.aspect = source[1] / source[0];
    this.units = (this.aspect * content[0] * model[1]) / (content[1] * model[0]);
    this.half = [(this.units * content[1]) / model[1], content[0] / model[0]];
    this.own = [model[1] / 2 / this.units, model[0] / 2]; // the model's pixels per unit
    this.box = null;
    this.unit = 1;
    this.home = { yaw: 0, pitch: 0, lens: "parallel" };
    this.middle = [this.units * ((2 * offset[1] + content[1]) / model[1] - 1), (2 * offset[0] + content[0]) / model[0] - 1];
  }

  /** Sets the box that contains most of a still scene; `view`: middle and half extents of what its own camera sees, if it has one. */
  frame({ least, greatest, view = null }) {
    const middle = least.map((low, i) => 0.5 * (low + greatest[i]));
    const half = least.map((low, i) => 0.5 * (greatest[i] - low));
    this.box = { middle: view ? [...view[0], middle[2]] : middle, half };
    this.source = view;
    this.unit = Math.hypot(...half) || 1;
    const turned = { yaw: half[2] > FRAMING.deeper * half[0] ? -90 : 0, pitch: FRAMING.elevation, lens: "perspective" };
    this.home = view ? { yaw: 0, pitch: 0, lens: "parallel" } : turned;
    this.reset();
  }

  /** Returns the distance at which a still scene's box is completely visible from its widest side; focal lengths are fractions of the image. */
  distance(focal) {
    const axes = axesOf(this.home);
    let distance = 0;
    for (let corner = 0; corner < 8; corner++) {
      const d = this.box.half.map((h, i) => (corner & (1 << i) ? -h : h));
      const [x, y, z] = axes.map((axis) => dot(axis, d));
      distance = Math.max(distance, (2 * focal[0] * Math.abs(x)) / FRAMING.fill - z, (2 * focal[1] * Math.abs(y)) / FRAMING.fill - z);
    }
    return distance > 1e-6 ? distance : 1;
  }

  get target() {
    if (this.box) return this.box.middle.map((x, i) => x + this.unit * this.shift[i]);
    const [x, y] = this.middle;
    return [x + this.shift[0], y + this.shift[1], this.units * this.depth + this.shift[2]];
  }

  /** Returns the camera's right, down and forward. */
  get axes() {
    return axesOf(this);
  }

  /** Returns the view in an image of width × height pixels, with `focal` in the form of splat.vert. */
  view(width, height) {
    if (this.box) return this.stillView(width, height);
    const fitted = Math.min(width, height * this.aspect);
    const scale = [(0.5 * fitted) / this.half[0], (0.5 * fitted) / this.aspect / this.half[1]];
    const axes = this.axes;
    const away = AWAY * Math.max(this.units, 1);
    const distance = this.perspective ? away / this.zoom : BEHIND * this.units;
    const eye = this.target.map((x, i) => x - axes[2][i] * distance);
    const focal = scale.map((s) => s * (this.perspective ? away : this.zoom));
    return { width, height, axes, eye, focal, own: this.own, units: this.units, pinhole: this.perspective, distance };
  }

  /** Returns the view of a still scene; `ends` are the depths of the scale's ends. */
  stillView(width, height) {
    const length = 0.5 / Math.tan(FRAMING.half * TURN);
    const own = this.source && Math.min(width / this.source[1][0], height / this.source[1][1]) / 2;
    const whole = own ? (length * height) / own : this.distance([(length * height) / width, length]);
    // Orthographic rays start far before everything except stray Gaussians.
    const distance = this.perspective ? whole / this.zoom : whole + 100 * this.unit;
    const axes = this.axes;
    const eye = this.target.map((x, i) => x - axes[2][i] * distance);
    const pixels = length * height * (this.perspective ? 1 : this.zoom / whole);
    const depth = dot(axes[2], this.box.middle.map((x, i) => x - eye[i]));
    const ends = [Math.max(0, depth - this.unit), Math.max(depth, 0) + this.unit];
    return { width, height, axes, eye, focal: [pixels, pixels], units: 1, pinhole: this.perspective, distance, ends, still: true };
  }

  turn(right, down) {
    this.yaw = ((this.resisted(this.yaw, -right) + 540) % 360) - 180;
    this.pitch = clamp(this.resisted(this.pitch, -down), -STEEPEST, STEEPEST);
  }

  /** Returns an angle turned by some degrees. If it is bounded, x degrees beyond FREE become GIVE·(1 − e^(−x / GIVE)). */
  resisted(angle, by) {
    if (!this.bounded) return angle + by;
    const beyond = Math.abs(angle) - FREE;
    if (beyond >= GIVE) return by * angle < 0 ? angle + by : angle;
    const pulled = beyond > 0 ? Math.sign(angle) * (FREE - GIVE * Math.log(1 - beyond / GIVE)) : angle;
    const next = pulled + by;
    const over = Math.abs(next) - FREE;
    return over > 0 ? Math.sign(next) * (FREE + GIVE * (1 - Math.exp(-over / GIVE))) : next;
  }

  /** Springs back towards the free range for some seconds; returns whether the camera moved. */
  settle(seconds) {
    if (!this.bounded) return false;
    const sprung = (angle) => {
      const edge = clamp(angle, -FREE, FREE);
      const next = edge + (angle - edge) * Math.exp(-seconds / SPRING);
      return Math.abs(next - edge) < 0.01 ? edge : next;
    };
    const [yaw, pitch] = [sprung(this.yaw), sprung(this.pitch)];
    const moved = yaw !== this.yaw || pitch !== this.pitch;
    [this.yaw, this.pitch] = [yaw, pitch];
    return moved;
  }

  /** Moves the target so that the image moves by this many of its pixels. */
  pan(right, down, { axes, focal, distance, pinhole }) {
    const unit = focal.map((f) => (pinhole ? distance : 1) / f);
    this.shift = this.shift.map((x, i) => x - (right * unit[0] * axes[0][i] + down * unit[1] * axes[1][i]) / this.unit);
  }

  magnify(factor) {
    this.zoom = clamp(this.zoom * factor, 0.1, 50);
  }
}

/** The depth from which a view shows objects. */
export const nearest = ({ pinhole, still }) => (!pinhole ? 0 : still ? 1e-6 : 1e-3);

/** Returns the image position of a scene-space point in a view: pixels from the upper left corner, and depth. */
export function project({ width, height, axes, eye, focal, units, pinhole }, [right, down, forward]) {
  const away = [units * right - eye[0], down - eye[1], units * forward - eye[2]];
  const [x, y, z] = axes.map((axis) => dot(axis, away));
  const near = pinhole ? 1 / z : 1;
  return [focal[0] * x * near + 0.5 * width, focal[1] * y * near + 0.5 * height, z];
}

/** Returns the view in the form that `streamsplat render --camera` reads. */
export function cameraFile({ width, height, axes, eye, focal, pinhole }) {
  const numbers = (list) => list.map((x) => Number(x.toPrecision(12)) + 0);
  const pose = { units: "square", position: numbers(eye), look_at: numbers(eye.map((x, i) => x + axes[2][i])) };
  return pinhole
    ? { type: "pinhole", ...pose, focal: numbers([focal[0] / width, focal[1] / height]) }
    : { type: "orthographic", ...pose, half_extent: numbers([(0.5 * width) / focal[0], (0.5 * height) / focal[1]]) };
}
