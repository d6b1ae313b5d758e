"""Accuracy of tracks: tracks.py PROGRAM [PROGRAM…] [--scenes 4] [--frames 25] [--textures FOLDER] [--static] [-- OPTION…]

Draws scenes whose motion is known: a background under a camera that pans and zooms, and a textured body that moves by itself before it. Textures are smooth
noise, or pictures of FOLDER. Each program runs `run SCENE --emit tracks` with the options after `--`. Each identity is followed from its first time to its last,
and compared with the true path of the surface where it started. Printed are, for the background and the body: identities, their mean length in frames, the
median and the 90th percentile of the distance at the end in pixels, and the share that ends more than 1 pixel away. Points less opaque than 0.1 are left out,
and starts within 4 pixels of the body's edge.
"""

import argparse
import csv
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

WIDTH, HEIGHT, RATE = 512, 288, 24
EDGE = 4.0


def noise(random, width, height):
    """Colours of smooth noise over several octaves."""
    total = np.zeros((height, width, 3))
    for octave in range(2, 7):
        cells = 2**octave
        field = random.random((cells, cells * width // height + 1, 3)).astype(np.float32)
        planes = [np.asarray(Image.fromarray(field[..., c]).resize((width, height), Image.BICUBIC)) for c in range(3)]
        total += np.stack(planes, -1) * 0.75**octave
    return (total - total.min()) / (total.max() - total.min())


def texture(random, pictures, width, height):
    if not pictures:
        return noise(random, width, height)
    picture = Image.open(pictures[random.integers(len(pictures))]).convert('RGB')
    return np.asarray(picture.resize((width, height), Image.LANCZOS)) / 255.0


def sample(image, x, y):
    """Bilinear samples; pixels have their middles at whole numbers."""
    x, y = np.clip(x, 0, image.shape[1] - 1.001), np.clip(y, 0, image.shape[0] - 1.001)
    i, j = x.astype(int), y.astype(int)
    u, v = (x - i)[..., None], (y - j)[..., None]
    top, bottom = image[j, i] * (1 - u) + image[j, i + 1] * u, image[j + 1, i] * (1 - u) + image[j + 1, i + 1] * u
    return top * (1 - v) + bottom * v


class Scene:
    """Places of background and body: at frame t, the surface's point p is at scale(t)·p + shift(t)."""

    def __init__(self, seed, pictures, static):
        random = np.random.default_rng(seed)
        self.behind = texture(random, pictures, 2 * WIDTH, 2 * HEIGHT)
        self.before = texture(random, pictures, WIDTH, HEIGHT)
        self.pan = random.uniform(-2.5, 2.5, 2) * [1, 0.5]
        self.zoom = random.uniform(-0.003, 0.003)
        if static:
            self.pan, self.zoom = np.zeros(2), 0.0
        self.start, self.speed = random.uniform([180, 110], [330, 180]), random.uniform(-4, 4, 2) * [1, 0.4]
        self.radius, self.sway = random.uniform([35, 30], [70, 60]), random.uniform(2, 8)

    def path(self, body, t):
        if body:
            return 1.0, self.speed * t + np.array([0, self.sway * np.sin(t / 4)])
        return 1.0 + self.zoom * t, self.pan * t

    def move(self, body, points, start, end):
        """Where points that are seen at `points` in frame `start` are in frame `end`."""
        (s0, d0), (s1, d1) = self.path(body, start), self.path(body, end)
        return s1 * (points - d0) / s0 + d1

    def within(self, points, t):
        """Distance to the body's edge in pixels, about; positive inside."""
        at = (self.move(True, points, t, 0) - self.start) / self.radius
        return (1 - np.hypot(at[..., 0], at[..., 1])) * self.radius.min()

    def frame(self, t):
        y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
        points = np.stack([x, y], -1)
        behind = self.move(False, points, t, 0)
        image = sample(self.behind, behind[..., 0] + WIDTH / 2, behind[..., 1] + HEIGHT / 2)
        body = self.move(True, points, t, 0)
        cover = np.clip(self.within(points, t) + 0.5, 0, 1)[..., None]
        return image * (1 - cover) + cover * sample(self.before, body[..., 0], body[..., 1])


def tracks(folder):
    """Times in frames and places of each identity, over all intervals."""
    found = {}
    for file in sorted(folder.glob('*.csv')):
        for row in csv.DictReader(file.open()):
            if float(row['opacity']) >= 0.1:
                found.setdefault(int(row['identity']), {})[round(float(row['time']) * RATE, 3)] = (float(row['x']), float(row['y']))
    return found


def main():
    words, options = sys.argv[1:], []
    if '--' in words:
        at = words.index('--')
        words, options = words[:at], words[at + 1 :]
    a = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    a.add_argument('programs', nargs='+')
    a.add_argument('--scenes', type=int, default=4)
    a.add_argument('--frames', type=int, default=25)
    a.add_argument('--textures', type=Path)
    a.add_argument('--static', action='store_true', help='the camera does not move')
    args = a.parse_args(words)
    pictures = sorted(path for path in args.textures.rglob('*') if path.suffix in ('.jpg', '.png')) if args.textures else []
    results = {program: {True: [], False: []} for program in args.programs}
    for seed in range(args.scenes):
        scene = Scene(seed, pictures, args.static)
        with tempfile.TemporaryDirectory() as folder:
            clip = Path(folder, 'clip')
            clip.mkdir()
            for t in range(args.frames):
                Image.fromarray((scene.frame(t) * 255 + 0.5).astype(np.uint8)).save(clip / f'{t:03}.png')
            for index, program in enumerate(args.programs):
                out = Path(folder, f'out{index}')
                command = [program, 'run', clip, '--fps', str(RATE), '--emit', 'tracks', '--out', out, '--quiet', *options]
                subprocess.run(command, check=True)
                for path in tracks(out / 'tracks').values():
                    start, end = min(path), max(path)
                    first, last = np.array(path[start]), np.array(path[end])
                    inside = scene.within(first, start)
                    if start == end or abs(inside) < EDGE or not (0 <= first[0] < WIDTH and 0 <= first[1] < HEIGHT):
                        continue
                    true = scene.move(inside > 0, first, start, end)
                    results[program][bool(inside > 0)].append((end - start, np.hypot(*(last - true))))
    for program, parts in results.items():
        for body, name in ((False, 'background'), (True, 'body')):
            if not parts[body]:
                sys.exit(f'{program}: no identity starts on the {name} and lives longer than one time')
            length, error = np.array(parts[body]).T
            print(f'{name:11} {len(error):8} identities of {length.mean():5.2f} frames, at the end {np.median(error):.3f} px, 90 % {np.percentile(error, 90):.3f} px, '
                  f'{100 * (error > 1).mean():.2f} % over 1 px  {program}')


if __name__ == '__main__':
    main()
