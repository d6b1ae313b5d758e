// node check.mjs STREAMSPLAT FOLDER: GaussianSplats3D packs generated scenes into .ksplat at every level and degree, and unpacks them; this program must read
// the same numbers.
import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { readFileSync, writeFileSync } from 'node:fs';

// The package needs the global `window` of a browser at import.
globalThis.window ??= globalThis;
const { PlyLoader } = await import('@mkkellogg/gaussian-splats-3d');
const { Quaternion, Vector3, Vector4 } = await import('three');

const [streamsplat, folder] = process.argv.slice(2);
const COUNT = 2000;
const Y0 = 0.28209479177387814;

const names = (degree) => [
  ...'x y z nx ny nz f_dc_0 f_dc_1 f_dc_2'.split(' '),
  ...Array.from({ length: 3 * ((degree + 1) ** 2 - 1) }, (_, i) => `f_rest_${i}`),
  ...'opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3'.split(' '),
];

/** A PLY file with numbers from a generator of its own: with clusters, so that some buckets are full and others not. */
function scene(path, degree) {
  let state = 4711 + degree;
  const next = () => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return state / 2 ** 32 - 0.5;
  };
  const keys = names(degree);
  const body = new Float32Array(COUNT * keys.length);
  for (let i = 0; i < COUNT; i++) {
    keys.forEach((key, k) => {
      const value = key.startsWith('scale') ? -3 + 2 * next()
        : key === 'opacity' ? 8 * next()
        : 'xyz'.includes(key) ? 3 * next() + (i % 4) * 20
        : key.startsWith('n') ? 0 : 2 * next();
      body[i * keys.length + k] = value;
    });
  }
  const header = `ply\nformat binary_little_endian 1.0\nelement vertex ${COUNT}\n`
    + keys.map((key) => `property float ${key}\n`).join('') + 'end_header\n';
  const bytes = Buffer.concat([Buffer.from(header), Buffer.from(body.buffer)]);
  writeFileSync(path, bytes);
  return Uint8Array.from(bytes).buffer;
}

function readPly(path) {
  const bytes = readFileSync(path);
  const end = bytes.indexOf('end_header\n') + 11;
  const keys = [...bytes.subarray(0, end).toString().matchAll(/property float (\w+)/g)].map((match) => match[1]);
  const values = new Float32Array(Uint8Array.from(bytes.subarray(end)).buffer);
  assert.equal(values.length, COUNT * keys.length);
  return (name, i) => values[i * keys.length + keys.indexOf(name)];
}

let checked = 0;
for (let degree = 0; degree <= 2; degree++) {
  const ply = scene(`${folder}/scene-${degree}.ply`, degree);
  for (let level = 0; level <= 2; level++) {
    const packed = await PlyLoader.loadFromFileData(ply.slice(0), 1, level, true, degree);
    const [file, back] = [`${folder}/${level}-${degree}.ksplat`, `${folder}/${level}-${degree}.ply`];
    writeFileSync(file, Buffer.from(packed.bufferData));
    execFileSync(streamsplat, ['export', file, '--out', back, '--quiet'], { stdio: ['ignore', 'ignore', 'inherit'] });
    const own = readPly(back);
    const count = packed.getSplatCount();
    assert.equal(count, COUNT);
    const rest = (degree + 1) ** 2 - 1;
    const harmonics = new Float32Array(count * 3 * rest);
    // Bytes stay unchanged: its shader converts them to numbers between the least and the greatest.
    if (rest > 0) packed.fillSphericalHarmonicsArray(harmonics, degree, undefined, undefined, undefined, undefined, 0);
    const [least, greatest] = [packed.minSphericalHarmonicsCoeff, packed.maxSphericalHarmonicsCoeff];
    if (level === 2) harmonics.forEach((byte, i) => { harmonics[i] = least + (byte / 255) * (greatest - least); });
    const near = (a, b, what, least = 1e-6) => {
      assert.ok(Math.abs(a - b) <= least * Math.max(1, Math.abs(b)), `level ${level}, degree ${degree}, ${what}: ${a} and ${b}`);
      checked += 1;
    };
    const [centre, scale, turn, colour] = [new Vector3(), new Vector3(), new Quaternion(), new Vector4()];
    for (let i = 0; i < count; i++) {
      packed.getSplatCenter(i, centre);
      packed.getSplatScaleAndRotation(i, scale, turn);
      packed.getSplatColor(i, colour);
      'xyz'.split('').forEach((axis, k) => {
        near(own(axis, i), centre[axis], `centre ${i}`);
        near(Math.exp(own(`scale_${k}`, i)), scale[axis], `scale ${i}`);
      });
      ['w', 'x', 'y', 'z'].forEach((axis, k) => near(own(`rot_${k}`, i), turn[axis], `rotation ${i}`));
      ['x', 'y', 'z'].forEach((axis, k) => near(255 * (0.5 + Y0 * own(`f_dc_${k}`, i)), colour[axis], `colour ${i}`, 1e-4));
      near(255 / (1 + Math.exp(-own('opacity', i))), colour.w, `opacity ${i}`, 1e-4);
      // Both are by coefficient, then channel; ours are in the columns of PLY by channel.
      for (let k = 0; k < rest; k++) {
        for (let channel = 0; channel < 3; channel++) {
          near(own(`f_rest_${channel * rest + k}`, i), harmonics[i * 3 * rest + 3 * k + channel], `harmonic ${k} of ${i}`);
        }
      }
    }
  }
}
console.log(`ksplat: ${checked} numbers of 9 files are those of GaussianSplats3D`);
