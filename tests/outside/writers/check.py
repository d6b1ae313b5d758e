"""Checks of tests/outside/writers/run: check.py PROGRAM [NAME…]."""
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[3]
PROGRAM = sys.argv[1]
MODEL = ROOT / 'fixtures' / 'parity' / 'tiny-nodino.safetensors'
COLOURS = [(200, 40, 40), (30, 90, 200), (60, 180, 75), (240, 240, 10), (128, 128, 128)]
NAMES = ['mp4', 'm4v', 'mov', 'mkv', 'webm', 'avif', 'webp', 'gif']


def out(*command, **options):
    return subprocess.run([*map(str, command)], check=True, capture_output=True, **options).stdout


def program(*arguments, expected=0, **options):
    done = subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True, **options)
    assert done.returncode == expected, f'{arguments}: {done.returncode} {done.stderr}'
    return done.stdout + done.stderr


def run(clip, target, *more, **options):
    return program('run', clip, '--out', target, '--model', MODEL, '--gap', 2, '--threads', 1, '--emit', 'rgb', *more, **options)


def close(clip, target, *more):
    """The same with the model inside the program; its images are of one colour like the frames."""
    return program('run', clip, '--out', target, '--quality', 'realtime', '--threads', 1, '--emit', 'rgb', *more)


def probe(path, stream, entries, kind='stream'):
    text = out('ffprobe', '-v', 'error', '-select_streams', stream, '-show_entries', f'{kind}={entries}', '-of', 'json', path)
    return json.loads(text)[f'{kind}s']


def times(path):
    shown = sorted(float(packet['pts_time']) for packet in probe(path, 'v:0', 'pts_time', 'packet'))
    return np.array(shown) - shown[0]


def flat(folder, colour, size, frames=4):
    folder.mkdir()
    for i in range(frames):
        Image.new('RGB', size, colour).save(folder / f'{i}.png')


def by_ffmpeg(path):
    raw = out('ffmpeg', '-v', 'error', '-i', path, '-frames:v', 1, '-vf', 'scale=flags=accurate_rnd+full_chroma_int', '-pix_fmt', 'rgb24',
              '-f', 'rawvideo', '-')
    return np.frombuffer(raw, np.uint8).reshape(-1, 3).astype(float)


def by_pillow(path):
    return np.asarray(Image.open(path).convert('RGB')).reshape(-1, 3).astype(float)


def by_libwebp(path):
    frame, png = path.with_suffix('.frame.webp'), path.with_suffix('.webp.png')
    moving = b'ANMF' in path.read_bytes()
    if moving:
        out('webpmux', '-get', 'frame', 1, path, '-o', frame)
    out('dwebp', frame if moving else path, '-o', png)
    return by_pillow(png)


def colours(work):
    """Every writer's matrix and range, by every available reader, and the tags."""
    for number, colour in enumerate(COLOURS):
        for size in [(64, 36)] if number else [(64, 36), (1280, 720)]:
            name = f'{number}-{size[0]}'
            flat(work / name, colour, size, 2)
            # The images show the frames, for any model.
            close(work / name, work / f'{name}.images', '--size', 'source')
            # The drawn image is near the frame, and all of one colour.
            truth = by_pillow(work / f'{name}.images' / 'frames' / '000000.png').mean(0)
            for ending in NAMES if size[0] == 64 else ['mp4', 'webp']:
                file = work / f'{name}.{ending}'
                close(work / name, file)
                # ffmpeg 5.1 reads no animated WebP.
                readers = {} if b'ANMF' in file.read_bytes() else {'ffmpeg': by_ffmpeg}
                if ending in ('avif', 'webp', 'gif'):
                    readers['Pillow'] = by_pillow
                if ending == 'webp':
                    readers['libwebp'] = by_libwebp
                for reader, read in readers.items():
                    apart = abs(read(file).mean(0) - truth).max()
                    assert apart <= 1.5, f'{file.name} by {reader}: {apart:.2f} from {truth}'
                if ending not in ('webp', 'gif'):
                    (tags,) = probe(file, 'v:0', 'color_range,color_space,color_primaries,color_transfer,pix_fmt')
                    said = {tags[key] for key in ('color_space', 'color_primaries', 'color_transfer')}
                    expected = ({'smpte170m', 'bt709'}, 'pc') if ending == 'avif' else ({'bt709'}, 'tv')
                    assert (said, tags['color_range']) == expected and tags['pix_fmt'].startswith('yuv'), (file.name, tags)


def uneven(work):
    """A video whose frames have times of their own keeps them, with its sound; a scene stores them."""
    shown = [0, 0.1, 0.2, 0.3, 3.0, 3.04, 3.1, 3.5]
    clip = work / 'uneven.mp4'
    select = '+'.join(f'eq(n\\,{round(t * 50)})' for t in shown)
    out('ffmpeg', '-v', 'error', '-f', 'lavfi', '-i', 'testsrc2=s=96x64:r=50:d=4', '-f', 'lavfi', '-i', 'sine=d=6', '-vf', f"select='{select}'",
        '-fps_mode', 'passthrough', '-enc_time_base', '1:1000', '-c:v', 'libx264', '-qp', 4, '-c:a', 'aac', clip)
    assert np.allclose(times(clip), shown, atol=1e-3), times(clip)
    for ending in ['mp4', 'mov', 'mkv', 'webm', 'gif', 'avif']:
        file = work / f'kept.{ending}'
        run(clip, file)
        found, step = times(file), 0.0051 if ending == 'gif' else 0.0011
        assert len(found) == len(shown) and np.allclose(found, shown, atol=step), (ending, found)
        if ending in ('mp4', 'mov', 'mkv', 'webm'):
            sound = probe(file, 'a:0', 'pts_time,duration_time', 'packet')
            end = float(sound[-1]['pts_time']) + float(sound[-1].get('duration_time', 0))
            # The mean rate is 2 a second: the last picture lasts half a second.
            assert abs(end - 4.0) < 0.06, (ending, end)
    folder, again = work / 'scene', work / 'again'
    program('run', clip, '--out', folder, '--model', MODEL, '--gap', 3, '--quiet')
    program('render', folder, '--out', again, '--quiet')
    assert program('compare', folder / 'frames', again / 'frames').startswith('equal (8 files'), 'render gives other images'
    # The container too, and a video drawn from it.
    program('export', folder, '--format', 'ssz', '--out', work / 'scene.ssz', '--quiet')
    program('render', work / 'scene.ssz', '--out', work / 'drawn.mp4', '--quiet')
    assert np.allclose(times(work / 'drawn.mp4'), shown, atol=1e-3)
    said = run(clip, work / 'mean.y4m')
    assert 'y4m holds no times' in said, said


def even(work):
    """A constant rate stays one, to the tick."""
    for rate in ['24', '30000/1001', '24000/1001']:
        clip = work / 'even.mkv'
        out('ffmpeg', '-v', 'error', '-y', '-f', 'lavfi', '-i', f'testsrc2=s=96x64:r={rate}:d=0.5', '-c:v', 'libx264', '-qp', 4, clip)
        run(clip, work / 'even.mp4', '--overwrite')
        (stream,) = probe(work / 'even.mp4', 'v:0', 'r_frame_rate,avg_frame_rate,nb_frames')
        expected = rate if '/' in rate else f'{rate}/1'
        assert stream['r_frame_rate'] == stream['avg_frame_rate'] == expected, stream


def close_together(work):
    """No image of a GIF is shown for 1/100 s, which players take as 1/10 s."""
    clip = work / 'sixty.mkv'
    out('ffmpeg', '-v', 'error', '-f', 'lavfi', '-i', 'testsrc2=s=96x64:r=60:d=0.5', '-c:v', 'libx264', '-qp', 4, clip)
    said = run(clip, work / 'sixty.gif')
    assert '10 images are left out: players of GIF show at most 50 a second' in said, said
    found = times(work / 'sixty.gif')
    assert len(found) == 20 and min(np.diff(found)) > 0.019 and abs(found[-1] - 28 / 60) < 0.02, found


def late(work):
    """Sound that starts after the pictures still ends with them."""
    clip = work / 'late.mkv'
    out('ffmpeg', '-v', 'error', '-f', 'lavfi', '-i', 'testsrc2=s=96x64:r=10:d=1.2', '-itsoffset', '0.3', '-f', 'lavfi', '-i', 'sine=d=3', '-c:v',
        'libx264', '-qp', 4, '-c:a', 'flac', clip)
    for ending in ['mp4', 'mov', 'mkv', 'webm']:
        file = work / f'out.{ending}'
        run(clip, file)
        sound = probe(file, 'a:0', 'pts_time,duration_time', 'packet')
        begin, end = float(sound[0]['pts_time']), float(sound[-1]['pts_time']) + float(sound[-1].get('duration_time', 0))
        assert len(times(file)) == 12 and abs(begin - 0.3) < 0.06 and abs(end - 1.2) < 0.11, (ending, begin, end)


def odd(work):
    """H.264 gets even sides and a profile that players support, and a line reports it; others stay odd."""
    flat(work / 'odd', (200, 40, 40), (81, 45))
    for ending, size in [('mp4', (82, 46)), ('mkv', (82, 46)), ('webm', (81, 45)), ('avif', (81, 45)), ('webp', (81, 45)), ('gif', (81, 45))]:
        file = work / f'odd.{ending}'
        said = run(work / 'odd', file)
        assert ('81×45 became 82×46' in said) == (size == (82, 46)), said
        if ending == 'webp':
            assert Image.open(file).size == size
            continue
        (found,) = probe(file, 'v:0', 'width,height,profile,pix_fmt')
        assert (found['width'], found['height']) == size, (ending, found)
        if size == (82, 46):
            assert found['profile'] == 'High' and found['pix_fmt'] == 'yuv420p', found


def stopped(work):
    """Sound ends with the picture of a run that was stopped."""
    clip = work / 'long.mp4'
    out('ffmpeg', '-v', 'error', '-f', 'lavfi', '-i', 'testsrc2=s=320x192:r=10:d=60', '-f', 'lavfi', '-i', 'sine=d=60', '-c:a', 'aac', clip)
    file = work / 'stopped.mp4'
    child = subprocess.Popen([PROGRAM, 'run', clip, '--out', file, '--quiet', '--threads', '1'], stderr=subprocess.DEVNULL)
    partial = file.with_name('.stopped.mp4.partial')
    while child.poll() is None and not (partial.exists() and partial.stat().st_size):
        time.sleep(0.05)
    child.send_signal(signal.SIGINT)
    assert child.wait() == 130, child.returncode
    pictures, (sound,) = times(file), probe(file, 'a:0', 'duration')
    assert 0 < len(pictures) < 600 and abs(float(sound['duration']) - len(pictures) / 10) < 0.06, (len(pictures), sound)


def full(work):
    """A limit on file sizes simulates a disk that is full under the encoder: the run fails, and the previous file stays."""
    source = work / 'noise.mp4'
    out('ffmpeg', '-v', 'error', '-f', 'lavfi', '-i', 'nullsrc=s=320x192:r=10:d=1,geq=random(1)*255:128:128', '-c:v', 'libx264', '-qp', 10, source)
    run(source, work / 'images.d', '--size', 'source')
    limited = ['sh', '-c', 'trap "" XFSZ; ulimit -f 64; exec "$@"', 'sh', PROGRAM]
    for ending in ['mp4', 'mkv', 'webm', 'avif', 'webp', 'gif']:
        file = work / f'full.{ending}'
        file.write_bytes(b'what was there')
        command = ['run', source, '--out', file, '--model', MODEL, '--gap', '2', '--threads', '1', '--emit', 'rgb', '--quiet']
        command += ['--size', '640x384', '--overwrite']
        done = subprocess.run([*limited, *map(str, command)], capture_output=True, text=True)
        assert done.returncode == 1 and done.stderr.count('\n') == 1, (ending, done)
        assert file.read_bytes() == b'what was there', ending
        assert not Path(f'{file}.run.json').exists() and not (work / f'.{file.name}.partial').exists(), ending


def qualities(work):
    flat(work / 'plain', (90, 120, 150), (64, 36))
    sizes = []
    for crf in (1, 40):
        run(work / 'plain', work / f'{crf}.mp4', '--crf', crf)
        sizes.append((work / f'{crf}.mp4').stat().st_size)
    assert sizes[0] >= sizes[1], sizes
    for name, crf in [('a.mp4', 0), ('a.mp4', 52), ('a.webm', 64), ('a.gif', 20), ('a.webp', 20), ('a.y4m', 20), ('folder', 20)]:
        said = run(work / 'plain', work / name, '--crf', crf, expected=2)
        assert said.startswith('error: --crf: expected') or '--crf: expected' in said, said
        assert not (work / name).exists()


def main():
    with tempfile.TemporaryDirectory(prefix='streamsplat-writers-') as folder:
        for check in [uneven, even, close_together, late, odd, stopped, full, qualities, colours]:
            if len(sys.argv) > 2 and check.__name__ not in sys.argv[2:]:
                continue
            work = Path(folder) / check.__name__
            work.mkdir()
            check(work)
            print(check.__name__, 'holds', flush=True)


if __name__ == '__main__':
    main()
