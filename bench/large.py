"""Time from a large PLY file to its first picture: large.py PROGRAM [PROGRAM…].

Writes a seeded scene of 5,000,000 Gaussians with harmonics of degree 3 (`streamsplat-fixtures trained`, 1.24 GB, removed at the end). Each program draws it in
turn, round after round, with the file in the system's cache. The table has the median, the least and the largest of wall time, of processor time and of peak
memory. With several programs each is compared with the first: the median of the rounds' ratios, and equality of the pictures.

Options: --gaussians N, --scene FILE (an existing file of that many Gaussians), --rounds N, --size WxH, --threads N, --folder DIR (for written files), --json
FILE.
"""
import argparse
import hashlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MEASURES = {'wall': 's', 'cpu': 's', 'memory': 'GiB'}


def drawn(program, scene, picture, options):
    """One picture: wall and processor time in seconds, peak memory in GiB."""
    words = [program, 'render', scene, '--size', options.size, '--quiet', '-o', picture]
    words += ['--threads', options.threads] if options.threads else []
    start = time.perf_counter()
    child = subprocess.Popen(list(map(str, words)), stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(child.pid, 0)
    wall = time.perf_counter() - start
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode != 0:
        sys.exit(f'{program}: exit code {child.returncode}')
    return {'wall': wall, 'cpu': used.ru_utime + used.ru_stime, 'memory': used.ru_maxrss / 2 ** 20}


def version(program):
    return subprocess.run([program, '--version'], check=True, capture_output=True, text=True).stdout.strip()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('programs', nargs='+', metavar='PROGRAM')
    parser.add_argument('--gaussians', type=int, default=5_000_000)
    parser.add_argument('--scene', type=Path)
    parser.add_argument('--rounds', type=int, default=5)
    parser.add_argument('--size', default='640x360')
    parser.add_argument('--threads')
    parser.add_argument('--folder')
    parser.add_argument('--json')
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix='streamsplat-large-', dir=options.folder) as folder:
        scene, picture = options.scene or Path(folder) / 'large.ply', Path(folder) / 'first.png'
        if not options.scene:
            make = ['cargo', 'run', '--release', '--quiet', '--locked', '-p', 'streamsplat-fixtures', '--', 'trained', str(options.gaussians), str(scene)]
            subprocess.run(make, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        found, pictures = {program: [] for program in options.programs}, {}
        for turn in range(options.rounds + 1):
            for program in options.programs:
                picture.unlink(missing_ok=True)
                measured = drawn(program, scene, picture, options)
                pictures[program] = hashlib.sha256(picture.read_bytes()).hexdigest()
                # The first round reads the file into the cache.
                if turn:
                    found[program].append(measured)
    for program, rounds in found.items():
        print(program)
        for measure, unit in MEASURES.items():
            values = [each[measure] for each in rounds]
            print(f'  {measure:7}{statistics.median(values):8.3f} {unit:4}({min(values):.3f} to {max(values):.3f})')
    first, *others = options.programs
    for program in others:
        ratios = [statistics.median(b[measure] / a[measure] for a, b in zip(found[first], found[program])) for measure in MEASURES]
        same = 'the same picture' if pictures[first] == pictures[program] else 'another picture'
        print(f'{program} / {first}: ' + ', '.join(f'{measure} {ratio:.3f}' for measure, ratio in zip(MEASURES, ratios)) + f'; {same}')
    if options.json:
        rows = [{'program': version(program), **{measure: [each[measure] for each in rounds] for measure in MEASURES}} for program, rounds in found.items()]
        Path(options.json).write_text(json.dumps({'gaussians': options.gaussians, 'size': options.size, 'programs': rows}, indent=1) + '\n')


if __name__ == '__main__':
    main()
