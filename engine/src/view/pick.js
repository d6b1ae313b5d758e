// The Gaussian under a pixel, and its path.

const ALPHA_MIN = 1 / 255;
const LOW_PASS = 0.3;

/** The camera's axes in a Gaussian's own, times its standard deviations, widened as splat.vert says. */
function rowsOf(packet, i, view, z) {
  const unit = view.focal.map((f) => (view.pinhole ? f / z : f));
  const [mx, my] = unit.map((f, axis) => LOW_PASS * Math.max(0, view.own[axis] ** -2 - f ** -2));
  const [sx, sy, sz] = packet.deviation(i);
  const square = [view.units * sx, sy, view.units * sz];
  const deviation = [mx, my, 0.5 * (mx + my)].map((more, k) => Math.sqrt(square[k] * square[k] + more));
  return view.axes.map((axis) => axis.map((a, k) => a * deviation[k]));
}

/** The same of a still scene. */
function stillRows(packet, i, view) {
  const [own, deviation] = [packet.axes(i), packet.deviation(i)];
  return view.axes.map((axis) => own.map((mine, k) => dot(axis, mine) * deviation[k]));
}

/** α of record i on the pixel (x, y), as splat.vert and splat.frag have it; 0 where it does not reach. */
function alphaOn(packet, i, t, view, x, y) {
  const point = sceneAt(packet, i, t);
  if (!point) return 0;
  const [u, v, z] = project(view, point);
  if (z <= nearest(view)) return 0;
  const rows = packet.still ? stillRows(packet, i, view) : rowsOf(packet, i, view, z);
  const [right, down] = [[u - 0.5 * view.width, 0], [v - 0.5 * view.height, 1]].map(([offset, axis]) => {
    if (!view.pinhole) return rows[axis].map((m) => m * view.focal[axis]);
    const beside = packet.still ? 0.65 * [view.width, view.height][axis] : Infinity;
    return rows[axis].map((m, k) => (m * view.focal[axis] - clamp(offset, -beside, beside) * rows[2][k]) / z);
  });
  const [a, b, c] = [dot(right, right) + LOW_PASS, dot(right, down), dot(down, down) + LOW_PASS];
  const [dx, dy] = [x - u, y - v];
  const det = a * c - b * b;
  const q = (c * dx * dx - 2 * b * dx * dy + a * dy * dy) / det;
  if (q > 12) return 0; // under 1/255 of any opacity
  const kept = packet.antialiased ? Math.sqrt(Math.max(0, det - LOW_PASS * (a + c - LOW_PASS)) / det) : 1;
  const alpha = Math.min(0.99, opacityAt(packet, i, t) * kept * Math.exp(-0.5 * q));
  return alpha >= ALPHA_MIN ? alpha : 0;
}

/** False for a Gaussian of a still scene that does not reach a pixel. Millions are asked: nothing is allocated. */
function mayReach(packet, i, view, x, y) {
  const { axes: [right, down, ahead], eye, focal, pinhole } = view;
  const { floats, shorts } = packet;
  const [a, b] = [i * WORDS, i * SHORTS];
  const [dx, dy, dz] = [floats[a] - eye[0], floats[a + 1] - eye[1], floats[a + 2] - eye[2]];
  const z = ahead[0] * dx + ahead[1] * dy + ahead[2] * dz;
  if (z <= nearest(view)) return false;
  const unit = focal[0] * (pinhole ? 1 / z : 1);
  const u = unit * (right[0] * dx + right[1] * dy + right[2] * dz) + 0.5 * view.width - x;
  const v = unit * (down[0] * dx + down[1] * dy + down[2] * dz) + 0.5 * view.height - y;
  const widest = unit * Math.exp((48 * Math.max(shorts[b + 6], shorts[b + 7], shorts[b + 8])) / 65535 - 24);
  const slopes = pinhole ? (0.65 / focal[0]) ** 2 * (view.width ** 2 + view.height ** 2) : 0;
  return u * u + v * v <= 12 * (widest * widest * (1 + slopes) + LOW_PASS);
}

/** The record that shows most at a pixel (the largest αT) among those in `order`, nearest first; null where nothing is drawn. */
function pick(packet, order, t, view, x, y) {
  let left = 1;
  let best = null;
  for (const i of order) {
    if (packet.still && !mayReach(packet, i, view, x, y)) continue;
    const alpha = alphaOn(packet, i, t, view, x, y);
    if (left * (1 - alpha) < 1e-4) break;
    if (alpha && (!best || alpha * left > best.weight)) best = { record: i, weight: alpha * left };
    left *= 1 - alpha;
  }
  if (!best) return null;
  const identity = packet.identity(best.record);
  return { ...best, identity, birth: packet.birth?.(best.record), colour: colourAt(packet, best.record, t, view) };
}

/** The record of an identity in a packet: the one that belongs to the end of the interval nearer to t. */
function recordOf(packet, identity, t) {
  if (packet.still) return packet.numbers.indexOf(Number(identity));
  const low = Number(identity & 0xffffffffn);
  const high = Number(identity >> 32n);
  let found = -1;
  for (let i = 0; i < packet.count; i++) {
    if (packet.words[i * WORDS + 6] !== low || (packet.words[i * WORDS + 7] & 0xffffff) !== high) continue;
    if (found < 0 || packet.reference(i) === Math.round(t)) found = i;
  }
  return found;
}

/** Where an identity is at t in a packet, in scene space; null where it is not. */
function whereIs(packet, identity, t) {
  const i = recordOf(packet, identity, t);
  return i < 0 ? null : sceneAt(packet, i, t);
}

/** An identity's way through the packets at hand around interval `from`, oldest first: scene-space points; none where it stays. */
function pathOf(store, from, identity) {
  if (store.about.still) return [];
  const ends = (i) => {
    const packet = store.kept.get(i);
    const points = packet && [0, 1].map((t) => whereIs(packet, identity, t)).filter(Boolean);
    return points?.length ? points : null;
  };
  const here = ends(from);
  if (!here) return [];
  const path = [here];
  for (let i = from - 1, points; (points = ends(i)); i--) path.unshift(points);
  for (let i = from + 1, points; (points = ends(i)); i++) path.push(points);
  return path.flat();
}
