// Front to back: a counting sort by depth.

const BINS = 1 << 16;

/** Sorts a packet's records; keeps its arrays from one sort to the next. */
class Sorter {
  constructor() {
    this.packet = null;
    this.counts = new Uint32Array(BINS + 1);
  }

  /** Positions and velocities as numbers, once per packet. */
  take(packet) {
    if (this.packet === packet) return;
    this.packet = packet;
    const { count, shorts, positionLow, positionStep, velocityLow, velocityStep } = packet;
    this.position = new Float32Array(count * 3);
    this.velocity = new Float32Array(count * 3);
    this.reference = new Uint8Array(count);
    for (let i = 0; i < count; i++) {
      this.reference[i] = packet.reference(i);
      for (let axis = 0; axis < 3; axis++) {
        this.position[3 * i + axis] = positionLow[axis] + positionStep[axis] * shorts[i * SHORTS + axis];
        this.velocity[3 * i + axis] = velocityLow[axis] + velocityStep[axis] * shorts[i * SHORTS + 3 + axis];
      }
    }
    this.inverseDepths = inverseDepths(packet);
    this.depth = new Float32Array(count);
    this.order = new Uint32Array(count);
  }

  /**
   * The records that may be seen at t, nearest first, equal depths (to a 65,535th of their range) in drawing order.
   */
  sort(packet, t, { axes, eye, pinhole }) {
    this.take(packet);
    const { position, velocity, reference, depth, counts, order } = this;
    const [fx, fy, fz] = axes[2];
    const offset = dot(axes[2], eye);
    const nearest = pinhole ? 1e-3 : 0;
    let [low, high] = [Infinity, -Infinity];
    for (let i = 0; i < packet.count; i++) {
      const tau = t - reference[i];
      const y = position[3 * i + 1] + velocity[3 * i + 1] * tau;
      const x = position[3 * i] + velocity[3 * i] * tau;
      const z = position[3 * i + 2] + velocity[3 * i + 2] * tau;
      const d = fx * x - fy * z + fz * depthOf(y) - offset;
      const seen = y >= 0 && y <= 1 && d > nearest;
      depth[i] = seen ? d : Infinity;
      if (seen) {
        if (d < low) low = d;
        if (d > high) high = d;
      }
    }
    if (low > high) return order.subarray(0, 0);
    const scale = high > low ? (BINS - 1) / (high - low) : 0;
    counts.fill(0);
    for (let i = 0; i < packet.count; i++) {
      if (depth[i] !== Infinity) counts[(((depth[i] - low) * scale) | 0) + 1]++;
    }
    for (let bin = 0; bin < BINS; bin++) counts[bin + 1] += counts[bin];
    const total = counts[BINS];
    for (let i = 0; i < packet.count; i++) {
      if (depth[i] !== Infinity) order[counts[((depth[i] - low) * scale) | 0]++] = i;
    }
    return order.subarray(0, total);
  }
}
