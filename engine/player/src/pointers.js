// Fingers and mouse: one pointer turns (or, with Shift or another button, moves); two move and zoom; the wheel zooms.

/** Degrees of turning per pixel of a drag. */
const perPixel = (camera) => (camera.bounded ? 0.12 : 0.3);
/** Maximum pixels of a drag that still counts as a tap. */
const TAP = 4;

/**
 * Lets pointers on a canvas move the camera that `cameraOf` returns, if any. Calls `begun` when the canvas is touched, `changed` when the camera
 * moved, `released` after a drag, and `tapped` with the position on the page after a touch without a drag. Aborting `signal` removes the listeners.
 */
export function followPointers(canvas, cameraOf, { begun, changed, released, tapped }, signal) {
  const down = new Map();
  let travelled = 0;
  const place = (e) => [e.clientX, e.clientY];
  const spread = () => {
    const [a, b] = [...down.values()];
    return { middle: [0, 1].map((i) => (a[i] + b[i]) / 2), width: Math.hypot(a[0] - b[0], a[1] - b[1]) };
  };
  const on = (what, act, options) => canvas.addEventListener(what, act, { ...options, signal });
  on("pointerdown", (e) => {
    begun();
    canvas.setPointerCapture(e.pointerId);
    canvas.focus({ preventScroll: true });
    if (!down.size) travelled = 0;
    down.set(e.pointerId, place(e));
    canvas.classList.add("held");
  });
  on("pointermove", (e) => {
    const last = down.get(e.pointerId);
    const camera = cameraOf();
    if (!last || !camera) return;
    const earlier = down.size === 2 ? spread() : null;
    down.set(e.pointerId, place(e));
    let [right, below] = place(e).map((x, i) => x - last[i]);
    travelled += Math.hypot(right, below);
    if (earlier) {
      const { middle, width } = spread();
      [right, below] = middle.map((x, i) => x - earlier.middle[i]);
      camera.magnify(width / Math.max(1, earlier.width));
    }
    const scale = canvas.width / canvas.clientWidth;
    if (earlier || e.shiftKey || e.buttons > 1) camera.pan(right * scale, below * scale, camera.view(canvas.width, canvas.height));
    else if (travelled > TAP) camera.turn(right * perPixel(camera), -below * perPixel(camera));
    changed();
  });
  const up = (e) => {
    if (!down.delete(e.pointerId)) return;
    if (!down.size) {
      canvas.classList.remove("held");
      if (travelled > TAP) released();
    }
    if (e.type === "pointerup" && !down.size && travelled <= TAP && e.button === 0) tapped(place(e));
  };
  on("pointerup", up);
  on("pointercancel", up);
  on("contextmenu", (e) => e.preventDefault());
  const wheel = (e) => {
    const camera = cameraOf();
    if (!camera) return;
    e.preventDefault();
    camera.magnify(Math.exp(-e.deltaY * (e.deltaMode ? 0.05 : 0.0015)));
    changed();
  };
  on("wheel", wheel, { passive: false });
}
