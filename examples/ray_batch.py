"""A folder of clips over a Ray cluster: python examples/ray_batch.py CLIPS OUT [--gap N] [--address ADDRESS | --plain]

A clip is the unit of work. Each becomes a folder OUT/CLIP with `scene/` and `frames/`, which appears when it is whole. A worker that dies is replaced and its
clip resumed where it stood; a run that was stopped goes on with the clips that are missing. The bytes of scenes and images are those of a plain loop on one
machine (`--plain`), whatever the number of workers: results do not depend on threads, instruction sets or machines. CLIPS and OUT must mean the same folders
on every machine of the cluster.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

import streamsplat_cpu


VIDEOS = {".y4m", ".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi"}


def clips_in(folder: Path) -> list[Path]:
    """Videos and folders of images, in order of their names; other files are named on standard error."""
    names = sorted(p for p in folder.iterdir() if not p.name.startswith("."))
    clips = [p for p in names if p.is_dir() or p.suffix.lower() in VIDEOS]
    for other in (p for p in names if p not in clips):
        print(f"{other}: not a clip by its name, left out", file=sys.stderr)
    return clips


def work_on(clip: Path, out: Path, gap: int, threads: int | None) -> str:
    """One clip, from its frames to its folder."""
    if out.exists():
        # A worker finished it and was lost before it reported so.
        return f"{clip.name}: there already"
    partial = out.with_name(f".{out.name}.partial")
    try:
        # An earlier worker's intervals are kept.
        done = streamsplat_cpu.reconstruct(clip, partial, gap=gap, threads=threads, resume=partial.exists())
    except streamsplat_cpu.Error:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    partial.rename(out)
    return f"{clip.name}: {done.frames} frames, {done.key_frames} key frames"


def on_ray(todo: list[tuple[Path, Path]], gap: int, address: str | None) -> int:
    """All clips on a cluster, one processor each; the number of clips that failed."""
    import ray

    ray.init(address=address, log_to_driver=False, logging_level="error")
    # The system's faults (a worker or a machine that is gone) are retried; an error of the engine would come again and is not.
    task = ray.remote(num_cpus=1, max_retries=5)(work_on)
    pending = {task.remote(clip.resolve(), out.resolve(), gap, 1): clip for clip, out in todo}
    failed = 0
    while pending:
        [ready], _ = ray.wait(list(pending), num_returns=1)
        clip = pending.pop(ready)
        try:
            print(ray.get(ready), flush=True)
        except ray.exceptions.RayError as error:
            failed += 1
            cause = getattr(error, "cause", None) or error
            print(f"{clip}: {str(cause).strip().splitlines()[-1]}", file=sys.stderr, flush=True)
    ray.shutdown()
    return failed


def in_a_loop(todo: list[tuple[Path, Path]], gap: int) -> int:
    """All clips one after another on this machine."""
    failed = 0
    for clip, out in todo:
        try:
            print(work_on(clip, out, gap, None), flush=True)
        except (streamsplat_cpu.Error, OSError) as error:
            failed += 1
            print(f"{clip}: {error}", file=sys.stderr, flush=True)
    return failed


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("clips", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--gap", type=int, default=4, help="every N-th frame is a key frame (default: 4)")
    parser.add_argument("--address", help="a running cluster, such as auto or HOST:6379 (default: a cluster of this machine's processors)")
    parser.add_argument("--plain", action="store_true", help="without Ray, one clip after another")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    pairs = [(clip, args.out / clip.stem) for clip in clips_in(args.clips)]
    if not pairs:
        parser.error(f"{args.clips}: expected clips, found none")
    if len({out for _, out in pairs}) < len(pairs):
        parser.error(f"{args.clips}: expected clips of different names (endings aside)")
    # A clip's folder appears when it is whole, so what is there is done.
    todo = [(clip, out) for clip, out in pairs if not out.exists()]
    print(f"{len(pairs)} clips, {len(pairs) - len(todo)} done before", flush=True)
    failed = in_a_loop(todo, args.gap) if args.plain else on_ray(todo, args.gap, args.address)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
