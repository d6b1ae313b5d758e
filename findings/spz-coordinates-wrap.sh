#!/usr/bin/env bash
# Package: @adobe/spz 0.2.3 (npm, the reference implementation of SPZ as WebAssembly) and @playcanvas/splat-transform 3.7.0, which writes with it, on valid Gaussians.
# Behaviour: positions have 24 bits, 12 of them after the point, whatever the scene's size. A coordinate beyond 2048 is neither clamped nor refused: its upper bits
#   are cut off, so that it comes back 4096 units away from where it was, or a multiple of that. splat-transform does the same without a warning, with exit code 0.
# Guess beforehand: an error, or the nearest end of the range, or fewer bits after the point.
# Output seen:
#   2047 -> 2047
#   2049 -> -2047
#   5000 -> 904
#   431250.5 -> 1170.5
#   splat-transform: 5000 -> 904
# Consequence: a floater far away lands in the middle of the scene, and a scene in the coordinates of a map is folded over itself. Move such scenes, or take floaters out, before.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
echo '{"type": "module"}' >package.json
npm install --silent --no-audit --no-fund @adobe/spz@0.2.3 @playcanvas/splat-transform@3.7.0 playcanvas@2.23.3 >/dev/null
cat >try.mjs <<'END'
import { execFileSync } from 'node:child_process';
import { readFileSync, writeFileSync } from 'node:fs';
import create from '@adobe/spz';
const spz = await create({ print() {} });
const axes = spz.CoordinateSystem.UNSPECIFIED;
const values = Float32Array.from([2047, 2049, 5000, 431250.5]);
const count = values.length;
const same = (width, value) => new Float32Array(width * count).fill(value);
const rotations = Float32Array.from({ length: 4 * count }, (_, i) => (i % 4 === 3 ? 1 : 0));
const positions = Float32Array.from({ length: 3 * count }, (_, i) => (i % 3 ? 0 : values[i / 3]));
const cloud = { numPoints: count, shDegree: 0, antialiased: false, extensions: [], sh: same(0, 0), alphas: same(1, 1), colors: same(3, 0.3), scales: same(3, -2), rotations, positions };
const back = spz.loadSpzFromBuffer(spz.saveSpzToBuffer(cloud, { version: 4, from: axes, sh1Bits: 5, shRestBits: 4 }), { to: axes });
values.forEach((x, i) => console.log(`${x} -> ${back.positions[3 * i]}`));

const names = 'x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3'.split(' ');
const header = `ply\nformat binary_little_endian 1.0\nelement vertex 1\n${names.map((name) => `property float ${name}\n`).join('')}end_header\n`;
writeFileSync('one.ply', Buffer.concat([Buffer.from(header), Buffer.from(Float32Array.from([5000, 0, 0, 0, 0, 0, 1, -2, -2, -2, 1, 0, 0, 0]).buffer)]));
const convert = (...words) => execFileSync(process.execPath, ['node_modules/@playcanvas/splat-transform/bin/cli.mjs', '--quiet', ...words], { stdio: 'ignore' });
convert('one.ply', 'one.spz');
convert('one.spz', 'back.ply');
const bytes = readFileSync('back.ply');
console.log(`splat-transform: 5000 -> ${bytes.readFloatLE(bytes.indexOf('end_header\n') + 11)}`);
END
found=$(node try.mjs | grep -- '->')
echo "$found"
[ "$found" = '2047 -> 2047
2049 -> -2047
5000 -> 904
431250.5 -> 1170.5
splat-transform: 5000 -> 904' ]
