#!/usr/bin/env bash
# Package: @playcanvas/splat-transform 3.7.0 and @adobe/spz 0.2.3 (npm), on a valid PLY file of one Gaussian at (1, 2, 3) in PLY's axes (x right, y down, z forward).
# Behaviour: splat-transform writes SPZ with PLY's numbers as they are and does not state their axes in the file. By SPZ's description, numbers without a
#   statement are right, up, back. So the reference implementation, with PLY's axes as the target, returns the Gaussian half a turn about x away; splat-transform itself returns it where it was.
# Guess beforehand: the numbers turned when they are written, or record 0xADBE0003, which states them, in the file.
# Output seen:
#   version 3, by @adobe/spz: 1 -2 -3; by splat-transform: 1 2 3
#   version 4, by @adobe/spz: 1 -2 -3; by splat-transform: 1 2 3
# Consequence: an SPZ file without the record does not contain which of the two it is. The writer has to be known.
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
