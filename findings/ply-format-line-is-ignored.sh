#!/usr/bin/env bash
# Packages: @playcanvas/splat-transform 3.7.0, @mkkellogg/gaussian-splats-3d 0.4.7 with three 0.169.0, and babylonjs 9.28.0 (npm), on one scene of three
#   Gaussians in the three encodings of PLY.
# Behaviour: all three take every file for binary, little-endian. Of `format ascii 1.0` and `format binary_big_endian 1.0` they read other positions, many
#   close to zero or beyond any scene, without a message. splat-transform converts such a file with exit code 0. Babylon.js is called by
#   `GaussianSplattingMesh.ConvertPLYToSplatAsync`.
# Guess beforehand: the same positions, or an error that names the encoding, as of gaussforge 0.6.0 and spz-js 1.2.5.
# Valid by: Greg Turk's description of PLY: the header's second line is one of these three, and readers choose by it.
# Output seen:
#   splat-transform: binary_little_endian right, ascii wrong, binary_big_endian wrong
#   GaussianSplats3D: binary_little_endian right, ascii wrong, binary_big_endian wrong
#   Babylon.js: binary_little_endian right, ascii wrong, binary_big_endian wrong
# Consequence: a scene that another program wrote as text (plyfile with `text=True`, say) looks damaged there. `streamsplat export` reads all three encodings
#   and writes the one that these programs expect.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
echo '{"type": "module"}' >package.json
npm install --silent --no-audit --no-fund @playcanvas/splat-transform@3.7.0 playcanvas@2.23.3 @mkkellogg/gaussian-splats-3d@0.4.7 three@0.169.0 \
  babylonjs@9.28.0 >/dev/null
cat >try.mjs <<'END'
import { execFileSync } from 'node:child_process';
import { readFileSync, writeFileSync } from 'node:fs';
// Two of the packages need these globals of a browser at import.
globalThis.window ??= globalThis;
globalThis.XMLHttpRequest ??= class {};
const { PlyLoader } = await import('@mkkellogg/gaussian-splats-3d');
const { Vector3 } = await import('three');
const { default: BABYLON } = await import('babylonjs');

const names = 'x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3'.split(' ');
const places = [[1, 2, 3], [-4, 5, -6], [7, -8, 9]];
const rows = places.map((place) => [...place, 0.5, 0.25, 0.125, 3, -2, -3, -4, 1, 0, 0, 0]);
const binary = (little) => {
  const view = new DataView(new ArrayBuffer(4 * rows.flat().length));
  rows.flat().forEach((value, i) => view.setFloat32(4 * i, value, little));
  return Buffer.from(view.buffer);
};
const bodies = {
  binary_little_endian: binary(true),
  // With six decimals the text is longer than the binary numbers.
  ascii: Buffer.from(rows.map((row) => `${row.map((value) => value.toFixed(6)).join(' ')}\n`).join('')),
  binary_big_endian: binary(false),
};

const readers = {
  'splat-transform': () => {
    const program = 'node_modules/@playcanvas/splat-transform/bin/cli.mjs';
    execFileSync(process.execPath, [program, '--quiet', '--overwrite', 'one.ply', 'back.ply'], { stdio: 'ignore' });
    const bytes = readFileSync('back.ply');
    const end = bytes.indexOf('end_header\n') + 11;
    const stride = (bytes.length - end) / places.length;
    return places.map((_, i) => [0, 4, 8].map((axis) => bytes.readFloatLE(end + i * stride + axis)));
  },
  GaussianSplats3D: async (bytes) => {
    const splats = await PlyLoader.loadFromFileData(bytes.slice(0), 1, 0, true, 0);
    return Array.from({ length: splats.getSplatCount() }, (_, i) => {
      const centre = new Vector3();
      splats.getSplatCenter(i, centre);
      return centre.toArray();
    });
  },
  'Babylon.js': async (bytes) => {
    const splats = await BABYLON.GaussianSplattingMesh.ConvertPLYToSplatAsync(bytes.slice(0));
    const floats = new Float32Array(splats.buffer ?? splats);
    return Array.from({ length: floats.length / 8 }, (_, i) => [...floats.slice(8 * i, 8 * i + 3)]);
  },
};

const sorted = (list) => JSON.stringify([...list].sort((a, b) => a[0] - b[0]));
for (const [reader, read] of Object.entries(readers)) {
  const results = [];
  for (const [format, body] of Object.entries(bodies)) {
    const header = `ply\nformat ${format} 1.0\nelement vertex ${rows.length}\n${names.map((name) => `property float ${name}\n`).join('')}end_header\n`;
    const bytes = Buffer.concat([Buffer.from(header), body]);
    writeFileSync('one.ply', bytes);
    const found = await read(Uint8Array.from(bytes).buffer);
    results.push(`${format} ${sorted(found) === sorted(places) ? 'right' : 'wrong'}`);
  }
  console.log(`${reader}: ${results.join(', ')}`);
}
process.exit(0);
END
found=$(node --no-deprecation try.mjs)
echo "$found"
[ "$found" = 'splat-transform: binary_little_endian right, ascii wrong, binary_big_endian wrong
GaussianSplats3D: binary_little_endian right, ascii wrong, binary_big_endian wrong
Babylon.js: binary_little_endian right, ascii wrong, binary_big_endian wrong' ]
