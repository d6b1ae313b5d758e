import os
import pathlib
import sys

os.environ.setdefault('OMP_WAIT_POLICY', 'passive')
if not pathlib.Path('/dev/nvidia0').exists():
    os.environ['TRITON_INTERPRET'] = '1'                # read when the kernels are defined
HERE = pathlib.Path(__file__).resolve()
sys.path.insert(0, str(HERE.parents[2]))
FIXTURES = pathlib.Path(os.environ.get('STREAMSPLAT_FIXTURES', HERE.parents[3] / 'fixtures'))

import numpy as np
import pytest
import torch

torch.set_num_threads(2)


@pytest.fixture(scope='session')
def clips():
    """Three short procedural clips at 48x64: waves that drift."""
    out = []
    for k in range(3):
        y, x = np.mgrid[0:48, 0:64].astype(np.float32)
        frames = []
        for t in range(12):
            s = [np.sin((x + (1 + k) * t) * 0.3 * (1 + c) + k) * np.cos((y - k * t) * 0.25 + c) for c in range(3)]
            frames.append(((np.stack(s, -1) * 0.4 + 0.5) * 255).astype(np.uint8))
        out.append(np.stack(frames))
    return out
