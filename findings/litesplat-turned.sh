#!/usr/bin/env bash
# Package: litesplat 0.1.1 (PyPI) with keras 3.15.1, NumPy as its backend (which requires JAX), on a valid scene of one Gaussian.
# Behaviour: a Gaussian's rotation is multiplied with the camera's element by element, not as a matrix. A needle rotated by 90° about the line of sight shrinks
#   to a point, since only the diagonal of its rotation remains. One rotated by 45° is drawn upright, too short and too thin.
# Guess beforehand: the needle rotated by 90° covers as many pixels as before, along the other axis.
# Output seen:
#   0 degrees: 17 columns, 5 rows
#   45 degrees: 11 columns, 3 rows
#   90 degrees: 1 columns, 1 rows
# Consequence: images of litesplat are a reference only for Gaussians and cameras without rotation.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check numpy==2.4.6 scipy==1.16.3 jax==0.10.2 litesplat==0.1.1 keras==3.15.1
cd "$folder"
cat >draw.py <<'PYTHON'
import json
import math

import numpy as np
from litesplat.core.camera_model import CameraLayer
from litesplat.core.gaussian_model import GaussianParameterLayer

camera = dict(camera_id=0, model='PINHOLE', image_name='', width=40, height=40, fx=40, fy=40, cx=20, cy=20, rotation=np.eye(3).tolist(), translation=[0, 0, 0])
json.dump([camera], open('camera.json', 'w'))
for degrees in (0, 45, 90):
    half = math.radians(degrees) / 2
    turn = [math.cos(half), 0, 0, math.sin(half)]
    needle = dict(position=[0, 0, 2], color=[1, 1, 1], rotation=turn, translation=[0, 0, 2], scale=[0.2, 0.05, 0.05], opacity=0.9)
    json.dump([needle], open('gaussians.json', 'w'))
    image = np.asarray(CameraLayer('.', GaussianParameterLayer('.'))(inputs=(40, 40), render=False))[..., 0] > 0.1
    seen = f'{image.any(0).sum()} columns, {image.any(1).sum()} rows' if image.any() else 'nothing'
    print(f'{degrees} degrees: {seen}')
PYTHON
found=$(KERAS_BACKEND=numpy "$folder/venv/bin/python" draw.py 2>/dev/null | grep degrees)
echo "$found"
[ "$found" = $'0 degrees: 17 columns, 5 rows\n45 degrees: 11 columns, 3 rows\n90 degrees: 1 columns, 1 rows' ]
