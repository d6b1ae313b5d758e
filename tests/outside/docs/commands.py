"""Runs the commands that README.md and docs/*.md show: commands.py ROOT PROGRAM

A command is a line of an indented block of the README or of a ```sh block of a page. They run in order, page by page, in a scratch folder in which the names
they use exist: `clip.mp4`, `clip.y4m`, `FOLDER` of images, `CLIPS` of clips, a small model as `MODEL.safetensors`, and links to the repository's folders.
What a command cannot mean here is replaced (REPLACED); what another part of the tests runs is named with that part (ELSEWHERE). A command that is in
neither table and fails, and an entry of a table that no page uses, are errors.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

# Text in a command → what stands for it here.
REPLACED = {
    "-f v4l2 -i /dev/video0": "-i clip.mp4",
}
# Beginnings of commands → what runs them.
ELSEWHERE = {
    "tests/run": "it is what runs this",
    "tests/emulated/run.sh": ".ci/run",
}


def commands_of(page: Path) -> list[str]:
    """The commands of a page in order, continued lines joined, without comments at their ends."""
    text = page.read_text()
    fenced = re.findall(r"^```sh\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    outside = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    indented = re.findall(r"(?:^(?: {4}\S.*)\n)+", outside, re.MULTILINE)
    lines = "\n".join([*indented, *fenced]).replace("\\\n", " ").splitlines()
    # Blocks of other kinds (formulas, listings) hold no line that begins with a program's name.
    programs = r"(cargo|streamsplat|streamsplat-bench|tests/\S+|ffmpeg|python3?|pip|bench/\S+)\b"
    commands = [re.sub(r"\s+# .*", "", line.strip()) for line in lines]
    return [command for command in commands if re.match(programs, command)]


def prepare(scratch: Path, root: Path, program: Path) -> dict[str, str]:
    """Fills the scratch folder; gives the environment in which commands run."""
    for name in ("fixtures", "bench", "tests", "examples", "docs"):
        (scratch / name).symlink_to(root / name)
    clip = root / "fixtures/clips/moving.y4m"
    shutil.copy(clip, scratch / "clip.y4m")
    ffmpeg = ["ffmpeg", "-v", "error", "-i", clip, "-frames:v", "9"]
    subprocess.run([*ffmpeg, "-c:v", "libx264", "-pix_fmt", "yuv420p", scratch / "clip.mp4"], check=True)
    for folder in ("FOLDER", "CLIPS/one", "CLIPS/two"):
        (scratch / folder).mkdir(parents=True)
        subprocess.run([*ffmpeg, scratch / folder / "%06d.png"], check=True)
    for kind in ("safetensors", "json"):
        shutil.copy(root / f"fixtures/parity/tiny-dino.{kind}", scratch / f"MODEL.{kind}")
        shutil.copy(root / f"fixtures/parity/dino-tiny.{kind}", scratch / f"DINOV2.{kind}")
    tools = scratch / ".tools"
    tools.mkdir()
    (tools / "streamsplat").symlink_to(program)
    (tools / "streamsplat-bench").symlink_to(program.with_name("streamsplat-bench"))
    # `cargo run -- …` runs the program that has just been built, here; every other cargo command runs in the repository.
    cargo = shutil.which("cargo")
    shim = f'#!/bin/sh\nif [ "$1 $2 $3" = "run --release --" ]; then shift 3; exec {program} "$@"; fi\ncd {root} && exec {cargo} "$@"\n'
    (tools / "cargo").write_text(shim)
    (tools / "cargo").chmod(0o755)
    return {**os.environ, "PATH": f"{tools}:{os.environ['PATH']}"}


def main() -> int:
    root, program = Path(sys.argv[1]), Path(sys.argv[2])
    pages = [root / "README.md", *sorted((root / "docs").glob("*.md"))]
    used: set[str] = set()
    ran = failed = 0
    for page in pages:
        with tempfile.TemporaryDirectory() as scratch:
            environment = prepare(Path(scratch), root, program)
            for command in commands_of(page):
                known = next((start for start in ELSEWHERE if command.startswith(start)), None)
                if known:
                    used.add(known)
                    continue
                for text, instead in REPLACED.items():
                    if text in command:
                        used.add(text)
                        command = command.replace(text, instead)
                result = subprocess.run(["bash", "-ec", f"set -o pipefail; {command}"], cwd=scratch, env=environment,
                                        stdin=subprocess.DEVNULL, capture_output=True, text=True)
                ran += 1
                if result.returncode:
                    failed += 1
                    print(f"{page.relative_to(root)}: {command}\n  exit code {result.returncode}: {result.stderr.strip()[-600:]}")
    stale = (REPLACED.keys() | ELSEWHERE.keys()) - used
    if stale:
        print(f"in a table of commands.py, on no page: {', '.join(sorted(stale))}")
    print(f"{ran} commands, {failed} failed")
    return 1 if failed or stale or ran < 10 else 0


if __name__ == "__main__":
    sys.exit(main())
