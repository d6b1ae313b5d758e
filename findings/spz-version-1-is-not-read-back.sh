#!/usr/bin/env bash
# Package: @adobe/spz 0.2.3 (npm, the reference implementation of SPZ as WebAssembly), on one valid cloud of four Gaussians, written in each version that it offers.
# Behaviour: `saveSpzToBuffer` with `version: 1` writes positions in 24-bit fixed point, as in version 2, under the number 1. `loadSpzFromBuffer` reads the
#   positions of version 1 as binary16, as that version defines them, and every attribute after them from the wrong bytes: a scene of other positions and
#   scales, NaN among them. Neither reports an error. Its README calls versions 1 to 3 read-only; the option takes all three, and versions 2 and 3 are right.
# Guess beforehand: the four positions are read back in every version, within a 4096th, or an error.
# Output seen:
#   version 1: 92 bytes inside gzip, first place 0.00048828125 0 0.0000019073486328125, finite: no
#   version 2: 92 bytes inside gzip, first place 1 2 3, finite: yes
#   version 3: 96 bytes inside gzip, first place 1 2 3, finite: yes
# Consequence: write version 2 or later. A reader can recognise such a file of version 1 by its length: 19 bytes for each Gaussian without harmonics, not 16.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
echo '{"type": "module"}' >package.json
npm install --silent --no-audit --no-fund @adobe/spz@0.2.3 >/dev/null
cat >try.mjs <<'END'
import { gunzipSync } from 'node:zlib';
import create from '@adobe/spz';
const spz = await create({ print() {} });
const same = (values) => Float32Array.from({ length: 4 * values.length }, (_, i) => values[i % values.length]);
const cloud = {
  numPoints: 4, shDegree: 0, antialiased: false, extensions: [], sh: new Float32Array(0), alphas: same([1]), colors: same([0.3, 0.3, 0.3]),
  positions: Float32Array.from([1, 2, 3, 4, 5, 6, -1, -2, -3, 0.5, 0.25, 0.125]), scales: same([-2, -2, -2]), rotations: same([0, 0, 0, 1]),
};
const axes = spz.CoordinateSystem.UNSPECIFIED;
for (const version of [1, 2, 3]) {
  const bytes = spz.saveSpzToBuffer(cloud, { version, from: axes, sh1Bits: 5, shRestBits: 4 });
  const { positions } = spz.loadSpzFromBuffer(bytes, { to: axes });
  const finite = [...positions].every(Number.isFinite) ? 'yes' : 'no';
  console.log(`version ${version}: ${gunzipSync(bytes).length} bytes inside gzip, first place ${[...positions.subarray(0, 3)].join(' ')}, finite: ${finite}`);
}
END
found=$(node try.mjs | grep '^version')
echo "$found"
[ "$found" = 'version 1: 92 bytes inside gzip, first place 0.00048828125 0 0.0000019073486328125, finite: no
version 2: 92 bytes inside gzip, first place 1 2 3, finite: yes
version 3: 96 bytes inside gzip, first place 1 2 3, finite: yes' ]
