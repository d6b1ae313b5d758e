// A gentle sway until the first touch of the page shows that the scene has depth.

/** Degrees to either side, degrees up and down, and seconds there and back. */
const SWAY = { across: 4, along: 1.5, seconds: 7 };

class Sway {
  constructor(camera) {
    this.camera = camera;
    this.on = false;
    this.seconds = 0;
  }

  start() {
    this.on = true;
    this.seconds = 0;
  }

  /** The camera stays where it is. */
  stop() {
    this.on = false;
  }

  /** Takes it further; returns whether the camera was moved. */
  advance(seconds) {
    if (!this.on) return false;
    this.seconds += seconds;
    const angle = (2 * Math.PI * this.seconds) / SWAY.seconds;
    const { yaw, pitch } = this.camera.home;
    this.camera.yaw = yaw + SWAY.across * Math.sin(angle);
    this.camera.pitch = pitch + SWAY.along * 0.5 * (1 - Math.cos(angle));
    return true;
  }
}
