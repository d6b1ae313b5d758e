#!/usr/bin/env bash
# Package: OpenEXR 3.5.3 (PyPI, the reference implementation's own bindings) with NumPy 2.4.6, on valid arrays that are not contiguous.
# Behaviour: `OpenEXR.File(header, channels).write(path)` takes an array's shape, but its bytes as they lie in memory. A picture that is a transposed view, as
#   `chw.transpose(1, 2, 0)` of a network's output, and a depth map in Fortran's order are written scrambled. Nothing is raised.
# Guess beforehand: the array's values, or an error, as for an array of another size or type.
# Valid by: the documentation of `OpenEXR.Channel`, which names the types of `pixels` and no order. Upstream's issue 1929 is open and calls it an assumption.
# Output seen (the pixel in row 0, column 1: red, green, blue, depth):
#   contiguous: 1 101 201 301
#   transposed views: 3 4 5 306
# Consequence: depth maps that are written so for `--depth` are wrong, and look like noise or stripes. Pass arrays through `numpy.ascontiguousarray` first.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 OpenEXR==3.5.3
cat >try.py <<'END'
import numpy as np
import OpenEXR

HEIGHT, WIDTH = 4, 6
chw = np.float32(np.arange(HEIGHT * WIDTH).reshape(1, HEIGHT, WIDTH) + np.array([0, 100, 200]).reshape(3, 1, 1))
depth = chw[0] + np.float32(300)
header = {'compression': OpenEXR.ZIP_COMPRESSION, 'type': OpenEXR.scanlineimage}
views = chw.transpose(1, 2, 0), np.asfortranarray(depth)
for name, (picture, z) in {'contiguous': map(np.ascontiguousarray, views), 'transposed views': views}.items():
    assert picture.shape == (HEIGHT, WIDTH, 3) and picture[0, 1].tolist() == [1, 101, 201] and z[0, 1] == 301
    with OpenEXR.File(header, {'RGB': picture, 'Z': z}) as file:
        file.write('one.exr')
    with OpenEXR.File('one.exr') as file:
        channels = file.channels()
        found = [*channels['RGB'].pixels[0, 1], channels['Z'].pixels[0, 1]]
    print(f'{name}: {" ".join(f"{value:g}" for value in found)}')
END
found=$(venv/bin/python try.py)
echo "$found"
[ "$found" = 'contiguous: 1 101 201 301
transposed views: 3 4 5 306' ]
