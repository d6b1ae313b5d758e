"""Checks of tests/outside/images/run: check.py PROGRAM."""
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import tifffile
from PIL import Image, ImageCms

ROOT = Path(__file__).resolve().parents[3]
PROGRAM = sys.argv[1]
MODEL = ROOT / 'fixtures' / 'parity' / 'tiny-nodino.safetensors'
H, W = 24, 40
Y, X = np.mgrid[:H, :W]
RGB = np.stack([X * 6 % 256, Y * 10 % 256, X * Y % 256], -1).astype(np.uint8)
ALPHA = (X * 6).astype(np.uint8)


def attempt(source, out, *more):
    return subprocess.run([PROGRAM, 'run', str(source), '--out', str(out), '--model', str(MODEL), '--overwrite', *more],
                          capture_output=True, text=True)


class Checks:
    """Files in a folder, and the samples that the program reads from them."""

    def __init__(self, folder):
        self.folder, self.count = Path(folder), 0

    def read(self, source, *more):
        """Digest of all samples and times of an input, and the messages."""
        out = self.folder / 'out'
        done = attempt(source, out, *more)
        assert done.returncode == 0, (source, done.stderr)
        return json.loads((out / 'run.json').read_text())['input']['blake3'], done.stderr

    def samples(self, rgb):
        """The digest of a picture of these samples, 8 bits or floats of the display."""
        path = self.folder / 'expected.tif'
        tifffile.imwrite(path, rgb, photometric='rgb')
        return self.read(path)[0]

    def equal(self, name, rgb, said=''):
        """The file holds this picture; the messages about it contain these words."""
        digest, text = self.read(self.folder / name)
        assert digest == self.samples(rgb), f'{name}: other samples than were written'
        assert said in text, f'{name}: expected {said!r}, found {text!r}'
        self.count += 1

    def compared(self, name, other):
        """Two files have the same samples."""
        done = subprocess.run([PROGRAM, 'compare', self.folder / name, self.folder / other], capture_output=True, text=True)
        assert done.returncode == 0 and 'equal' in done.stdout, f'{name} and {other}: {done.stdout} {done.stderr}'

    def refused(self, name, words):
        done = attempt(self.folder / name, self.folder / 'refused')
        lines = done.stderr.strip().splitlines()
        assert done.returncode == 1 and len(lines) == 1 and words in lines[0] and name in lines[0], (name, done.stderr)
        self.count += 1


def over_grey(rgb, alpha):
    a = alpha[..., None].astype(np.float32) / np.float32(255)
    colour = rgb.astype(np.float32) / np.float32(255)
    return colour * a + np.float32(0.5) * (1 - a)


def tiff(check):
    write = lambda name, data, **tags: tifffile.imwrite(check.folder / name, data, **tags)
    for name, tags in {
        'plain.tif': {}, 'big.tif': {'bigtiff': True}, 'lzw.tif': {'compression': 'lzw'}, 'other-end.tif': {'byteorder': '>'},
        'deflate.tif': {'compression': 'zlib', 'predictor': True}, 'packbits.tif': {'compression': 'packbits'},
    }.items():
        write(name, RGB, photometric='rgb', **tags)
        check.equal(name, RGB)
    write('planes.tif', np.moveaxis(RGB, -1, 0).copy(), photometric='rgb', planarconfig='separate')
    check.equal('planes.tif', RGB)
    write('deep.tif', RGB.astype(np.uint16) * 257, photometric='rgb')
    check.equal('deep.tif', RGB)
    write('tiles.tif', np.tile(RGB, (2, 2, 1)), photometric='rgb', tile=(16, 16))
    check.equal('tiles.tif', np.tile(RGB, (2, 2, 1)))
    write('grey.tif', RGB[..., 0], photometric='minisblack')
    check.equal('grey.tif', np.repeat(RGB[..., :1], 3, -1))
    write('white.tif', RGB[..., 0], photometric='miniswhite')
    check.equal('white.tif', np.repeat(255 - RGB[..., :1], 3, -1))
    few = Image.fromarray(RGB).quantize(200)
    few.save(check.folder / 'palette.tif')
    check.equal('palette.tif', np.asarray(few.convert('RGB')))
    # `compare` reads its own samples, of the palette's colours too.
    few.convert('RGB').save(check.folder / 'palette.png')
    check.compared('palette.tif', 'palette.png')
    dots = Image.fromarray(RGB).convert('1')
    dots.save(check.folder / 'dots.tif')
    check.equal('dots.tif', np.asarray(dots.convert('RGB')))
    Image.fromarray(RGB).save(check.folder / 'turned.tif', tiffinfo={274: 6})
    check.equal('turned.tif', np.rot90(RGB, -1).copy())
    write('more.tif', np.dstack([RGB, ALPHA]), photometric='rgb', extrasamples=['unspecified'])
    check.equal('more.tif', RGB, 'left out (1 of 4)')
    write('pages.tif', np.stack([RGB, 255 - RGB]), photometric='rgb')
    assert check.read(check.folder / 'pages.tif')[0] == check.read(frames(check, [RGB, 255 - RGB]))[0]
    for name, tags, words in [
        ('jpeg.tif', {'compression': 'jpeg'}, 'found JPEG (7)'),
        ('zstd.tif', {'compression': 'zstd'}, 'found Zstandard (50000)'),
    ]:
        write(name, np.repeat(np.repeat(RGB, 2, 0), 2, 1), photometric='rgb', **tags)
        check.refused(name, words)
    Image.fromarray(RGB).convert('YCbCr').save(check.folder / 'ycbcr.tif')
    check.refused('ycbcr.tif', 'found YCbCr')


def frames(check, pictures):
    folder = check.folder / 'frames'
    folder.mkdir(exist_ok=True)
    for old in folder.iterdir():
        old.unlink()
    for index, picture in enumerate(pictures):
        Image.fromarray(picture).save(folder / f'{index}.png')
    return folder


def png_and_webp(check):
    exif = Image.Exif()
    for value, turn in [(3, lambda a: a[::-1, ::-1]), (5, lambda a: a.transpose(1, 0, 2)), (6, lambda a: np.rot90(a, -1)), (8, np.rot90)]:
        exif[274] = value
        for ending in ['png', 'webp']:
            Image.fromarray(RGB).save(check.folder / f'turned.{ending}', exif=exif, lossless=True)
            check.equal(f'turned.{ending}', turn(RGB).copy())
    rgba = Image.fromarray(np.dstack([RGB, ALPHA]))
    rgba.save(check.folder / 'alpha.png')
    check.equal('alpha.png', over_grey(RGB, ALPHA), 'transparent parts are laid over mid grey')
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile('sRGB')).tobytes()
    Image.fromarray(RGB).save(check.folder / 'srgb.png', icc_profile=profile)
    assert 'profile' not in check.read(check.folder / 'srgb.png')[1]
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile('LAB')).tobytes()
    Image.fromarray(RGB).save(check.folder / 'lab.png', icc_profile=profile)
    check.equal('lab.png', RGB, 'is not applied: colours are taken as sRGB')
    pictures = [np.roll(RGB, 3 * i, 1) for i in range(4)]
    first, *rest = map(Image.fromarray, pictures)
    # Only key frames in WebP: where frames are laid over each other the decoder is off by up to 1/255.
    for ending in ['png', 'apng', 'webp']:
        path = check.folder / f'even.{ending}'
        first.save(path, 'WEBP' if ending == 'webp' else 'PNG', save_all=True, append_images=rest, duration=125, lossless=True, kmin=0, kmax=1)
        expected = check.read(frames(check, pictures), '--fps', '8')[0]
        assert check.read(path)[0] == expected, f'{path.name}: other frames or times than were written'
        first.save(path, 'WEBP' if ending == 'webp' else 'PNG', save_all=True, append_images=rest, duration=[125, 250, 125, 125], lossless=True, kmin=0, kmax=1)
        assert check.read(path)[0] != expected, f'{path.name}: times are not followed'
        assert check.read(path, '--fps', '8')[0] == expected, f'{path.name}: other frames than were written'
        check.count += 1


def jpeg(check):
    smooth = Image.fromarray(np.stack([X * 5 + 20, Y * 8 + 20, (X + Y) * 3 + 10], -1).astype(np.uint8)).resize((320, 192))
    for name, options in {'plain': {}, 'progressive': {'progressive': True}, 'full': {'subsampling': 0}}.items():
        smooth.save(check.folder / f'{name}.jpg', quality=92, **options)
        whole = (check.folder / f'{name}.jpg').read_bytes()
        check.read(check.folder / f'{name}.jpg')
        for share in (0.3, 0.6, 0.99):
            (check.folder / f'{name}-cut.jpg').write_bytes(whole[:int(share * len(whole))])
            check.refused(f'{name}-cut.jpg', 'cut off')
    smooth.convert('CMYK').save(check.folder / 'inks.jpg')
    assert 'CMYK is converted without a colour profile' in check.read(check.folder / 'inks.jpg')[1]
    # Whole images of every kind are read; of damaged scans most are refused. 20 bytes of a picture of noise are overwritten.
    noise = np.random.default_rng(3).integers(0, 256, (90, 130, 3)).astype(np.uint8)
    kinds = {'444': {'subsampling': 0}, '422': {'subsampling': 1}, '420': {'subsampling': 2}, 'optimised': {'optimize': True},
             'restarts': {'restart_marker_blocks': 7}, 'low': {'quality': 3}, 'high': {'quality': 100}, 'progressive': {'progressive': True}}
    refused = 0
    for name, how in kinds.items():
        for mode in ('RGB', 'L', 'CMYK'):
            Image.fromarray(noise).convert(mode).save(check.folder / f'{name}-{mode}.jpg', **how)
            check.read(check.folder / f'{name}-{mode}.jpg')
            check.count += 1
        whole = (check.folder / f'{name}-RGB.jpg').read_bytes()
        start = whole.index(b'\xff\xda') + 14
        for k in range(10 if name != 'progressive' else 0):
            damaged, at = bytearray(whole), start + (len(whole) - start - 40) * k // 10
            damaged[at:at + 20] = bytes((37 * k + 91 * i) % 255 for i in range(20))
            (check.folder / 'damaged.jpg').write_bytes(damaged)
            done = attempt(check.folder / 'damaged.jpg', check.folder / 'refused')
            assert done.returncode in (0, 1), done.stderr
            refused += done.returncode
    assert refused >= 48, f'{refused} of 70 damaged JPEG images were refused'
    check.count += 70


def exr(check):
    shown = RGB.astype(np.float32) / np.float32(255)

    def write(name, pixels, **header):
        header = {'compression': OpenEXR.ZIP_COMPRESSION, 'type': OpenEXR.scanlineimage, **header}
        with OpenEXR.File(header, {'RGB': pixels}) as file:
            file.write(str(check.folder / name))

    write('display.exr', shown, colorInteropID='srgb_rec709_scene')
    check.equal('display.exr', RGB)
    light = np.linspace(0, 1, H * W * 3, dtype=np.float32).reshape(H, W, 3)
    double = light.astype(np.float64)
    srgb = np.where(double <= 0.0031308, 12.92 * double, 1.055 * double ** (1 / 2.4) - 0.055).astype(np.float32)
    for name, header in {'plain.exr': {}, 'said.exr': {'colorInteropID': 'lin_rec709_scene'}}.items():
        write(name, light, **header)
        check.equal(name, srgb, 'EXR colours are')
    half = light.astype(np.float16)
    double = half.astype(np.float64)
    srgb = np.where(double <= 0.0031308, 12.92 * double, 1.055 * double ** (1 / 2.4) - 0.055).astype(np.float32)
    for name in ['PIZ', 'RLE', 'ZIPS', 'NO']:
        write(f'{name}.exr', half, compression=getattr(OpenEXR, f'{name}_COMPRESSION'))
        check.equal(f'{name}.exr', srgb)
    for name in ['ZSTD', 'HTJ2K256']:
        write(f'{name}.exr', half, compression=getattr(OpenEXR, f'{name}_COMPRESSION'))
        check.refused(f'{name}.exr', 'oiiotool IN --compression zip -o OUT')
    # Files of OpenImageIO for these names, in tiles and in a window of its own.
    for space, same in [('sRGB', True), ('lin_srgb', False), ('ACEScg', False), ('lin_rec2020_scene', False)]:
        spec = oiio.ImageSpec(W, H, 3, oiio.FLOAT)
        spec.attribute('oiio:ColorSpace', space)
        spec.tile_width = spec.tile_height = 16
        spec.x, spec.y, spec.full_width, spec.full_height = 5, 4, W + 20, H + 16
        name = f'{space}.exr'
        output = oiio.ImageOutput.create(str(check.folder / name))
        assert output.open(str(check.folder / name), spec) and output.write_image(np.ascontiguousarray(shown))
        output.close()
        window = np.zeros((H + 16, W + 20, 3), np.uint8)
        window[4:4 + H, 5:5 + W] = RGB
        digest, text = check.read(check.folder / name)
        assert (digest == check.samples(window)) == same, name
        assert ('are converted from' in text) != same, (name, text)
        check.count += 1
    write('log.exr', shown, **{'oiio:ColorSpace': 'ARRI LogC4'})
    check.refused('log.exr', 'ARRI LogC4 is not known here')


def depth(check):
    maps = check.folder / 'maps'
    maps.mkdir()
    source = frames(check, [RGB, RGB])
    distance = (1 + X + Y).astype(np.float32)
    digests = {}
    for kind, write in {
        'float': lambda p, d: np.save(p, d),
        'double': lambda p, d: np.save(p, d.astype(np.float64)[None, None]),
        'fortran': lambda p, d: np.save(p, np.asfortranarray(d)),
        'int16': lambda p, d: np.save(p, d.astype(np.int16)[..., None]),
        'int32': lambda p, d: np.save(p, d.astype(np.int32)),
        'tiff': lambda p, d: tifffile.imwrite(p.with_suffix('.tif'), d),
        'tiff16': lambda p, d: tifffile.imwrite(p.with_suffix('.tif'), d.astype(np.uint16)),
    }.items():
        for old in maps.iterdir():
            old.unlink()
        for index in range(2):
            write(maps / f'{index}.npy', distance)
        digests[kind] = check.read(source, '--depth', str(maps), '--depth-model', 'metric')[0]
    assert len(set(digests.values())) == 1, digests
    check.count += len(digests)


def main():
    with tempfile.TemporaryDirectory(prefix='streamsplat-images-') as folder:
        check = Checks(folder)
        for part in [tiff, png_and_webp, jpeg, exr, depth]:
            part(check)
        print(f'{check.count} files are read as they were written, or refused')


if __name__ == '__main__':
    main()
