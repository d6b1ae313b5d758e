"""Loss of quality by the encoder of a delivered video: delivered.py PROGRAM CLIPS [--crf 10,14,23] [--kind mp4] [--frames N]

CLIPS is a folder of clips, each a folder of images. A clip is run once; its images are then encoded at each quality by `render`, decoded by ffmpeg, and both
are compared with the clip's own frames at full size. For each clip it prints the PSNR of the drawn images, its change by encoding, and the bytes of the video.
PSNR is printed twice: of the squared error pooled over all frames, and as the mean of the frames' PSNR.
"""

import argparse
import math
import subprocess
import tempfile
from pathlib import Path


def frames(source):
    """The samples of each frame, 8-bit RGB, of a folder of images or of a video."""
    if source.is_dir():
        ending = next(path.suffix for path in sorted(source.iterdir()) if path.suffix in ('.png', '.jpg'))
        given = ['-pattern_type', 'glob', '-i', f'{source}/*{ending}']
    else:
        given = ['-i', str(source)]
    command = ['ffmpeg', '-nostdin', '-v', 'error', *given, '-sws_flags', '+accurate_rnd+full_chroma_int+bitexact', '-fps_mode', 'passthrough']
    return subprocess.run([*command, '-pix_fmt', 'rgb24', '-f', 'rawvideo', '-'], stdout=subprocess.PIPE, check=True).stdout


def errors(samples, truth, count):
    """Mean squared error of each frame."""
    import numpy

    assert len(samples) == len(truth), f'expected {len(truth)} samples, found {len(samples)}'
    a, b = (numpy.frombuffer(x, numpy.uint8).reshape(count, -1).astype(numpy.float32) for x in (samples, truth))
    return ((a - b) ** 2).mean(1)


def db(error):
    return 10 * math.log10(255**2 / max(float(error), 1e-9))


def main():
    a = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    a.add_argument('program')
    a.add_argument('clips', type=Path)
    a.add_argument('--crf', default='10')
    a.add_argument('--kind', default='mp4')
    a.add_argument('--frames', type=int, default=24)
    options = a.parse_args()
    qualities = [int(crf) for crf in options.crf.split(',')]
    for clip in sorted(path for path in options.clips.iterdir() if path.is_dir()):
        with tempfile.TemporaryDirectory() as work:
            scene, first = Path(work) / 'scene', Path(work) / 'first'
            subprocess.run([options.program, 'run', clip, '--frames', str(options.frames), '--size', 'source', '--out', scene, '--quiet'], check=True)
            first.mkdir()
            for image in sorted(clip.iterdir())[: options.frames]:
                (first / image.name).symlink_to(image.resolve())
            count = len(list(first.iterdir()))
            truth = frames(first)
            drawn = errors(frames(scene / 'frames'), truth, count)
            line = f'{clip.name}: drawn {db(drawn.mean()):.2f} dB'
            for crf in qualities:
                video = Path(work) / f'{crf}.{options.kind}'
                subprocess.run([options.program, 'render', scene, '--size', 'source', '--crf', str(crf), '--out', video, '--quiet'], check=True)
                found = errors(frames(video), truth, count)
                mean = sum(map(db, found)) / count - sum(map(db, drawn)) / count
                line += f'; crf {crf}: pooled {db(found.mean()) - db(drawn.mean()):+.2f}, mean of frames {mean:+.2f} dB, {video.stat().st_size // 1024} kB'
            print(line, flush=True)


if __name__ == '__main__':
    main()
