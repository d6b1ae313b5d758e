// A headset, through WebXR: the scene keeps its position in the viewer's room, and is drawn for each eye.

/** Metres from the viewer to the camera's target, on entering. */
const REACH = 2;

/** Returns whether this browser has a headset. Only pages from HTTPS or from localhost may ask. */
export const offersHeadset = async () => {
  try {
    return Boolean(await navigator.xr?.isSessionSupported("immersive-vr"));
  } catch {
    return false;
  }
};

/**
 * The pose of the viewer's room in a scene: its origin is the camera's eye, its axes are the camera's, and REACH metres are the distance to the
 * target.
 */
export function roomOf(camera) {
  const own = camera.perspective;
  camera.perspective = true;
  const { eye, axes, distance, units, own: ownPixels, ends, still } = camera.view(1, 1);
  camera.perspective = own;
  return { eye, axes, metre: distance / REACH, view: { units, own: ownPixels, ends, still, distance, pinhole: true } };
}

/**
 * Returns the view of width × height pixels from a pose in the room. `matrix`: 4×4 by columns, from the pose to the room, in metres, x right, y up, z
 * back. `projection`: 4×4 by columns; focal lengths and centre are read from it, because an eye does not look through the middle of its picture.
 */
export function viewFrom({ eye, axes, metre, view }, { matrix, projection }, width, height) {
  const turned = (column, by) => {
    const [right, down, forward] = [by * matrix[column], -by * matrix[column + 1], -by * matrix[column + 2]];
    return [0, 1, 2].map((i) => right * axes[0][i] + down * axes[1][i] + forward * axes[2][i]);
  };
  const from = turned(12, metre);
  return {
    ...view,
    width,
    height,
    eye: eye.map((x, i) => x + from[i]),
    axes: [turned(0, 1), turned(4, -1), turned(8, -1)],
    focal: [0.5 * width * projection[0], 0.5 * height * projection[5]],
    middle: [-0.5 * width * projection[8], 0.5 * height * projection[9]],
  };
}

/**
 * Draws a scene in a headset until the session ends. `advance(seconds)` advances the time. `found(view)` returns packet, order, t and looks, or null
 * while they are not loaded. `selected` is called on a trigger or a pinch, `left` at the end.
 */
export class Headset {
  static async enter(drawing, camera, calls) {
    const session = await navigator.xr.requestSession("immersive-vr");
    try {
      await drawing.gl.makeXRCompatible();
      const layer = new XRWebGLLayer(session, drawing.gl, { alpha: false, antialias: false, depth: false });
      await session.updateRenderState({ baseLayer: layer });
      return new Headset(session, layer, await session.requestReferenceSpace("local"), drawing, camera, calls);
    } catch (error) {
      await session.end();
      throw error;
    }
  }

  constructor(session, layer, space, drawing, camera, calls) {
    Object.assign(this, { session, layer, space, drawing, calls });
    this.room = roomOf(camera);
    this.before = null;
    this.picture = null;
    session.addEventListener("select", () => calls.selected());
    session.addEventListener("end", () => calls.left());
    session.requestAnimationFrame((now, frame) => this.turn(now, frame));
  }

  /** Handles one frame of the headset. */
  turn(now, frame) {
    const { session, layer, drawing, calls } = this;
    session.requestAnimationFrame((now, frame) => this.turn(now, frame));
    calls.advance(Math.min(0.1, Math.max(0, (now - (this.before ?? now)) / 1000)));
    this.before = now;
    const pose = frame.getViewerPose(this.space);
    if (!pose) return;
    // Both eyes use one order: that of the point between them.
    const [{ projectionMatrix }] = pose.views;
    const head = viewFrom(this.room, { matrix: pose.transform.matrix, projection: projectionMatrix }, 1, 1);
    this.picture = calls.found(head) ?? this.picture;
    if (!this.picture) return;
    const { packet, order, t, looks } = this.picture;
    for (const eye of pose.views) {
      const { x, y, width, height } = layer.getViewport(eye);
      const view = viewFrom(this.room, { matrix: eye.transform.matrix, projection: eye.projectionMatrix }, width, height);
      drawing.draw(packet, order, t, view, looks, { framebuffer: layer.framebuffer, x, y });
    }
  }

  /** Ends the session. */
  leave() {
    return this.session.end();
  }
}
