#!/usr/bin/env bash
# Package: @playcanvas/splat-transform 3.7.0 and @adobe/spz 0.2.3 (npm), on a valid PLY file of one Gaussian at (1, 2, 3) in PLY's axes (x right, y down, z forward).
# Behaviour: splat-transform writes SPZ with PLY's numbers as they are and does not state their axes in the file. SPZ's description says that numbers without a
#   statement are right, up, back. So the reference implementation, asked for PLY's axes, returns the Gaussian half a turn about x away; splat-transform itself returns it where it was.
# Guess beforehand: the numbers turned when they are written, or record 0xADBE0003, which states them, in the file.
# Output seen:
#   version 3, by @adobe/spz: 1 -2 -3; by splat-transform: 1 2 3
#   version 4, by @adobe/spz: 1 -2 -3; by splat-transform: 1 2 3
# Consequence: nothing in an SPZ file without the record tells which of the two it is. Ask who wrote it.
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
const names = 'x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3'.split(' ');
const header = `ply\nformat binary_little_endian 1.0\nelement vertex 1\n${names.map((name) => `property float ${name}\n`).join('')}end_header\n`;
writeFileSync('one.ply', Buffer.concat([Buffer.from(header), Buffer.from(Float32Array.from([1, 2, 3, 0, 0, 0, 1, -2, -2, -2, 1, 0, 0, 0]).buffer)]));
const convert = (...words) => execFileSync(process.execPath, ['node_modules/@playcanvas/splat-transform/bin/cli.mjs', '--quiet', '--overwrite', ...words], { stdio: 'ignore' });
for (const version of [3, 4]) {
  convert('--spz-version', version, 'one.ply', 'one.spz');
  convert('one.spz', 'back.ply');
  const bytes = readFileSync('back.ply');
  const at = bytes.indexOf('end_header\n') + 11;
  const place = [...spz.loadSpzFromBuffer(readFileSync('one.spz'), { to: spz.CoordinateSystem.RDF }).positions];
  console.log(`version ${version}, by @adobe/spz: ${place.join(' ')}; by splat-transform: ${[0, 4, 8].map((axis) => bytes.readFloatLE(at + axis)).join(' ')}`);
}
END
found=$(node try.mjs | grep '^version')
echo "$found"
[ "$found" = 'version 3, by @adobe/spz: 1 -2 -3; by splat-transform: 1 2 3
version 4, by @adobe/spz: 1 -2 -3; by splat-transform: 1 2 3' ]
