// node check.mjs STREAMSPLAT FOLDER: generated scenes are converted to each format and back, by this program and by others:
// SPZ's reference implementation, and splat-transform for PLY, compressed PLY, SPZ, SOG, glTF and .splat.
import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { mkdirSync, readFileSync, writeFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { dirname } from 'node:path';
import create from '@adobe/spz';

const [streamsplat, folder] = process.argv.slice(2);
const spz = await create();
const file = (name) => `${folder}/${name}`;
const run = (...words) => execFileSync(streamsplat, [...words, '--quiet'], { stdio: ['ignore', 'ignore', 'inherit'] });

const transform = `${dirname(dirname(createRequire(import.meta.url).resolve('@playcanvas/splat-transform')))}/bin/cli.mjs`;
const convert = (...words) => execFileSync(process.execPath, [transform, '--quiet', '--overwrite', '--gpu', 'cpu', ...words], { stdio: ['ignore', 'ignore', 'inherit'] });

const COUNT = 3000;
const names = (degree) => [
  ...'x y z nx ny nz f_dc_0 f_dc_1 f_dc_2'.split(' '),
  ...Array.from({ length: 3 * ((degree + 1) ** 2 - 1) }, (_, i) => `f_rest_${i}`),
  ...'opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3'.split(' '),
];

/** A scene in the columns of PLY, from a generator of its own. */
function scene(degree) {
  let state = 12345 + degree;
  const next = () => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return state / 2 ** 32;
  };
  const range = { x: 8, y: 8, z: 8, opacity: 10, f_dc_0: 3, f_dc_1: 3, f_dc_2: 3 };
  return Object.fromEntries(names(degree).map((name) => {
    const value = name.startsWith('n') ? () => 0
      : name.startsWith('scale') ? () => -9 + 10 * next()
      : name.startsWith('f_rest') ? () => 1.8 * (next() - 0.5)
      : () => (range[name] ?? 2) * (next() - 0.5);
    return [name, Float32Array.from({ length: COUNT }, value)];
  }));
}

function writePly(path, columns, comment = '') {
  const keys = Object.keys(columns);
  const header = `ply\nformat binary_little_endian 1.0\n${comment}element vertex ${COUNT}\n`
    + keys.map((key) => `property float ${key}\n`).join('') + 'end_header\n';
  const body = new Float32Array(COUNT * keys.length);
  keys.forEach((key, k) => columns[key].forEach((value, i) => { body[i * keys.length + k] = value; }));
  writeFileSync(path, Buffer.concat([Buffer.from(header), Buffer.from(body.buffer)]));
}

function readPly(path) {
  const bytes = readFileSync(path);
  const end = bytes.indexOf('end_header\n') + 11;
  const keys = [...bytes.subarray(0, end).toString().matchAll(/property float (\w+)/g)].map((match) => match[1]);
  const values = new Float32Array(Uint8Array.from(bytes.subarray(end)).buffer);
  assert.equal(values.length, COUNT * keys.length);
  return Object.fromEntries(keys.map((key, k) => [key, values.filter((_, i) => i % keys.length === k)]));
}

/** The reference's arrays as columns of PLY. */
function columns(cloud) {
  assert.equal(cloud.numPoints, COUNT);
  const rest = (cloud.shDegree + 1) ** 2 - 1;
  const pick = (array, width, at) => Float32Array.from({ length: COUNT }, (_, i) => array[i * width + at]);
  const place = {
    x: ['positions', 3, 0], y: ['positions', 3, 1], z: ['positions', 3, 2], opacity: ['alphas', 1, 0],
    rot_0: ['rotations', 4, 3], rot_1: ['rotations', 4, 0], rot_2: ['rotations', 4, 1], rot_3: ['rotations', 4, 2],
  };
  for (let i = 0; i < 3; i++) {
    place[`f_dc_${i}`] = ['colors', 3, i];
    place[`scale_${i}`] = ['scales', 3, i];
    for (let k = 0; k < rest; k++) place[`f_rest_${i * rest + k}`] = ['sh', 3 * rest, 3 * k + i];
  }
  return Object.fromEntries(names(cloud.shDegree).map((name) => {
    const [key, width, at] = place[name] ?? [];
    return [name, key ? pick(cloud[key], width, at) : new Float32Array(COUNT)];
  }));
}

/** Columns of PLY as the reference's arrays. */
function cloud(columns, degree) {
  const rest = (degree + 1) ** 2 - 1;
  const join = (keys) => Float32Array.from({ length: COUNT * keys.length }, (_, i) => columns[keys[i % keys.length]][Math.floor(i / keys.length)]);
  const sh = Array.from({ length: 3 * rest }, (_, i) => `f_rest_${(i % 3) * rest + Math.floor(i / 3)}`);
  return {
    numPoints: COUNT, shDegree: degree, antialiased: false, extensions: [],
    positions: join(['x', 'y', 'z']), scales: join(['scale_0', 'scale_1', 'scale_2']),
    rotations: join(['rot_1', 'rot_2', 'rot_3', 'rot_0']), alphas: join(['opacity']),
    colors: join(['f_dc_0', 'f_dc_1', 'f_dc_2']), sh: join(sh),
  };
}

/** Opacities, and rotations of length 1, which can be compared. */
function comparable(columns) {
  const out = { ...columns, opacity: columns.opacity.map((x) => 1 / (1 + Math.exp(-x))) };
  const keys = ['rot_0', 'rot_1', 'rot_2', 'rot_3'];
  keys.forEach((key) => { out[key] = new Float32Array(COUNT); });
  for (let i = 0; i < COUNT; i++) {
    const q = keys.map((key) => columns[key][i]);
    const length = Math.hypot(...q);
    keys.forEach((key, k) => { out[key][i] = q[k] / length; });
  }
  return out;
}

function compare(what, found, expected, steps) {
  const [a, b] = [comparable(found), comparable(expected)];
  const turns = ['rot_0', 'rot_1', 'rot_2', 'rot_3'];
  for (let i = 0; i < COUNT; i++) {
    // Opposite quaternions are the same rotation.
    const cosine = turns.reduce((sum, key) => sum + a[key][i] * b[key][i], 0);
    if (cosine < 0) turns.forEach((key) => { a[key][i] = -a[key][i]; });
  }
  for (const name of Object.keys(b)) {
    const step = steps(name);
    let worst = 0;
    for (let i = 0; i < COUNT; i++) worst = Math.max(worst, Math.abs(a[name][i] - b[name][i]));
    assert(worst <= step, `${what}: ${name}: expected at most ${step}, found ${worst}`);
  }
}

/** Half a step of the format, and a little. */
const format = (version) => (name) => 1.01 * (
  /^[xyz]$/.test(name) ? 0.5 / 4096
  : name.startsWith('f_dc') ? 0.5 / 255 / 0.15
  // Rounded twice, to a byte and to a bucket of 16.
  : name.startsWith('f_rest') ? 1 / 16 + 0.5 / 128
  : name.startsWith('scale') ? 0.5 / 16
  // The largest component follows from the others: its error is theirs, and more where they are large. Opacities of 0 and 1 are moved in by a step.
  : name.startsWith('rot') ? (version === 2 ? 0.12 : 0.005) : 1 / 255);
// In version 2 the reference computes w from the others in binary32, which is inaccurate near 0.
const same = (version) => (name) => (version === 2 && name.startsWith('rot') ? 5e-4 : 2e-6);
const rdf = { to: spz.CoordinateSystem.RDF };

for (const degree of [0, 1, 2, 3]) {
  const original = scene(degree);
  writePly(file('scene.ply'), original);
  run('export', file('scene.ply'), '--format', 'ply', '--out', file('again.ply'));
  assert(readFileSync(file('again.ply')).equals(readFileSync(file('scene.ply'))), 'PLY to PLY');

  // The reference reads our files.
  run('export', file('scene.ply'), '--format', 'spz', '--spz-version', '4', '--out', file('ours.spz'));
  const read = columns(spz.loadSpzFromBuffer(readFileSync(file('ours.spz')), rdf));
  compare(`ours at degree ${degree}`, read, original, format(4));
  // Version 3 holds PLY's numbers unchanged, for viewers. The reference ignores the comment and reads them along its own axes.
  run('export', file('scene.ply'), '--format', 'spz', '--out', file('viewers.spz'));
  const raw = columns(spz.loadSpzFromBuffer(readFileSync(file('viewers.spz')), { to: spz.CoordinateSystem.RUB }));
  compare(`version 3 of ours at degree ${degree}`, raw, original, format(3));
  run('export', file('viewers.spz'), '--format', 'ply', '--out', file('again.ply'));
  compare(`version 3 of ours at degree ${degree}, by us`, readPly(file('again.ply')), original, format(3));
  // We read them as the reference does.
  run('export', file('ours.spz'), '--format', 'ply', '--out', file('ours.ply'));
  compare(`ours at degree ${degree}, by both`, readPly(file('ours.ply')), read, same(4));

  // We read the reference's files as it does.
  const theirs = [];
  for (const version of [4, 3, 2]) {
    const options = { version, from: spz.CoordinateSystem.RDF, sh1Bits: 5, shRestBits: 4 };
    const bytes = spz.saveSpzToBuffer(cloud(original, degree), options);
    theirs.push(bytes.length);
    writeFileSync(file('theirs.spz'), bytes);
    run('export', file('theirs.spz'), '--format', 'ply', '--out', file('theirs.ply'));
    const expected = columns(spz.loadSpzFromBuffer(bytes, rdf));
    compare(`version ${version} at degree ${degree}`, readPly(file('theirs.ply')), expected, same(version));
    compare(`version ${version} at degree ${degree}, of the original`, readPly(file('theirs.ply')), original, format(version));
    // Both round alike, except at halves.
    if (version === 4) {
      // Opposite quaternions are the same rotation.
      const turns = ['rot_0', 'rot_1', 'rot_2', 'rot_3'];
      const sign = Array.from({ length: COUNT }, (_, i) => (turns.reduce((sum, key) => sum + read[key][i] * expected[key][i], 0) < 0 ? -1 : 1));
      const value = (name, i) => (turns.includes(name) ? sign[i] : 1) * read[name][i];
      // Harmonics that change their sign when the reference rotates them round halves of a bucket the other way.
      const same = Object.keys(read).filter((name) => !name.startsWith('f_rest'));
      const differ = same.map((name) => read[name].filter((_, i) => Math.abs(value(name, i) - expected[name][i]) > 1e-5).length);
      assert(Math.max(...differ) <= COUNT / 500, `degree ${degree}: ${differ} values rounded otherwise`);
    }
  }
  console.log(`degree ${degree}: ours ${readFileSync(file('ours.spz')).length} bytes, the reference's ${theirs.join(', ')} (versions 4, 3, 2)`);
}

/** The Gaussians of `found` in the order of `original`, by their nearest positions. */
function inOrder(found, original) {
  const places = Array.from({ length: COUNT }, (_, i) => {
    let [best, least] = [-1, Infinity];
    for (let j = 0; j < COUNT; j++) {
      const distance = (found.x[j] - original.x[i]) ** 2 + (found.y[j] - original.y[i]) ** 2 + (found.z[j] - original.z[i]) ** 2;
      if (distance < least) [best, least] = [j, distance];
    }
    return best;
  });
  assert.equal(new Set(places).size, COUNT, 'every Gaussian is nearest to one');
  return Object.fromEntries(Object.entries(found).map(([name, values]) => [name, Float32Array.from(places, (j) => values[j])]));
}

const kinds = (table) => (name) => 1.01 * table[/^[xyz]$/.test(name) ? 'position' : name.replace(/_.*/, '')];
/** Errors of each format at this scene: positions in ±4, logarithms of scales in −9 … 1, coefficients in ±1.5 and ±0.9. */
const lossy = {
  // A chunk of 256 of 3,000 in a cube of 8 is about half as wide as the cube.
  'compressed.ply': kinds({ position: 4 / 1023, f: 8 / 256, scale: 5 / 1023, rot: 0.0025, opacity: 0.5 / 255, n: 0 }),
  // Theirs rounds opacities and rotations down.
  'sog': kinds({ position: 5e-4, f: 1, scale: 0.03, rot: 0.02, opacity: 1 / 255, n: 0 }),
  'glb': kinds({ position: 0, f: 0, scale: 4e-6, rot: 2e-6, opacity: 2e-6, n: 0 }),
  'splat': kinds({ position: 0, f: 0.5 / 255 / 0.282, scale: 4e-6, rot: 0.02, opacity: 0.5 / 255, n: 0 }),
};
/** Two readings of one file. */
const alike = kinds({ position: 2e-5, f: 1e-5, scale: 2e-5, rot: 2e-5, opacity: 2e-5, n: 0 });
/** Bytes of rotations are b / 127.5 − 1 to splat-transform, and (b − 128) / 128 to the viewer that the format is from, and to us. */
const halves = (name) => (name.startsWith('rot') ? 0.01 : alike(name));
const without = (columns) => Object.fromEntries(Object.entries(columns).filter(([name]) => !/^n[xyz]$/.test(name)));
const low = (columns) => Object.fromEntries(Object.entries(columns).filter(([name]) => !/^f_rest/.test(name)));

for (const degree of [0, 3]) {
  const original = without(scene(degree));
  writePly(file('scene.ply'), scene(degree));
  for (const ending of ['compressed.ply', 'sog', 'glb', 'splat']) {
    const step = lossy[ending];
    const whole = ending === 'splat' ? low(original) : original;
    const read = (path) => {
      run('export', path, '--format', 'ply', '--out', file('read.ply'));
      return without(readPly(file('read.ply')));
    };
    // They read our files as we do, and the result equals the input.
    run('export', file('scene.ply'), '--out', file(`ours.${ending}`));
    const ours = read(file(`ours.${ending}`));
    if (ending !== 'glb') {
      convert(file(`ours.${ending}`), file('again.ply'));
      compare(`${ending}: ours at degree ${degree}, by both`, ours, without(readPly(file('again.ply'))), ending === 'splat' ? halves : alike);
    }
    const sizes = [readFileSync(file(`ours.${ending}`)).length];
    const coefficients = (columns) => (ending === 'sog' ? low(columns) : columns);
    compare(`${ending}: ours at degree ${degree}`, inOrder(ours, whole), coefficients(whole), step);
    if (ending === 'splat') { console.log(`splat at degree ${degree}: ours ${sizes[0]} bytes`); continue; }
    // We read their files as they do.
    convert(file('scene.ply'), file(`theirs.${ending}`));
    const theirs = read(file(`theirs.${ending}`));
    if (ending !== 'glb') {
      convert(file(`theirs.${ending}`), file('again.ply'));
      compare(`${ending}: theirs at degree ${degree}, by both`, theirs, without(readPly(file('again.ply'))), alike);
    }
    compare(`${ending}: theirs at degree ${degree}`, inOrder(theirs, whole), coefficients(whole), step);
    sizes.push(readFileSync(file(`theirs.${ending}`)).length);
    if (ending === 'sog' && degree > 0) {
      // 3,000 rows of 45 random coefficients have no structure that shared rows could use: ours, found without a graphics card, lose at most a quarter more.
      const error = (columns) => {
        const found = inOrder(columns, whole);
        const names = Object.keys(whole).filter((name) => name.startsWith('f_rest'));
        const squares = names.map((name) => whole[name].reduce((sum, x, i) => sum + (x - found[name][i]) ** 2, 0));
        return Math.sqrt(squares.reduce((a, b) => a + b) / names.length / COUNT);
      };
      const errors = [ours, theirs].map(error);
      console.log(`SOG, error of further coefficients: ours ${errors[0].toFixed(4)}, theirs ${errors[1].toFixed(4)}`);
      assert(errors[0] <= 1.25 * errors[1], 'shared rows');
      mkdirSync(file('apart'), { recursive: true });
      convert(file('scene.ply'), file('apart/meta.json'));
      compare('sog: images beside meta.json', inOrder(read(file('apart/meta.json')), whole), low(whole), step);
    }
    console.log(`${ending} at degree ${degree}: ours ${sizes[0]} bytes, theirs ${sizes[1]}`);
  }
}

// SPZ of splat-transform: PLY's numbers unchanged, in files that do not state their axes. It reads ours that way, of either version.
{
  const original = without(scene(3));
  writePly(file('scene.ply'), scene(3));
  for (const version of [3, 4]) {
    convert('--spz-version', version, file('scene.ply'), file('theirs.spz'));
    run('export', file('theirs.spz'), '--axes', 'rdf', '--format', 'ply', '--out', file('read.ply'));
    const read = without(readPly(file('read.ply')));
    compare(`SPZ ${version}: theirs`, read, original, format(version));
    convert(file('theirs.spz'), file('again.ply'));
    compare(`SPZ ${version}: theirs, by both`, read, without(readPly(file('again.ply'))), same(version));
    run('export', file('scene.ply'), '--spz-version', version, '--out', file('ours.spz'));
    convert(file('ours.spz'), file('again.ply'));
    compare(`SPZ ${version}: ours, by them`, without(readPly(file('again.ply'))), original, format(version));
    run('export', file('ours.spz'), '--format', 'ply', '--out', file('read.ply'));
    compare(`SPZ ${version}: ours, by both`, without(readPly(file('read.ply'))), without(readPly(file('again.ply'))), same(version));
  }
  console.log('SPZ 3 and 4 of splat-transform: as ours');
}

// Marks of anti-aliased training, in both directions, and files without one.
const MARK = /^comment SplatRenderMode: mip$/m;
const header = (path) => readFileSync(path).toString('latin1').split('end_header')[0];
function marked(path) {
  execFileSync(streamsplat, ['inspect', path, '--json', file('about.json'), '--quiet'], { stdio: 'ignore' });
  return JSON.parse(readFileSync(file('about.json'))).trained_with_antialiasing;
}
for (const [comment, expected] of [['comment SplatRenderMode: mip\n', true], ['comment antialiased 1\n', true], ['comment antialiased 0\n', false], ['', false]]) {
  writePly(file('scene.ply'), scene(1), comment);
  assert.equal(marked(file('scene.ply')), expected, `${JSON.stringify(comment)}: the mark, by us`);
  for (const [ending, ...options] of [['ply'], ['compressed.ply'], ['sog'], ['spz', '--spz-version', '3'], ['spz', '--spz-version', '4']]) {
    const what = `${JSON.stringify(comment)}: ${ending} ${options.join(' ')}`;
    convert(...options, file('scene.ply'), file(`theirs.${ending}`));
    assert.equal(marked(file(`theirs.${ending}`)), expected, `${what}: the mark of theirs, by us`);
    run('export', file('scene.ply'), ...options, '--out', file(`ours.${ending}`));
    assert.equal(marked(file(`ours.${ending}`)), expected, `${what}: the mark of ours, by us`);
    convert(file(`ours.${ending}`), file('again.ply'));
    assert.equal(MARK.test(header(file('again.ply'))), expected, `${what}: the mark of ours, by them`);
  }
}
console.log('marks of anti-aliased training in PLY, compressed PLY, SOG, SPZ 3 and 4: read and written by both');
