// node unusual.mjs STREAMSPLAT FOLDER: unusual scenes through every format that splat-transform shares with this program, in both directions. One of the two
// writes the file, the other reads it. The picture of the result is compared with the picture of the scene itself, both drawn by this program.
import assert from 'node:assert/strict';
import { spawnSync } from 'node:child_process';
import { rmSync, writeFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { dirname } from 'node:path';

const [streamsplat, folder] = process.argv.slice(2);
const file = (name) => `${folder}/${name}`;
const transform = `${dirname(dirname(createRequire(import.meta.url).resolve('@playcanvas/splat-transform')))}/bin/cli.mjs`;

/** Runs a program; returns whether it succeeds, and its standard error. */
function ran(program, ...words) {
  const { status, stderr } = spawnSync(program, words, { encoding: 'utf8' });
  return { done: status === 0, said: stderr.trim() };
}
const ours = (...words) => ran(streamsplat, ...words);
const theirs = (...words) => ran(process.execPath, transform, '--quiet', '--overwrite', '--gpu', 'cpu', ...words);

/** Values as properties that are numbered. */
const numbered = (name, values) => Object.fromEntries(values.map((value, i) => [`${name}${i}`, value]));
/** Gaussians, each its properties by name. */
function scene(count, degree) {
  let state = 7;
  const random = () => ((state = (Math.imul(state, 1664525) + 1013904223) >>> 0) / 2 ** 32) * 2 - 1;
  const some = (length, value) => Array.from({ length }, value);
  return some(count, () => {
    const [x, y, z] = some(3, random);
    const colour = some(3, () => 1.2 * random());
    const rest = some(3 * ((degree + 1) ** 2 - 1), () => 0.15 * random());
    const scale = some(3, () => -2.6 + 0.7 * random());
    return { x, y, z, ...numbered('f_dc_', colour), ...numbered('f_rest_', rest), opacity: 2 * random(), ...numbered('scale_', scale), ...numbered('rot_', some(4, random)) };
  });
}
const NAMES = Object.keys(scene(1, 1)[0]);

/** A PLY file of such rows. */
function ply(rows, { comment = '', doubles = false, names = Object.keys(rows[0] ?? {}) }) {
  const wide = (name) => doubles && /^[xyz]$/.test(name);
  const properties = names.map((name) => `property ${wide(name) ? 'double' : 'float'} ${name}\n`).join('');
  const body = Buffer.concat(rows.flatMap((row) => names.map((name) => {
    const bytes = Buffer.alloc(wide(name) ? 8 : 4);
    if (wide(name)) bytes.writeDoubleLE(row[name]);
    else bytes.writeFloatLE(row[name]);
    return bytes;
  })));
  return Buffer.concat([Buffer.from(`ply\nformat binary_little_endian 1.0\n${comment}element vertex ${rows.length}\n${properties}end_header\n`), body]);
}

const OFFSET = [431250, 5411800, 312];
const changed = (change, degree = 1) => scene(400, degree).map((row, i) => ({ ...row, ...change(row, i) }));
const CASES = {
  'opacity +inf': { rows: changed((_, i) => (i % 2 ? { opacity: Infinity } : {})) },
  'opacity -inf': { rows: changed((_, i) => (i % 2 ? { opacity: -Infinity } : {})) },
  'scale -inf': { rows: changed(() => ({ scale_2: -Infinity })) },
  floater: { rows: changed((_, i) => (i === 7 ? { x: 5.3e8 } : {})) },
  offset: { rows: changed(({ x, y, z }) => ({ x: x + OFFSET[0], y: y + OFFSET[1], z: z + OFFSET[2] })), doubles: true, offset: OFFSET },
  'anti-aliased': { rows: changed(({ scale_0, scale_1, scale_2 }) => ({ scale_0: scale_0 - 2, scale_1: scale_1 - 2, scale_2: scale_2 - 2 })), comment: 'comment SplatRenderMode: mip\n' },
  one: { rows: scene(1, 1) },
  none: { rows: [], names: NAMES },
  ...Object.fromEntries([0, 1, 2, 3, 4].map((degree) => [`degree ${degree}`, { rows: scene(400, degree) }])),
};
/** Ending and options of each format, and the least PSNR in decibels of a picture, of files by us and by them; null: not read or not written there. */
const FORMATS = {
  PLY: { ending: 'ply', to: 99, from: 99 },
  'compressed PLY': { ending: 'compressed.ply', to: 48, from: 48 },
  'SPZ 3': { ending: 'spz', options: ['--spz-version', '3'], axes: ['--axes', 'rdf'], to: 38, from: 38 },
  'SPZ 4': { ending: 'spz', options: ['--spz-version', '4'], axes: ['--axes', 'rdf'], to: 38, from: 38 },
  SOG: { ending: 'sog', to: 57, from: 35 },
  glTF: { ending: 'glb', to: null, from: 99 },
  // Without harmonics.
  splat: { ending: 'splat', to: 29, from: 29 },
};
/**
 * Exceptions of a case in a format: other decibels, the text of a line of ours, and the origin of the picture of their result. In files without a field for an
 * offset the scene is at 0 for all programs except this one.
 */
const away = { from: null, origin: [0, 0, 0], says: /coordinates are relative to \(431250, 5411800, 312\)/ };
const EXCEPTIONS = {
  floater: {
    'compressed PLY': { to: null, from: null, says: /256 of 400 Gaussians placed more coarsely/ },
    'SPZ 3': { says: /1 of 400 Gaussians moved/ },
    'SPZ 4': { says: /1 of 400 Gaussians moved/ },
  },
  // splat-transform reads positions as binary32.
  offset: { PLY: { to: null, from: null }, 'compressed PLY': away, 'SPZ 3': away, 'SPZ 4': away, SOG: away, glTF: { from: null }, splat: away },
  'anti-aliased': { glTF: { from: 40, says: /no mark for scenes trained with anti-aliasing/ }, splat: { says: /no mark for scenes trained with anti-aliasing/ } },
  // splat-transform writes no file of no Gaussians, and reads no PLY file of degree 4.
  none: Object.fromEntries(Object.keys(FORMATS).map((format) => [format, { to: null, from: null }])),
  'degree 4': Object.fromEntries(Object.keys(FORMATS).map((format) => [format, { from: null, says: /harmonics of degree 4 read to degree 3/, ...(format === 'glTF' && { to: null }) }])),
};

/** Draws a file from a position in the scene's own coordinates. */
function drawn(path, picture, origin = [0, 0, 0], more = []) {
  const at = (place) => place.map((x, axis) => x + origin[axis]);
  writeFileSync(file('camera.json'), JSON.stringify({ type: 'pinhole', position: at([0.3, -0.4, -3.5]), look_at: at([0, 0, 0.2]), fov_y_degrees: 45, aspect: 4 / 3 }));
  const { done, said } = ours('render', path, '--camera', file('camera.json'), '--size', '240x180', '--background', '0.5', '-o', file(picture), ...more);
  assert(done, `${path}: ${said}`);
}
const decibels = (a, b) => JSON.parse(spawnSync(streamsplat, ['compare', file(a), file(b), '--json'], { encoding: 'utf8' }).stdout).pictures[0].psnr;

const failures = [];
for (const [name, { rows, offset: origin, ...more }] of Object.entries(CASES)) {
  writeFileSync(file('scene.ply'), ply(rows, more));
  drawn(file('scene.ply'), 'right.png', origin);
  for (const [format, { ending, options = [], axes = [], ...bars }] of Object.entries(FORMATS)) {
    const { to, from, says, origin: seen = origin } = { ...bars, ...EXCEPTIONS[name]?.[format] };
    const [our, their, back] = [`our.${ending}`, `their.${ending}`, 'back.ply'].map(file);
    for (const path of [our, their, back]) rmSync(path, { force: true });
    const check = (holds, what) => holds || failures.push(`${name}, ${format}: ${what}`);
    const near = (picture, bar, direction) => {
      const found = decibels(picture, 'right.png');
      check(found >= bar, `${direction}: expected ${bar} dB, found ${found.toFixed(1)}`);
      return `${found.toFixed(1)} dB`;
    };
    const exported = ours('export', file('scene.ply'), ...options, '--out', our);
    check(exported.done, `our export: ${exported.said}`);
    check(!says || says.test(exported.said), `expected a line like ${says}, found ${JSON.stringify(exported.said)}`);
    const line = [name, format];
    if (to !== null) {
      const { done, said } = theirs(our, back);
      check(done, `their reading of ours: ${said}`);
      if (done) {
        drawn(back, 'back.png', seen);
        line.push(`ours by them ${near('back.png', to, 'ours by them')}`);
      }
    }
    const written = theirs(...options, file('scene.ply'), their);
    if (from !== null) {
      check(written.done, `their writing: ${written.said}`);
      if (written.done) {
        drawn(their, 'their.png', origin, axes);
        line.push(`theirs by us ${near('their.png', from, 'theirs by us')}`);
      }
    }
    console.log(line.join(', '));
  }
}
assert.equal(failures.length, 0, `\n${failures.join('\n')}`);
