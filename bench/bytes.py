"""Bytes of scenes: bytes.py CLIPS PROGRAM [PROGRAM…] [--only NAME…] [--locked NAME] [--quality balanced] [--page] [--json FILE]

CLIPS is a folder of clips, each a folder of images. Each program runs each clip and exports its scene as a container (`.ssz`). It then draws the scene's folder
and the container at the times of the source's frames, at the source's size. For each clip and program it prints the bytes of the container in total and
per frame, the first program's bytes divided into these, how many times smaller the container is than the folder's intervals, the PSNR of the container's
images from the folder's (the least of all frames) and of both from the source (means over frames). `--page` adds the bytes of the page of
`view --html`. It ends with the median ratio over clips. `--locked` measures instead of the clips one that is made from the first frame of this clip: 41 frames
with noise of deviation 1.5/255, before which a red rectangle of 5 % of the picture moves to the right.
"""

import argparse
import json
import statistics
import subprocess
import tempfile
from pathlib import Path

from delivered import db, errors, frames


def locked(clip, folder):
    """Writes the frames of a locked camera."""
    import numpy

    first = min(path for path in clip.iterdir() if path.suffix in ('.png', '.jpg'))
    ask = ['ffprobe', '-v', 'error', '-show_entries', 'stream=width,height', '-of', 'csv=p=0', first]
    width, height = map(int, subprocess.run(ask, capture_output=True, check=True, text=True).stdout.strip().split(','))
    data = subprocess.run(['ffmpeg', '-v', 'error', '-i', first, '-f', 'rawvideo', '-pix_fmt', 'rgb24', '-'], capture_output=True, check=True).stdout
    still = numpy.frombuffer(data, numpy.uint8).reshape(height, width, 3).astype(float)
    random = numpy.random.default_rng(1)
    video = b''
    for k in range(41):
        frame = still.copy()
        left = width // 12 + k * width // 80
        frame[height // 4 : height // 4 + height // 2, left : left + width // 10] = (200, 40, 40)
        frame += random.normal(0, 1.5, frame.shape)
        video += frame.round().clip(0, 255).astype(numpy.uint8).tobytes()
    given = ['-f', 'rawvideo', '-pix_fmt', 'rgb24', '-s', f'{width}x{height}', '-i', '-']
    subprocess.run(['ffmpeg', '-v', 'error', *given, f'{folder}/%04d.png'], input=video, check=True)


def measured(program, clip, quality, page):
    truth = frames(clip)
    with tempfile.TemporaryDirectory() as work:
        out, container = Path(work, 'out'), Path(work, 'scene.ssz')

        def call(*words):
            subprocess.run([program, *map(str, words), '--quiet'], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

        call('run', clip, '--quality', quality, '--out', out)
        call('export', out, '--format', 'ssz', '--out', container)
        drawn = {}
        for name, scene in (('folder', out / 'scene'), ('container', container)):
            call('render', scene, '--size', 'source', '--emit', 'rgb', '--out', Path(work, name))
            drawn[name] = frames(Path(work, name, 'frames'))
        count = len(list(Path(work, 'folder', 'frames').iterdir()))
        found = {name: statistics.mean(map(db, errors(images, truth, count))) for name, images in drawn.items()}
        found['apart'] = min(map(db, errors(drawn['container'], drawn['folder'], count)))
        found |= {'frames': count, 'bytes': container.stat().st_size}
        found['smaller'] = sum(file.stat().st_size for file in (out / 'scene').glob('interval-*')) / found['bytes']
        if page:
            call('view', out, '--html', Path(work, 'page.html'))
            found['page'] = Path(work, 'page.html').stat().st_size
        return found


def main():
    a = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    a.add_argument('clips', type=Path)
    a.add_argument('programs', nargs='+')
    a.add_argument('--only', nargs='+', help='names of clips, without those that are not named')
    a.add_argument('--locked', metavar='NAME', help='measure a locked camera, made from the first frame of this clip')
    a.add_argument('--quality', default='balanced')
    a.add_argument('--page', action='store_true')
    a.add_argument('--json', type=Path)
    options = a.parse_args()
    clips = sorted(path for path in options.clips.iterdir() if path.is_dir() and (not options.only or path.name in options.only))
    made = tempfile.TemporaryDirectory()
    if options.locked:
        clips = [Path(made.name, f'{options.locked}-locked')]
        clips[0].mkdir()
        locked(options.clips / options.locked, clips[0])
    results = {}
    print('clip | program | bytes | a frame | of the first | smaller than the folder | from the folder | folder, container from the source')
    for clip in clips:
        results[clip.name] = [measured(program, clip, options.quality, options.page) for program in options.programs]
        for k, r in enumerate(results[clip.name]):
            first = results[clip.name][0]
            ratio = f'{r["bytes"] / first["bytes"]:.3f}'
            line = f'{clip.name} | {k} | {r["bytes"]} | {r["bytes"] / r["frames"]:.0f} | {ratio} | {r["smaller"]:.1f} | {r["apart"]:.1f} dB | {r["folder"]:.2f}, {r["container"]:.2f} dB'
            print(line + (f' | page {r["page"]} ({r["page"] / first["page"]:.3f})' if options.page else ''), flush=True)
    for k in range(1, len(options.programs)):
        ratios = [clip[k]['bytes'] / clip[0]['bytes'] for clip in results.values()]
        print(f'program {k}: median of the first\'s bytes {statistics.median(ratios):.3f} ({min(ratios):.3f} to {max(ratios):.3f}) over {len(ratios)} clips')
    if options.json:
        options.json.write_text(json.dumps(results, indent=1) + '\n')


main()
