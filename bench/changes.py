"""What resolution, motion and colours cost and give: error against run time, one change after the other, on a folder of clips.

`python3 bench/changes.py CLIPS [--gap 5] [--threads 2]` builds the release program, runs `streamsplat eval` once per row and writes
bench/record/changes-DATE-CPU.{json,md}. PSNR is at 256×256, a mean over frames; time is what the engine takes per input frame
(drawing and comparison apart). Rows that are given the frames between key frames are marked `seen`: they answer another question than the others.
"""
import argparse
import datetime
import json
import re
import subprocess
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAPER = ['--resolution', 'native', '--motion', 'network', '--refine', '0']
ROWS = [
    ("the paper's way: one pass at the model's own size, the network's motion and colours", PAPER),
    ('+ resolution: four times the area, in tiles', ['--motion', 'network', '--refine', '0']),
    ('+ motion: optical flow between the key frames', ['--motion', 'frames', '--refine', '0']),
    ('+ colours: 4 steps', ['--motion', 'frames', '--refine', '4']),
    ('+ colours: 16 steps at most (the default)', ['--motion', 'frames']),
    ('seen, motion through the frames between, no colours', ['--seen', '--refine', '0']),
    ('seen, + colours: 4 steps', ['--seen', '--refine', '4']),
    ('seen, + colours: 16 steps at most (the default)', ['--seen']),
]


def cpu():
    names = re.findall(r'^model name\s*:\s*(.*)$', Path('/proc/cpuinfo').read_text(), re.M)
    return names[0] if names else 'unknown'


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('clips', type=Path)
    parser.add_argument('--gap', default='5')
    parser.add_argument('--threads', default='2')
    parser.add_argument('--out', type=Path, default=ROOT / 'bench' / 'record')
    options = parser.parse_args()
    subprocess.run(['cargo', 'build', '--release', '--locked', '--quiet'], cwd=ROOT, check=True)
    rows = []
    for name, arguments in ROWS:
        with tempfile.TemporaryDirectory() as folder:
            figures = Path(folder) / 'eval.json'
            subprocess.run([ROOT / 'target' / 'release' / 'streamsplat', 'eval', options.clips, '--quiet', '--gap', options.gap,
                            '--threads', options.threads, '--json', figures, *arguments], check=True)
            mean = json.loads(figures.read_text())['mean']
        rows.append({'row': name, 'arguments': arguments, 'key': mean['key']['psnr'], 'between': mean['middle']['psnr'],
                     'moving': mean['moving']['over_crossfade'], 'still': mean['still']['over_crossfade'],
                     'seconds_per_frame': mean['seconds_per_frame']})
        print(f"{name}: {rows[-1]['key']:.2f} {rows[-1]['between']:.2f} {1000 * rows[-1]['seconds_per_frame']:.0f} ms", flush=True)
        baselines = {name: score['psnr'] for name, score in mean['baselines'].items()}
    date, machine = datetime.date.today().isoformat(), cpu()
    record = {'date': date, 'cpu': machine, 'threads': int(options.threads), 'gap': options.gap,
              'clips': len(list(options.clips.iterdir())), 'baselines': baselines, 'rows': rows}
    name = f"changes-gap-{options.gap.replace(':', '-')}-{date}-{re.sub('[^a-z0-9]+', '-', machine.lower()).strip('-')}"
    (options.out / f'{name}.json').write_text(json.dumps(record, indent=1) + '\n')
    signed = lambda value: '–' if value is None else f'{value:+.2f}'
    lines = [f"{record['clips']} clips, gap {options.gap}, {options.threads} threads of {machine}, {date}. Beside these, between key frames: "
             f"cross-fade {baselines['crossfade']:.2f} dB, flow's blend {baselines['flow']:.2f} dB.", '',
             '| | key frames, dB | between, dB | moving clips over the cross-fade | still ones | ms per input frame |', '|---|---:|---:|---:|---:|---:|']
    lines += [f"| {row['row']} | {row['key']:.2f} | {row['between']:.2f} | {signed(row['moving'])} | {signed(row['still'])} "
              f"| {1000 * row['seconds_per_frame']:.0f} |" for row in rows]
    (options.out / f'{name}.md').write_text('\n'.join(lines) + '\n')
    print(options.out / f'{name}.md')


if __name__ == '__main__':
    main()
