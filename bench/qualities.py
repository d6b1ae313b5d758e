"""Frames per second and PSNR of the qualities: qualities.py PROGRAM CLIPS [--rounds 3] [--frames N] [--json FILE]

CLIPS is a folder of clips, each a folder of images. Every clip becomes a y4m file first. Then, clip by clip and round by round, `run CLIP.y4m --threads 2
--emit rgb` takes it to a y4m file at each quality in turn. A clip's time is the median over rounds of the wall clock of the whole program. PSNR is the mean
over all frames, at the source's own size, between the 8-bit samples of the images (written as PNG by one more run) and of the frames. The output has the
median, least and most frames per second over clips, and the mean PSNR over clips.
"""

import argparse
import json
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

from delivered import db, errors, frames

QUALITIES = ['realtime', 'balanced', 'best']


def main():
    a = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    a.add_argument('program')
    a.add_argument('clips', type=Path)
    a.add_argument('--rounds', type=int, default=3)
    a.add_argument('--frames', type=int, default=1000)
    a.add_argument('--only', help='names of clips, separated by commas')
    a.add_argument('--json', type=Path)
    options = a.parse_args()
    rows = []
    clips = sorted(path for path in options.clips.iterdir() if path.is_dir())
    if options.only:
        clips = [clip for clip in clips if clip.name in options.only.split(',')]
    for clip in clips:
        with tempfile.TemporaryDirectory() as work:
            work = Path(work)
            images = [image for image in sorted(clip.iterdir()) if image.suffix in ('.png', '.jpg')][: options.frames]
            source = work / 'clip.y4m'
            pattern = str(clip / f'*{images[0].suffix}')
            subprocess.run(['ffmpeg', '-nostdin', '-v', 'error', '-framerate', '24', '-pattern_type', 'glob', '-i', pattern, '-frames:v', str(len(images)),
                            '-pix_fmt', 'yuv444p', '-strict', '-1', str(source)], check=True)
            truth = frames(source)
            for quality in QUALITIES:
                seconds = []
                run = [options.program, 'run', source, '--quality', quality, '--threads', '2', '--emit', 'rgb', '--quiet']
                for number in range(options.rounds):
                    start = time.perf_counter()
                    subprocess.run([*run, '--out', work / f'{quality}-{number}.y4m'], check=True)
                    seconds.append(time.perf_counter() - start)
                out = work / quality
                subprocess.run([*run, '--size', 'source', '--out', out], check=True)
                error = errors(frames(out / 'frames'), truth, len(images))
                psnr = statistics.mean(db(each) for each in error)
                rows.append({'clip': clip.name, 'quality': quality, 'frames': len(images), 'seconds': seconds, 'psnr': psnr})
                print(f'{clip.name} {quality}: {len(images) / statistics.median(seconds):.1f} frames a second, {psnr:.2f} dB', flush=True)
    for quality in QUALITIES:
        own = [row for row in rows if row['quality'] == quality]
        rates = [row['frames'] / statistics.median(row['seconds']) for row in own]
        print(f'{quality}: {statistics.median(rates):.1f} frames a second ({min(rates):.1f} to {max(rates):.1f}), '
              f'{statistics.mean(row["psnr"] for row in own):.1f} dB, {len(own)} clips')
    if options.json:
        cpu = next(line.split(':', 1)[1].strip() for line in open('/proc/cpuinfo') if line.startswith('model name'))
        version = subprocess.run([options.program, '--version'], stdout=subprocess.PIPE, text=True, check=True).stdout.strip()
        options.json.write_text(json.dumps({'cpu': cpu, 'program': version, 'rounds': options.rounds, 'rows': rows}, indent=1) + '\n')


if __name__ == '__main__':
    main()
