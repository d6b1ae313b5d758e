"""What resolution, motion, fading and colours cost and give: error against run time, one change after the other, on a folder of clips.

`python3 bench/changes.py CLIPS [--gap 5] [--threads 2]` builds the release program, runs `streamsplat eval` once per row, writes
bench/record/changes-DATE-CPU.json and puts its table into docs/choosing.md. `python3 bench/changes.py --table RECORD` makes the page's table from a record. PSNR is at 256×256, a mean over frames; time is what the engine takes per input frame
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
    ('+ motion: optical flow between the key frames', ['--motion', 'frames', '--refine', '0', '--fade', 'network']),
    ('+ fading: all alike, nothing of the dynamic half is computed', ['--motion', 'frames', '--refine', '0']),
    ('+ colours: 4 steps', ['--motion', 'frames', '--refine', '4']),
    ('+ colours: 16 steps at most', ['--motion', 'frames']),
    ('seen, motion through the frames between, no colours', ['--seen', '--refine', '0']),
    ('seen, + colours: 4 steps', ['--seen', '--refine', '4']),
    ('seen, + colours: 16 steps at most', ['--seen']),
    ('seen, `--quality realtime`: gap 8', ['--seen', '--quality', 'realtime']),
    ('seen, `--quality balanced`: gap 5, the default', ['--seen', '--quality', 'balanced']),
    ('seen, `--quality best`: gap 3', ['--seen', '--quality', 'best']),
]
# The page that shows the table, between these lines.
PAGE = ROOT / 'docs' / 'choosing.md'
BEGIN, END = '<!-- bench/changes.py writes from here -->', '<!-- to here -->'


def cpu():
    names = re.findall(r'^model name\s*:\s*(.*)$', Path('/proc/cpuinfo').read_text(), re.M)
    return names[0] if names else 'unknown'


def table(record):
    """The lines of the page."""
    baselines = record['baselines']
    signed = lambda value: '–' if value is None else f'{value:+.2f}'
    lines = [f"{record['clips']} clips, gap {record['gap']} where nothing else is said, {record['threads']} threads of {record['cpu']}, {record['date']}. "
             f"Beside these, between key frames: cross-fade {baselines['crossfade']:.2f} dB, flow's blend {baselines['flow']:.2f} dB.", '',
             '| | key frames, dB | between, dB | all, dB | moving clips over the cross-fade | still ones | ms per input frame |',
             '|---|---:|---:|---:|---:|---:|---:|']
    lines += [f"| {row['row']} | {row['key']:.2f} | {row['between']:.2f} | {row['all']:.2f} | {signed(row['moving'])} | {signed(row['still'])} "
              f"| {1000 * row['seconds_per_frame']:.0f} |" for row in record['rows']]
    return lines


def write_page(record):
    page = PAGE.read_text()
    before, rest = page.split(BEGIN)
    after = rest.split(END)[1]
    PAGE.write_text(before + '\n'.join([BEGIN, *table(record), END]) + after)


def measured(clips, arguments, gap, threads):
    with tempfile.TemporaryDirectory() as folder:
        figures = Path(folder) / 'eval.json'
        given = arguments if '--quality' in arguments else [*arguments, '--gap', gap]
        subprocess.run([ROOT / 'target' / 'release' / 'streamsplat', 'eval', clips, '--quiet', '--threads', threads, '--json', figures, *given], check=True)
        return json.loads(figures.read_text())['mean']


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('clips', type=Path, nargs='?')
    parser.add_argument('--gap', default='5')
    parser.add_argument('--threads', default='2')
    parser.add_argument('--out', type=Path, default=ROOT / 'bench' / 'record')
    parser.add_argument('--table', type=Path, metavar='RECORD')
    options = parser.parse_args()
    if options.table:
        write_page(json.loads(options.table.read_text()))
        return
    if not options.clips:
        parser.error('expected a folder of clips')
    subprocess.run(['cargo', 'build', '--release', '--locked', '--quiet'], cwd=ROOT, check=True)
    rows, baselines = [], None
    for name, arguments in ROWS:
        mean = measured(options.clips, arguments, options.gap, options.threads)
        key, between = mean['key'], mean['middle']
        frames = key['frames'] + between['frames']
        rows.append({'row': name, 'arguments': arguments, 'key': key['psnr'], 'between': between['psnr'],
                     'all': (key['psnr'] * key['frames'] + between['psnr'] * between['frames']) / frames,
                     'moving': mean['moving']['over_crossfade'], 'still': mean['still']['over_crossfade'],
                     'seconds_per_frame': mean['seconds_per_frame']})
        row = rows[-1]
        print(f"{name}: {row['key']:.2f} {row['between']:.2f} {1000 * row['seconds_per_frame']:.0f} ms", flush=True)
        # Flow is that of the model's input, so its blend depends on the resolution.
        if arguments != PAPER:
            baselines = baselines or {name: score['psnr'] for name, score in mean['baselines'].items()}
    date, machine = datetime.date.today().isoformat(), cpu()
    record = {'date': date, 'cpu': machine, 'threads': int(options.threads), 'gap': options.gap,
              'clips': len(list(options.clips.iterdir())), 'baselines': baselines, 'rows': rows}
    name = f"changes-{date}-{re.sub('[^a-z0-9]+', '-', machine.lower()).strip('-')}.json"
    (options.out / name).write_text(json.dumps(record, indent=1, ensure_ascii=False) + '\n')
    write_page(record)
    print(options.out / name)


if __name__ == '__main__':
    main()
