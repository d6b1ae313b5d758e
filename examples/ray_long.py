"""One long video over a Ray cluster: python examples/ray_long.py VIDEO OUT.ssz [--gap N] [--address ADDRESS | --plain]

The video is split where its picture cuts. Each part is reconstructed by itself, in a folder OUT.parts/FIRST-LAST that appears when it is whole; a run that was
stopped goes on with the parts that are missing. `streamsplat export` joins them to one scene with the video's times. Its bytes are those of a plain loop with
the same parts on one machine (`--plain`). VIDEO and OUT must mean the same files on every machine of the cluster. Each part reads the video from its start.
"""

from __future__ import annotations

import argparse
import itertools
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import streamsplat_cpu


def parts_of(video: Path, threshold: float, least: int) -> list[tuple[int, int]]:
    """First frame and the one after the last of each part: a new one where neighbouring frames differ by `threshold` on average, and has `least` frames."""
    starts, before, number = [0], None, -1
    for number, (frame, _) in enumerate(streamsplat_cpu.Frames(video)):
        small = frame[::8, ::8].copy()
        if before is not None and number - starts[-1] >= least and np.abs(small - before).mean() > threshold:
            starts.append(number)
        before = small
    if number < 0:
        raise SystemExit(f"{video}: expected frames, found none")
    # The last part is as long as the others, or goes with the one before.
    if len(starts) > 1 and number + 1 - starts[-1] < least:
        starts.pop()
    return list(zip(starts, [*starts[1:], number + 1]))


def work_on(video: Path, first: int, last: int, folder: Path, gap: int, threads: int | None) -> str:
    """One part, from its frames to its folder."""
    if not folder.exists():
        partial = folder.with_name(f".{folder.name}.partial")
        shutil.rmtree(partial, ignore_errors=True)
        frames = itertools.islice(streamsplat_cpu.Frames(video), first, last)
        streamsplat_cpu.reconstruct(frames, partial, emit="scene", gap=gap, threads=threads)
        partial.rename(folder)
    return f"frames {first} to {last - 1}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("video", type=Path)
    parser.add_argument("out", type=Path, help="the joined scene, a .ssz file")
    parser.add_argument("--gap", type=int, default=4, help="every N-th frame is a key frame (default: 4)")
    parser.add_argument("--cut", type=float, default=0.1, help="mean difference of colours, from 0 to 1, that is a cut (default: 0.1)")
    parser.add_argument("--least", type=int, default=48, help="least frames of a part (default: 48)")
    parser.add_argument("--address", help="a running cluster, such as auto or HOST:6379 (default: a cluster of this machine's processors)")
    parser.add_argument("--plain", action="store_true", help="without Ray, one part after another")
    args = parser.parse_args()
    if args.out.suffix != ".ssz":
        parser.error(f"{args.out}: expected a name that ends in .ssz")
    video, folder = args.video.resolve(), args.out.resolve().with_suffix(".parts")
    folder.mkdir(parents=True, exist_ok=True)
    work = [(video, first, last, folder / f"{first:08}-{last:08}", args.gap) for first, last in parts_of(video, args.cut, args.least)]
    if args.plain:
        for part in work:
            print(work_on(*part, None), flush=True)
    else:
        import ray

        ray.init(address=args.address, log_to_driver=False, logging_level="error")
        # A worker or a machine that is gone is replaced; an error of the engine would come again.
        task = ray.remote(num_cpus=1, max_retries=5)(work_on)
        pending = [task.remote(*part, 1) for part in work]
        while pending:
            [ready], pending = ray.wait(pending)
            print(ray.get(ready), flush=True)
        ray.shutdown()
    scenes = [part[3] for part in work]
    return subprocess.run([sys.executable, "-m", "streamsplat_cpu", "export", *scenes, "--out", args.out]).returncode


if __name__ == "__main__":
    sys.exit(main())
