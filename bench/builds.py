"""Time of `run` in several builds: builds.py CLIPS PROGRAM [PROGRAM…] [--rounds 5] [--quality balanced] [--only NAME…] [--y4m] [--json FILE]

CLIPS is a folder of clips, each a folder of images. Clip by clip and round by round, each program runs `run CLIP --threads 2 --emit rgb --out FILE.y4m` in
turn, in the opposite order in every second round. With `--y4m` it reads the clip as YUV4MPEG2 of 4:2:0, which FFmpeg makes first. For each clip and program
are printed the medians of wall clock, processor time and peak memory, the median over rounds of the first program's wall clock divided by this one's, the
PSNR of its images (mean over frames and least of them, at the source's own size, from one more run, of the folder to PNG files), and the digest of the video.
It ends with the median of these ratios over clips. A program whose video differs from round to round is an error.
"""

import argparse
import concurrent.futures
import hashlib
import json
import multiprocessing
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from delivered import db, errors, frames


def run(program, clip, video, quality):
    """Wall clock and processor time in seconds, peak memory in MiB, the video's digest."""
    words = [program, 'run', clip, '--quality', quality, '--threads', '2', '--emit', 'rgb', '--out', video, '--quiet']
    start = time.monotonic()
    child = subprocess.Popen(list(map(str, words)), stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(child.pid, 0)
    wall = time.monotonic() - start
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        sys.exit(f'{program}: exit code {child.returncode}')
    digest = hashlib.sha256(video.read_bytes()).hexdigest()[:8]
    return {'wall': wall, 'cpu': used.ru_utime + used.ru_stime, 'memory': used.ru_maxrss / 1024}, digest


def as_y4m(clip, folder):
    """The clip as a file in this folder."""
    suffix = min(path.suffix for path in clip.iterdir() if path.suffix in ('.png', '.jpg'))
    video = Path(folder, f'{clip.name}.y4m')
    words = ['ffmpeg', '-v', 'error', '-framerate', '30', '-pattern_type', 'glob', '-i', f'{clip}/*{suffix}', '-pix_fmt', 'yuv420p', video]
    subprocess.run(words, check=True)
    return video


def psnr(program, clip, quality):
    """Mean over frames, and least, of the PSNR of the images that `program` draws."""
    truth = frames(clip)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, 'out')
        subprocess.run([program, 'run', clip, '--quality', quality, '--emit', 'rgb', '--size', 'source', '--out', out, '--quiet'], check=True)
        count = len(list((out / 'frames').iterdir()))
        all_frames = [db(error) for error in errors(frames(out / 'frames'), truth, count)]
        return statistics.mean(all_frames), min(all_frames)


def main():
    a = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    a.add_argument('clips', type=Path)
    a.add_argument('programs', nargs='+')
    a.add_argument('--rounds', type=int, default=5)
    a.add_argument('--quality', default='balanced')
    a.add_argument('--only', nargs='+', help='names of clips, without those that are not named')
    a.add_argument('--y4m', action='store_true', help='time the clips as YUV4MPEG2')
    a.add_argument('--json', type=Path)
    options = a.parse_args()
    made = tempfile.TemporaryDirectory()
    clips = sorted(path for path in options.clips.iterdir() if path.is_dir() and (not options.only or path.name in options.only))
    if options.only and len(clips) != len(set(options.only)):
        sys.exit(f'--only: expected names of clips in {options.clips}, found {" ".join(options.only)}')
    if not clips:
        sys.exit(f'{options.clips}: expected folders of images, found none')
    rows, first = [], options.programs[0]
    for clip in clips:
        source = as_y4m(clip, made.name) if options.y4m else clip
        taken, digests = {program: [] for program in options.programs}, {}
        for number in range(options.rounds):
            for program in options.programs[:: -1 if number % 2 else 1]:
                with tempfile.TemporaryDirectory() as folder:
                    found, digest = run(program, source, Path(folder, 'out.y4m'), options.quality)
                taken[program].append(found)
                if digests.setdefault(program, digest) != digest:
                    sys.exit(f'{program}, {clip.name}: expected the video {digests[program]}, found {digest}')
        for program in options.programs:
            ratios = [a['wall'] / b['wall'] for a, b in zip(taken[first], taken[program])]
            row = {key: statistics.median(one[key] for one in taken[program]) for key in ('wall', 'cpu', 'memory')}
            row |= {'clip': clip.name, 'program': program, 'ratio': statistics.median(ratios), 'ratios': ratios, 'video': digests[program]}
            # In a process of its own: a child's peak memory is at least what its parent has ever had.
            with concurrent.futures.ProcessPoolExecutor(1, multiprocessing.get_context('spawn')) as apart:
                row['psnr'], row['least'] = apart.submit(psnr, program, clip, options.quality).result()
            rows.append(row)
            spread = f'{min(ratios):.2f} to {max(ratios):.2f}'
            print(f'{clip.name:24} {row["wall"]:6.2f} s {row["cpu"]:6.2f} s {row["memory"]:5.0f} MiB {row["ratio"]:5.2f} ({spread}) '
                  f'{row["psnr"]:.2f} dB, least {row["least"]:.2f} {row["video"]} {program}', flush=True)
    medians = {}
    for program in options.programs:
        medians[program] = statistics.median(row['ratio'] for row in rows if row['program'] == program)
        print(f'{medians[program]:.3f} times as fast: {program}')
    if options.json:
        versions = {p: subprocess.run([p, '--version'], check=True, capture_output=True, text=True).stdout.strip() for p in options.programs}
        record = {'quality': options.quality, 'y4m': options.y4m, 'rounds': options.rounds, 'programs': versions, 'median': medians, 'rows': rows}
        options.json.write_text(json.dumps(record, indent=1) + '\n')


if __name__ == '__main__':
    main()
