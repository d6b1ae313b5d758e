#!/usr/bin/env bash
# Package: @playcanvas/splat-transform 3.7.0 and @adobe/spz 0.2.3 (npm), on a valid PLY file of one Gaussian at (1, 2, 3) in PLY's axes (x right, y down, z forward).
# Behaviour: splat-transform writes SPZ with PLY's numbers unchanged and does not state their axes in the file. By SPZ's description, numbers without a
#   statement are right, up, back. So the reference implementation, with PLY's axes as the target, returns the Gaussian rotated by half a turn about x;
#   splat-transform itself returns it at its place.
# Guess beforehand: the numbers rotated on writing, or record 0xADBE0003, which states their axes, in the file.
# Output seen:
#   version 3, by @adobe/spz: 1 -2 -3; by splat-transform: 1 2 3
#   version 4, by @adobe/spz: 1 -2 -3; by splat-transform: 1 2 3
# Consequence: an SPZ file without the record does not state which of the two axes it has. The writer must be known.
set -euo pipefail
tools=$(cd "$(dirname "$0")" && pwd)/tools
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
# @adobe/spz@0.2.3, @playcanvas/splat-transform@3.7.0
. "$tools/splat-transform.sh"
cat >try.mjs <<'END'
import { readFileSync } from 'node:fs';
import create from '@adobe/spz';
import { thereAndBack, write } from './one.mjs';
const spz = await create({ print() {} });
write([1, 2, 3]);
for (const version of [3, 4]) {
  const own = thereAndBack('--spz-version', version);
  const place = [...spz.loadSpzFromBuffer(readFileSync('one.spz'), { to: spz.CoordinateSystem.RDF }).positions];
  console.log(`version ${version}, by @adobe/spz: ${place.join(' ')}; by splat-transform: ${own.join(' ')}`);
}
END
found=$(node try.mjs | grep '^version')
echo "$found"
[ "$found" = 'version 3, by @adobe/spz: 1 -2 -3; by splat-transform: 1 2 3
version 4, by @adobe/spz: 1 -2 -3; by splat-transform: 1 2 3' ]
