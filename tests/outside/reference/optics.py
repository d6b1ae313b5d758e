"""Checks of tests/outside/reference/run in addition to check.py: optics.py PROGRAM.

Footprints that end, lenses with a width, panoramas and shutters, drawn by this program, compared with plain formulas in float64 that share no code with it:

- two grids of 400 and 48,400 Gaussians, as in @playcanvas/splat-transform's golden pictures, by the formulas of its shaders (3.7.0): the pinhole's Jacobian
clamped at 1.3 times the field, α = min(0.99, o·(e^(−d²/2) − e^(−9/2))) within a square of 3σ of the longer axis, from 1/255 on, until T is under 10⁻⁴;
- the golden pictures of both in splat-transform's own tests (fixtures/splat-transform): no 8-bit sample differs by more than 1;
- the same with PlayCanvas's engine's falloff, o·(e^(−d²/2) − e^(−4)) / (1 − e^(−4));
- depth of field by covariances widened by the disc of a thin lens;
- a panorama with Gaussians on both poles, on the seam and around the eye, by rays through every pixel: each Gaussian as in a pinhole that looks at it;
- the same panorama by the affine approximation in longitude and latitude that splat-transform has, away from the poles;
- a shutter as the mean of images in linear light.
"""
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import OpenEXR

PROGRAM = sys.argv[1]
ROOT = Path(__file__).resolve().parents[3]
NAMES = ['x', 'y', 'z', 'f_dc_0', 'f_dc_1', 'f_dc_2', 'opacity', 'scale_0', 'scale_1', 'scale_2', 'rot_0', 'rot_1', 'rot_2', 'rot_3']
C0 = 0.28209479177387814
LEAST = 1 / 255


def as_file(**scene):
    """The values as stored in a file."""
    return {name: np.asarray(values, np.float32).astype(float) for name, values in scene.items()}


def write_ply(path, scene):
    header = f'ply\nformat binary_little_endian 1.0\nelement vertex {len(scene["mean"])}\n'
    header += ''.join(f'property float {name}\n' for name in NAMES) + 'end_header\n'
    columns = [scene['mean'], scene['base'], scene['logit'][:, None], scene['log_scale'], scene['rotation']]
    path.write_bytes(header.encode() + np.concatenate(columns, 1).astype('<f4').tobytes())


def grid(side, spacing, scale):
    """A grid in the plane y = 0, coloured by place, each Gaussian round and of an opacity of 0.9."""
    z, x = np.divmod(np.arange(side * side), side)
    colour = np.stack([(x + 1) / (side + 1), (z + 1) / (side + 1), np.full(len(x), 0.5)], -1)
    count = len(x)
    return as_file(mean=np.stack([(x - side / 2) * spacing, 0 * x, (z - side / 2) * spacing], -1), base=(colour - 0.5) / C0,
                   logit=np.full(count, np.log(9.0)), log_scale=np.full((count, 3), np.log(scale)), rotation=np.tile([1.0, 0, 0, 0], (count, 1)))


def look_at(position, target, up):
    """Camera to world: right, down and forward."""
    position, target = np.array(position, float), np.array(target, float)
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.stack([right, np.cross(forward, right), forward], 1), position
    return pose


def draw(folder, scene, camera, *options, suffix='exr'):
    write_ply(folder / 'scene.ply', scene)
    (folder / 'camera.json').write_text(json.dumps(camera['file']))
    out = folder / f'image.{suffix}'
    words = [PROGRAM, 'render', folder / 'scene.ply', '--camera', folder / 'camera.json', '--size', f'{camera["width"]}x{camera["height"]}',
             '--background', '0', '--quiet', '-o', out, *options]
    done = subprocess.run(list(map(str, words)), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return read(out) if suffix == 'exr' else None


def read(path):
    with OpenEXR.File(str(path), separate_channels=True) as file:
        colour = {part.header['name']: part for part in file.parts}['colour'].channels
        return np.stack([colour[c].pixels for c in 'RGB'], -1).astype(float)


def pinhole(pose, width, height, field):
    focal = 0.5 * height / np.tan(np.radians(field) / 2)
    file = {'type': 'pinhole', 'camera_to_world': pose.tolist(), 'fov_y_degrees': field, 'aspect': width / height}
    return dict(width=width, height=height, focal=focal, pose=pose, file=file)


def activated(scene, pose):
    """Centres and covariances in view space, colours, opacities."""
    q = scene['rotation'] / np.linalg.norm(scene['rotation'], axis=1, keepdims=True)
    w, x, y, z = q.T
    turn = np.stack([np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
                     np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
                     np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1)], 1)
    half = pose[:3, :3].T @ turn * np.exp(scene['log_scale'])[:, None, :]
    mean = (scene['mean'] - pose[:3, 3]) @ pose[:3, :3]
    return mean, half @ half.transpose(0, 2, 1), np.maximum(scene['base'] * C0 + 0.5, 0), 1 / (1 + np.exp(-scene['logit']))


def splat_transform(scene, camera, falloff, aperture=0.0, focus=1.0, least=LEAST):
    width, height, focal = camera['width'], camera['height'], camera['focal']
    mean, covariance, colour, opacity = activated(scene, camera['pose'])
    image, left = np.zeros((height, width, 3)), np.ones((height, width))
    limit = 1.3 * 0.5 * np.array([width, height]) / focal
    for i in np.argsort(mean[:, 2].astype(np.float32), kind='stable'):
        x, y, z = mean[i]
        if z <= 0.2:
            continue
        tx, ty = np.clip([x / z, y / z], -limit, limit)
        j = focal / z * np.array([[1, 0, -tx], [0, 1, -ty]])
        flat = j @ covariance[i] @ j.T + 0.3 * np.eye(2)
        o, own = opacity[i], np.linalg.det(flat)
        # The disc of a thin lens has a variance of a quarter of its radius squared.
        flat += np.eye(2) * (0.5 * aperture * focal * (1 / z - 1 / focus)) ** 2 / 4
        o *= np.sqrt(own / np.linalg.det(flat))
        reach = np.ceil((6.0 if aperture else 3.0) * np.sqrt(np.linalg.eigvalsh(flat)[-1]))
        u, v = focal * x / z + width / 2, focal * y / z + height / 2
        columns = np.arange(max(0, int(u - reach - 1)), min(width, int(u + reach + 2)))
        rows = np.arange(max(0, int(v - reach - 1)), min(height, int(v + reach + 2)))
        if not len(columns) or not len(rows):
            continue
        dx, dy = (columns + 0.5 - u)[None], (rows + 0.5 - v)[:, None]
        inverse = np.linalg.inv(flat)
        power = -0.5 * (inverse[0, 0] * dx * dx + 2 * inverse[0, 1] * dx * dy + inverse[1, 1] * dy * dy)
        alpha = np.minimum(0.99, o * falloff(power))
        part = np.ix_(rows, columns)
        alpha = np.where((alpha >= least) & (left[part] >= 1e-4) & (abs(dx) <= reach) & (abs(dy) <= reach), alpha, 0)
        image[part] += (alpha * left[part])[..., None] * colour[i]
        left[part] *= 1 - alpha
    return image


def directions(width, height):
    longitude = ((np.arange(width) + 0.5) / width - 0.5) * 2 * np.pi
    latitude = ((np.arange(height) + 0.5) / height - 0.5) * np.pi
    level = np.cos(latitude)[:, None]
    return np.stack([level * np.sin(longitude), np.broadcast_to(np.sin(latitude)[:, None], (height, width)), level * np.cos(longitude)], -1)


def panorama(scene, camera, affine=False):
    width, height = camera['width'], camera['height']
    mean, covariance, colour, opacity = activated(scene, camera['pose'])
    rays = directions(width, height)
    image, left = np.zeros((height, width, 3)), np.ones((height, width))
    distance = np.linalg.norm(mean, axis=1)
    for i in np.argsort(distance.astype(np.float32), kind='stable'):
        if distance[i] <= 1e-6:
            continue
        n = mean[i] / distance[i]
        level = np.hypot(n[0], n[2])
        east = np.array([n[2], 0, -n[0]]) / level if level else np.array([1.0, 0, 0])
        south = np.cross(east, n) if np.dot(np.cross(east, n), [0, 1, 0]) >= 0 else -np.cross(east, n)
        if affine:
            # Pixels of longitude and latitude.
            floor = max(level, 0.005)
            j = np.stack([width / (2 * np.pi) * east / (distance[i] * floor), height / np.pi * south / distance[i]])
            flat = j @ covariance[i] @ j.T + 0.3 * np.eye(2)
            u, v = (np.arctan2(n[0], n[2]) / (2 * np.pi) + 0.5) * width, (np.arcsin(n[1]) / np.pi + 0.5) * height
            dx = np.broadcast_to((np.arange(width) + 0.5 - u + width / 2) % width - width / 2, (height, width))
            dy = np.broadcast_to((np.arange(height) + 0.5 - v)[:, None], (height, width))
            seen = True
        else:
            k = height / np.pi
            j = k / distance[i] * np.stack([east, south])
            flat = j @ covariance[i] @ j.T + np.diag([0.3 * (max(level, 1 / 16) * 2 * height / width) ** 2, 0.3])
            ahead = rays @ n
            seen = ahead > 0
            ahead = np.where(seen, ahead, 1)
            dx, dy = k * (rays @ east) / ahead, k * (rays @ south) / ahead
        inverse = np.linalg.inv(flat)
        power = -0.5 * (inverse[0, 0] * dx * dx + 2 * inverse[0, 1] * dx * dy + inverse[1, 1] * dy * dy)
        alpha = np.minimum(0.99, opacity[i] * np.exp(power))
        alpha = np.where(seen & (alpha >= LEAST) & (left * (1 - alpha) >= 1e-4), alpha, 0)
        image += (alpha * left)[..., None] * colour[i]
        left *= 1 - alpha
    return image


def all_around(count):
    random = np.random.default_rng(41)
    mean = random.normal(0, 2, (count, 3))
    mean[::9, [0, 2]] *= 0.02
    mean[1::9, 0] *= 0.01
    mean[1::9, 2] = -abs(mean[1::9, 2])
    mean[2::9] *= 0.1
    return as_file(mean=mean, base=random.uniform(-1.5, 1.5, (count, 3)), logit=random.normal(0, 2, count),
                   log_scale=random.uniform(-5, -1, (count, 3)), rotation=random.normal(size=(count, 4)))


def linear(c):
    c = np.maximum(c, 0)
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def display(c):
    return np.where(c <= 0.0031308, c * 12.92, 1.055 * np.maximum(c, 1e-30) ** (1 / 2.4) - 0.055)


def shutter(folder):
    """The mean of four images, and the program's result."""
    scene = all_around(300)
    write_ply(folder / 'scene.ply', scene)
    view = lambda time, x: {'time': time, 'type': 'pinhole', 'position': [x, 0, -6], 'look_at': [0, 0, 0], 'fov_y_degrees': 50, 'aspect': 1.5}
    (folder / 'camera.json').write_text(json.dumps({'views': [view(0, -2), view(1, 2)]}))
    words = [PROGRAM, 'render', folder / 'scene.ply', '--camera', folder / 'camera.json', '--size', '90x60', '--background', '0.2', '--quiet',
             '--fps', '2', '--emit', 'exr']
    times = [0.5 + 0.5 * 0.5 * ((i + 0.5) / 4 - 0.5) for i in range(4)]
    for out, more in (('each', ['--times', ','.join(map(repr, times))]), ('open', ['--times', '0.5', '--shutter', '180', '--shutter-samples', '4'])):
        done = subprocess.run(list(map(str, [*words, '-o', folder / out, *more])), capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    each = [read(folder / f'each/exr/{i:06}.exr') for i in range(4)]
    assert abs(each[0] - each[3]).max() > 0.1
    return display(np.mean([linear(image) for image in each], 0)), read(folder / 'open/exr/000000.exr')


def cases(folder):
    """Name, least PSNR, largest difference of 255, expected and found picture."""
    three = lambda power: np.where(power > -4.5, np.exp(power) - np.exp(-4.5), 0)
    engine = lambda power: np.where(power > -4, (np.exp(power) - np.exp(-4)) / (1 - np.exp(-4)), 0)
    whole = lambda power: np.exp(power)
    grids = [('400', grid(20, 1.0, 0.1), pinhole(look_at([0, 5, -8], [0, 0, 0], [0, 1, 0]), 320, 240, 60)),
             ('48,400', grid(220, 0.3, 0.05), pinhole(look_at([0, 10, -15], [0, 0, 0], [0, 1, 0]), 640, 360, 60))]
    for name, scene, camera in grids:
        yield f'{name} splats, splat-transform', 70, 1.5, splat_transform(scene, camera, three), draw(folder, scene, camera, '--footprint', 'splat-transform')
    _, scene, camera = grids[0]
    yield '400 splats, PlayCanvas', 70, 1.5, splat_transform(scene, camera, engine), draw(folder, scene, camera, '--footprint', 'playcanvas')
    # In focus: the plane through the camera's target; a pupil of 0.2.
    focus, focal = np.sqrt(89.0), 0.5 / np.tan(np.radians(30))
    lens = ['--f-stop', 2.0, '--sensor-height', 0.4 / focal, '--focus', repr(float(focus))]
    yield '400 splats, a lens', 70, 1.5, splat_transform(scene, camera, whole, 0.2, focus, 2 ** -16), draw(folder, scene, camera, *lens)

    scene = all_around(500)
    pose = look_at([0.1, -0.2, 0.3], [1.0, 0.3, -0.4], [0.2, -1, 0.1])
    around = dict(width=256, height=128, pose=pose, file={'type': 'equirectangular', 'camera_to_world': pose.tolist()})
    found = draw(folder, scene, around)
    yield '500 splats all around', 60, 3, panorama(scene, around), found
    small = {**all_around(500)}
    small['log_scale'] = small['log_scale'] - 2
    near = slice(52, 76)
    level = draw(folder, small, around)[near]
    yield 'near the equator, affine in longitude and latitude', 38, 40, panorama(small, around, affine=True)[near], level
    yield 'a shutter', 90, 0.1, *shutter(folder)


def golden(folder):
    """Compares splat-transform's own pictures of both grids with ours; returns whether they agree, and a line."""
    cameras = [('400', grid(20, 1.0, 0.1), [0, 5, -8], 320, 240), ('48400', grid(220, 0.3, 0.05), [0, 10, -15], 640, 360)]
    for name, scene, position, width, height in cameras:
        for footprint in ('splat-transform', 'gaussian'):
            draw(folder, scene, pinhole(look_at(position, [0, 0, 0], [0, 1, 0]), width, height, 60), '--footprint', footprint, suffix='png')
            theirs = ROOT / f'fixtures/splat-transform/{name}.webp'
            done = subprocess.run([PROGRAM, 'compare', str(theirs), str(folder / 'image.png'), '--json'], capture_output=True, text=True)
            picture = json.loads(done.stdout)['pictures'][0]
            # Only the rounding to 8 bits; without the option they differ by several steps.
            passed = picture['largest'] < 1.01 if footprint == 'splat-transform' else picture['largest'] > 5
            yield passed, f'golden picture of {name} splats, --footprint {footprint}: {picture["psnr"]:.1f} dB, largest difference {picture["largest"]:.0f}/255'


def main():
    failed = False
    with tempfile.TemporaryDirectory(prefix='streamsplat-golden-') as folder:
        for passed, line in golden(Path(folder)):
            failed |= not passed
            print(line + ('' if passed else '   FAILED'))
    with tempfile.TemporaryDirectory(prefix='streamsplat-optics-') as folder:
        for name, least, most, expected, found in cases(Path(folder)):
            assert expected.std() > 0.01, f'{name}: the image is flat'
            apart = np.abs(found - expected)
            psnr = -10 * np.log10(max(np.mean(apart ** 2), 1e-30))
            largest = 255 * apart.max()
            passed = psnr >= least and largest <= most
            failed |= not passed
            print(f'{name:52} {psnr:6.1f} dB, largest difference {largest:.4f}/255'
                  + ('' if passed else f'   FAILED: expected at least {least} dB and at most {most}/255'))
    sys.exit(failed)


if __name__ == '__main__':
    main()
