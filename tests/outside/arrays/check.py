"""viser and Rerun accept the arrays unchanged: check.py SCENE"""

import sys
from pathlib import Path

import numpy as np
import rerun as rr
import viser
from scene import scenes


def in_viser(server, name, splats):
    """The page is sent the arrays: centres to the bit, covariances as half floats, colours and opacities as bytes."""
    handle = server.scene.add_gaussian_splats(f'/{name}', splats.means, splats.covariances, np.clip(splats.colors, 0, 1), splats.opacities[:, None])
    buffer = np.ascontiguousarray(handle.buffer)
    assert np.array_equal(buffer[:, :3].view(np.float32), splats.means)
    rows, columns = np.triu_indices(3)
    assert np.array_equal(buffer[:, 4:7].view(np.float16), splats.covariances[:, rows, columns].astype(np.float16))
    sent = buffer[:, 7:].view(np.uint8).astype(float) / 255
    assert np.abs(sent[:, :3] - np.clip(splats.colors, 0, 1)).max() <= 1 / 255 and np.abs(sent[:, 3] - splats.opacities).max() <= 1 / 255


def in_rerun(name, splats):
    """The columns of the archetype are the arrays, quaternions with w last."""
    x = np.roll(splats.quats, -1, axis=1)
    colors = np.concatenate([np.clip(splats.colors, 0, 1), splats.opacities[:, None]], axis=1)
    more = splats.sh[:, 1:] if splats.sh_degree == 3 else None
    archetype = rr.GaussianSplats3D(splats.means, scales=splats.scales, quaternions=x, colors=colors, sh_coefficients=more)
    rr.log(name, archetype)
    table = {str(batch.component_descriptor()).split(':')[-1].split('#')[0]: batch.as_arrow_array() for batch in archetype.as_component_batches()}
    numbers = lambda key: np.array(next(column for k, column in table.items() if key in k).flatten())
    assert np.array_equal(numbers('centers').reshape(-1, 3), splats.means) and np.array_equal(numbers('scales').reshape(-1, 3), splats.scales)
    assert np.array_equal(numbers('quaternions').reshape(-1, 4), x)


all_scenes = scenes(Path(sys.argv[1]))
server = viser.ViserServer(host='127.0.0.1', port=0, verbose=False)
rr.init('streamsplat', strict=True)
rr.save('scene.rrd')
for name, splats in all_scenes.items():
    in_viser(server, name, splats)
    in_rerun(name, splats)
server.stop()
rr.disconnect()
assert Path('scene.rrd').stat().st_size > 100_000
print('viser and Rerun take the arrays')
