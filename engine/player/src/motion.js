// Gaussians at a time, computed as in splat.vert, for sorting and picking.

import { SHORTS } from "./packet.js";

const HANDOVER = 0.125;

/** Converts a normalised inverse depth to scene-space depth. */
export const depthOf = (y) => 1 / (9.8 * y + 0.200001);

/**
 * Returns normalised inverse depths of a packet (of at most 4096 records): `middle`, and the ends of a scale, `far` and `near`, which contain 98 % of
 * them. The scale is at least a tenth wide.
 */
export function inverseDepths(packet) {
  const all = [];
  for (let i = 0; i < packet.count; i += Math.ceil(packet.count / 4096)) {
    const y = worldAt(packet, i, packet.reference(i))[1];
    if (y >= 0 && y <= 1) all.push(y);
  }
  all.sort((a, b) => a - b);
  const [low, middle, high] = [0.01, 0.5, 0.99].map((part) => all[Math.floor(part * all.length)] ?? 0.5);
  const wider = Math.max(0, 0.05 - 0.5 * (high - low));
  return { far: low - wider, middle, near: high + wider };
}

/** Returns the same from a cache. */
export const depthsOf = (packet) => (packet.depths ??= inverseDepths(packet));

/** Returns the world position of record i at t in [0, 1] of its interval. */
export function worldAt(packet, i, t) {
  const tau = t - packet.reference(i);
  const q = packet.shorts.subarray(i * SHORTS, i * SHORTS + 6);
  return [0, 1, 2].map((axis) => {
    const velocity = packet.velocityLow[axis] + packet.velocityStep[axis] * q[3 + axis];
    return packet.positionLow[axis] + packet.positionStep[axis] * q[axis] + velocity * tau;
  });
}

/** Returns the position in scene space; null if the record is not drawn. */
export function sceneAt(packet, i, t) {
  if (packet.still) return packet.place(i);
  const [x, y, z] = worldAt(packet, i, t);
  return y >= 0 && y <= 1 ? [x, -z, depthOf(y)] : null;
}

/** Computes o · (1 + e^(−γ₀γ₁)) / (1 + e^(γ₀(|τ| − γ₁))) · handover, at t in [0, 1]. */
export function opacityAt(packet, i, t) {
  if (packet.still) return packet.opacity(i);
  const [steepness, width] = packet.gamma(i);
  const x = steepness * (Math.abs(t - packet.reference(i)) - width);
  const factor = Math.min(1, (1 + Math.exp(-steepness * width)) / (1 + Math.exp(x)));
  const handover = packet.handover(i);
  const ramp = handover === 1 ? t : handover === 2 ? 1 - t : HANDOVER;
  return packet.opacity(i) * factor * Math.min(1, ramp / HANDOVER);
}

/** Returns red, green and blue, integers in [0, 255], of record i at t in [0, 1] of its interval as a view shows it. */
export function colourAt(packet, i, t, view) {
  if (packet.still) {
    const away = packet.place(i).map((x, axis) => x - view.eye[axis]);
    return packet.colour(i, view.pinhole ? away.map((x) => x / Math.hypot(...away)) : view.axes[2]);
  }
  const change = 255 * packet.rateStep * (t - packet.reference(i));
  const rate = (channel) => packet.rates[3 * i + channel] ?? 0;
  const at = (value, channel) => value + change * rate(channel) * Math.abs(rate(channel));
  return Array.from(packet.colour(i), (value, channel) => Math.min(255, Math.max(0, Math.round(at(value, channel)))));
}
