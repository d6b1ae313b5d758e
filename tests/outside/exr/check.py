"""Checks of tests/outside/exr/run: check.py PROGRAM."""
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image

ROOT = Path(__file__).resolve().parents[3]
PROGRAM = sys.argv[1]


def program(*arguments):
    done = subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def layers(path):
    """Name → (header, channels) of every part, samples as stored."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {part.header['name']: (dict(part.header), {name: channel.pixels.copy() for name, channel in part.channels.items()})
                for part in file.parts}


def main():
    with tempfile.TemporaryDirectory(prefix='streamsplat-exr-') as folder:
        out, black = Path(folder) / 'out', Path(folder) / 'black'
        clip = ROOT / 'fixtures' / 'clips' / 'moving.y4m'
        program('run', clip, '--gap', '2', '--frames', '5', '--emit', 'rgb,depth,alpha,exr,scene', '--quiet', '--out', out)
        names = sorted(p.stem for p in (out / 'exr').iterdir())
        assert len(names) == 5, names
        for name in names:
            found = layers(out / 'exr' / f'{name}.exr')
            assert list(found) == ['colour', 'depth', 'alpha'], list(found)
            assert [sorted(channels) for _, channels in found.values()] == [['B', 'G', 'R'], ['Z'], ['A']]
            assert all(pixels.dtype == np.float32 for _, channels in found.values() for pixels in channels.values())
            header, colour = found['colour']
            assert 'display (gamma) space' in header['comments'] and header['oiio:ColorSpace'] == 'sRGB', header
            # The PNG is the colour layer in eight bits: clamped, times 255, half up.
            rgb = np.stack([colour[c] for c in 'RGB'], -1)
            eight = (np.clip(rgb, 0, 1) * np.float32(255) + np.float32(0.5)).astype(np.uint8)
            assert (eight == np.asarray(Image.open(out / 'frames' / f'{name}.png'))).all(), name
            (single,) = OpenEXR.File(str(out / 'depth' / f'{name}.exr'), separate_channels=True).parts
            assert (single.channels['Z'].pixels.view(np.uint32) == found['depth'][1]['Z'].view(np.uint32)).all(), name
            assert (single.channels['A'].pixels.view(np.uint32) == found['alpha'][1]['A'].view(np.uint32)).all(), name
            assert rgb.std() > 0.01 and found['depth'][1]['Z'].std() > 0.001, 'the image is flat'
        # Over black the colours are multiplied by alpha: with the background's share they yield the others.
        program('render', out, '--emit', 'exr', '--background', '0', '--quiet', '--out', black)
        over, under = layers(out / 'exr' / '000003.exr'), layers(black / 'exr' / '000003.exr')
        alpha = over['alpha'][1]['A']
        assert (alpha == under['alpha'][1]['A']).all()
        apart = max(abs(over['colour'][1][c] - under['colour'][1][c] - (1 - alpha) * 0.5).max() for c in 'RGB')
        assert apart < 1e-5, apart
    print('every layer is as OpenEXR reads it')


if __name__ == '__main__':
    main()
