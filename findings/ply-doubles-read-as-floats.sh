#!/usr/bin/env bash
# Packages: @mkkellogg/gaussian-splats-3d 0.4.7 with three 0.169.0 and spz-js 1.2.5 (npm), ply2splat 0.6.0 and gsply 0.4.6 (PyPI), on valid PLY files of three
#   Gaussians: one of floats only, one with x, y and z as doubles, one with a column `uchar label` after the floats.
# Behaviour: of doubles, GaussianSplats3D puts all Gaussians at one place. spz-js takes four of each eight bytes for a float, and ply2splat has wrong positions
#   too. None reports an error. gsply refuses doubles, but leaves a `uchar` column out of its count of bytes, so that each row begins a byte further off; it
#   reports nothing either.
# Guess beforehand: the right positions, or an error that names the type, as of gaussforge 0.6.0 for both files.
# Valid by: Greg Turk's description of PLY, where each property has one of eight types. splat-transform, Babylon.js and plyfile read all three files.
# Output seen:
#   floats: GaussianSplats3D right, spz-js right, ply2splat right, gsply right
#   doubles: GaussianSplats3D 1 place of 3, spz-js wrong, ply2splat wrong, gsply ValueError
#   uchar: GaussianSplats3D right, spz-js RangeError, ply2splat right, gsply wrong
# Consequence: a scene in the coordinates of a map, whose positions `streamsplat export` writes as doubles, must be moved near zero for these programs.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 numba==0.68.1 gsply==0.4.6 ply2splat==0.6.0
echo '{"type": "module"}' >package.json
npm install --silent --no-audit --no-fund @mkkellogg/gaussian-splats-3d@0.4.7 three@0.169.0 spz-js@1.2.5 playcanvas@2.23.3 >/dev/null
cat >write.py <<'END'
import numpy as np

PLACES = [[-4.1, 5.1, -6.1], [1.1, 2.1, 3.1], [7.1, -8.1, 9.1]]
REST = 'f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3'.split()
NAMES = {'<f4': 'float', '<f8': 'double', 'u1': 'uchar'}


def write(path, place, more=()):
    columns = [(name, place) for name in 'xyz'] + [(name, '<f4') for name in REST] + list(more)
    rows = np.zeros(3, columns)
    for axis, name in enumerate('xyz'):
        rows[name] = [found[axis] for found in PLACES]
    rows['opacity'], rows['rot_0'] = 3, 1
    for axis in range(3):
        rows[f'scale_{axis}'] = -2
    with open(path, 'wb') as file:
        header = ''.join(f'property {NAMES[kind]} {name}\n' for name, kind in columns)
        file.write(f'ply\nformat binary_little_endian 1.0\nelement vertex 3\n{header}end_header\n'.encode() + rows.tobytes())


write('floats.ply', '<f4')
write('doubles.ply', '<f8')
write('uchar.ply', '<f4', [('label', 'u1')])
END
cat >read.py <<'END'
import sys

import gsply
import numpy as np
import ply2splat
from write import PLACES


def result(read):
    try:
        places = np.array(read(), float)
    except Exception as error:
        return type(error).__name__
    return 'right' if np.allclose(sorted(places.tolist()), PLACES, atol=1e-5) else 'wrong'


path = sys.argv[1]
print(f'ply2splat {result(lambda: [splat.position for splat in ply2splat.load_ply_file(path).to_list()])}, gsply {result(lambda: gsply.plyread(path).means)}')
END
cat >read.mjs <<'END'
import { readFileSync } from 'node:fs';
// Loaded first: the engine that it requires takes a global `window` for a browser, and the other package needs one.
const { loadPly } = await import('spz-js');
globalThis.window ??= globalThis;
const { PlyLoader } = await import('@mkkellogg/gaussian-splats-3d');
const { Vector3 } = await import('three');

const wanted = '-4.1,5.1,-6.1 1.1,2.1,3.1 7.1,-8.1,9.1';
async function result(read) {
  try {
    const places = await read();
    const found = places.map((place) => place.map((number) => Number(number.toFixed(4))).join()).sort((a, b) => parseFloat(a) - parseFloat(b));
    if (found.join(' ') === wanted) return 'right';
    const different = new Set(found).size;
    return different === 1 ? `1 place of ${places.length}` : 'wrong';
  } catch (error) {
    return error.name;
  }
}
const bytes = Uint8Array.from(readFileSync(process.argv[2]));
const one = await result(async () => {
  const splats = await PlyLoader.loadFromFileData(bytes.buffer.slice(0), 1, 0, true, 0);
  return Array.from({ length: splats.getSplatCount() }, (_, i) => {
    const centre = new Vector3();
    splats.getSplatCenter(i, centre);
    return centre.toArray();
  });
});
const two = await result(async () => {
  const { positions } = await loadPly(new Blob([bytes]).stream());
  return [0, 1, 2].map((i) => [...positions.slice(3 * i, 3 * i + 3)]);
});
console.log(`GaussianSplats3D ${one}, spz-js ${two}`);
END
venv/bin/python write.py
found=$(for kind in floats doubles uchar; do
  echo "$kind: $(node --no-deprecation read.mjs $kind.ply), $(venv/bin/python read.py $kind.ply)"
done)
echo "$found"
[ "$found" = 'floats: GaussianSplats3D right, spz-js right, ply2splat right, gsply right
doubles: GaussianSplats3D 1 place of 3, spz-js wrong, ply2splat wrong, gsply ValueError
uchar: GaussianSplats3D right, spz-js RangeError, ply2splat right, gsply wrong' ]
