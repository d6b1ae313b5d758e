#!/usr/bin/env bash
# Package: @adobe/spz 0.2.3 (npm, the reference implementation of SPZ as WebAssembly) and @playcanvas/splat-transform 3.7.0, which writes with it, on valid Gaussians.
# Behaviour: positions have 24 bits, 12 of them after the point, for scenes of every size. A coordinate beyond 2048 is neither clamped nor refused. Its upper
#   bits are cut off, so it is read back off by 4096 units or a multiple of that. splat-transform does the same without a warning, with exit code 0.
# Guess beforehand: an error, or the nearest end of the range, or fewer bits after the point.
# Output seen:
#   2047 -> 2047
#   2049 -> -2047
#   5000 -> 904
#   431250.5 -> 1170.5
#   splat-transform: 5000 -> 904
# Consequence: a distant floater lands in the middle of the scene, and a scene in the coordinates of a map is folded over itself. Move the scene, or remove
#   floaters, before writing.
set -euo pipefail
tools=$(cd "$(dirname "$0")" && pwd)/tools
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
# @adobe/spz@0.2.3, @playcanvas/splat-transform@3.7.0
. "$tools/splat-transform.sh"
cat >try.mjs <<'END'
import create from '@adobe/spz';
import { thereAndBack, write } from './one.mjs';
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

write([5000, 0, 0]);
console.log(`splat-transform: 5000 -> ${thereAndBack()[0]}`);
END
found=$(node try.mjs | grep -- '->')
echo "$found"
[ "$found" = '2047 -> 2047
2049 -> -2047
5000 -> 904
431250.5 -> 1170.5
splat-transform: 5000 -> 904' ]
