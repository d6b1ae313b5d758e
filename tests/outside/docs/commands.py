"""Runs the commands in README.md and docs/*.md: commands.py ROOT PROGRAM PYTHON TORCH

A command is a line of an indented block of the README or of a ```sh block of a page. They run in order, page by page, in a scratch folder that contains the
names they use: `clip.mp4`, `clip.y4m`, `FOLDER` of images, `CLIPS` of clips, a small model as `streamsplat.safetensors` with its
`dinov2_vitb14_reg4_pretrain.pth`, a depth network as `NETWORK.onnx`, a foreign scene as `garden.ply`, and links to the repository's folders. A command that
serves a page (SERVES) is stopped as a user stops it. Text that is not possible here is replaced (REPLACED); commands that another part of the tests runs are
listed with that part (ELSEWHERE). A command that is in neither table and fails, and an entry of a table that no page uses, are errors.

Of docs/recipes.md everything runs, in its order: each line of its ```sh blocks but those of ELSEWHERE, and each ```python block as a program, in the
environment PYTHON with viser and Rerun, in TORCH where it imports torch. A recipe without either is an error. The ```html block is that of a page
which tests/outside/player opens.
"""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

# Text in a command → its replacement here.
REPLACED = {
    "-f v4l2 -i /dev/video0": "-i clip.mp4",
    "trained 5000000 large.ply": "trained 5000 $PWD/large.ply",
    "python3 examples/ray_long.py": "$WITH_PACKAGE examples/ray_long.py",
    "large.py streamsplat other-build/streamsplat": "large.py streamsplat streamsplat --scene large.ply --rounds 1",
}
# Beginnings of commands → the tests that run them.
ELSEWHERE = {
    "python3 examples/ray_batch.py CLIPS": "tests/outside/ray/run",
    "python3 examples/ray_long.py clip.y4m clusters.ssz": "tests/outside/ray/run",
    "python3 examples/ray_long.py clip.mp4 long.ssz": "tests/outside/ray/run",
    "pip install .": "tests/outside/python/run",
    "cargo build --release --features wgpu": "tests/outside/wgpu/run",
    "cargo doc --no-deps -p streamsplat": ".ci/run",
    "tests/run": "it is what runs this",
    "tests/emulated/run.sh": ".ci/run",
    "streamsplat golden": "tests/outside/golden/run",
    "streamsplat compare": "engine/cli/tests/program/compare.rs",
}
# Commands that run until they are stopped.
SERVES = re.compile(r"streamsplat (view (?!.*--html)|run .*--serve)")


def commands_of(page: Path) -> list[str]:
    """The commands of a page in order, continued lines joined, without comments at their ends."""
    text = page.read_text()
    fenced = re.findall(r"^```sh\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    outside = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    indented = re.findall(r"(?:^(?: {4}\S.*)\n)+", outside, re.MULTILINE)
    lines = "\n".join([*indented, *fenced]).replace("\\\n", " ").splitlines()
    # Blocks of other kinds (formulas, listings) have no line that begins with a program's name.
    programs = r"(cargo|streamsplat|streamsplat-bench|tests/\S+|ffmpeg|python3?|pip|bench/\S+)\b"
    commands = [re.sub(r"\s+# .*", "", line.strip()) for line in lines]
    return [command for command in commands if re.match(programs, command)]


def steps_of(page: Path) -> list[tuple[str, str]]:
    """The steps of a page of recipes in order: ("sh", a line) and ("python", a program). Fails where a recipe has none."""
    steps = []
    for recipe in re.split(r"^### ", page.read_text(), flags=re.MULTILINE)[1:]:
        blocks = re.findall(r"^```(sh|python)\n(.*?)^```", recipe, re.MULTILINE | re.DOTALL)
        if not blocks:
            raise SystemExit(f"{page}: {recipe.splitlines()[0]}: no step")
        for kind, text in blocks:
            lines = [re.sub(r"\s{2,}# .*", "", line) for line in text.replace("\\\n", " ").splitlines()]
            steps += [("sh", line) for line in lines if line] if kind == "sh" else [("python", text)]
    return steps


def prepare(scratch: Path, root: Path, program: Path) -> dict[str, str]:
    """Fills the scratch folder; returns the environment in which commands run."""
    for name in ("fixtures", "bench", "tests", "examples", "docs", "engine"):
        (scratch / name).symlink_to(root / name)
    clip = root / "fixtures/clips/moving.y4m"
    shutil.copy(clip, scratch / "clip.y4m")
    ffmpeg = ["ffmpeg", "-v", "error", "-i", clip, "-frames:v", "9"]
    subprocess.run([*ffmpeg, "-c:v", "libx264", "-pix_fmt", "yuv420p", scratch / "clip.mp4"], check=True)
    for folder in ("FOLDER", "CLIPS/one", "CLIPS/two"):
        (scratch / folder).mkdir(parents=True)
        subprocess.run([*ffmpeg, scratch / folder / "%06d.png"], check=True)
    shutil.copy(scratch / "clip.mp4", scratch / "CLIPS/three.mp4")
    for kind in ("safetensors", "json"):
        shutil.copy(root / f"fixtures/parity/tiny-dino.{kind}", scratch / f"streamsplat.{kind}")
        # The kind of a file follows from its content, not from its name.
        shutil.copy(root / f"fixtures/parity/dino-tiny.{kind}", scratch / f"dinov2_vitb14_reg4_pretrain.{kind.replace('safetensors', 'pth')}")
    shutil.copy(root / "fixtures/depth/depth.onnx", scratch / "NETWORK.onnx")
    camera = {"type": "pinhole", "position": [0, 0, -1], "fov_y_degrees": 60, "aspect": 16 / 9}
    (scratch / "camera.json").write_text(json.dumps(camera))
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([program, "run", scratch / "FOLDER", "--frames", "2", "--out", folder, "--quiet"], check=True)
        subprocess.run([program, "export", folder, "--format", "ply", "--times", "0", "--out", scratch / "garden.ply"], check=True,
                       stdout=subprocess.DEVNULL)
    # The foreign scene has none of our cameras.
    (scratch / "garden.ply.camera.json").unlink()
    cameras_of_others(scratch, root)
    tools = scratch / ".tools"
    tools.mkdir()
    (tools / "streamsplat").symlink_to(program)
    (tools / "streamsplat-bench").symlink_to(program.with_name("streamsplat-bench"))
    # `cargo run -- …` runs the built program here, and `-p streamsplat-fixtures` one built with the workspace, whose libraries exist: alone it has others. Of
    # `cargo test …` the tests are listed, and there must be some: tests/run has run them. Every other cargo command runs in the repository.
    cargo = shutil.which("cargo")
    shim = f"""#!/bin/sh
case "$*" in
"run --release -- "*) shift 3; exec {program} "$@" ;;
"run --release -p streamsplat-fixtures -- "*)
  shift 5
  cd {root} && {cargo} build --release --locked --quiet --workspace --bin streamsplat-fixtures
  exec "${{CARGO_TARGET_DIR:-target}}/release/streamsplat-fixtures" "$@"
  ;;
"test "*) cd {root} && {cargo} "$@" -- --list | grep -q ': test$' ;;
*) cd {root} && exec {cargo} "$@" ;;
esac
"""
    (tools / "cargo").write_text(shim)
    (tools / "cargo").chmod(0o755)
    return {**os.environ, "PATH": f"{tools}:{os.environ['PATH']}"}


def cameras_of_others(scratch: Path, root: Path) -> None:
    """Writes camera files of other programs, and scenes under those programs' names."""
    for name in ("point_cloud.ply", "splat.ply"):
        shutil.copy(scratch / "garden.ply", scratch / name)
    shutil.copy(root / "examples/golden/cameras.json", scratch)
    matrix = [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, -1], [0, 0, 0, 1]]
    frames = [{"file_path": f"images/{i}.png", "transform_matrix": matrix} for i in range(8)]
    (scratch / "transforms.json").write_text(json.dumps({"w": 64, "h": 36, "fl_x": 60, "frames": frames}))
    flight = [{"camera_to_world": sum(matrix, []), "fov": 50}] * 2
    (scratch / "camera_path.json").write_text(json.dumps({"render_width": 64, "render_height": 36, "fps": 2, "camera_path": flight}))
    values = {"position": [0, 0, -2, 1, 0, -2], "target": [0] * 6}
    track = {"duration": 1, "frameRate": 2, "keyframes": {"times": [0, 2], "values": values}}
    (scratch / "settings.json").write_text(json.dumps({"camera": {"fov": 50}, "animTracks": [track]}))
    own = ["trbf_center", "trbf_scale", *(f"motion_{k}" for k in range(9)), *(f"omega_{k}" for k in range(4))]
    names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split() + own
    row = "0 0 0 1 0.5 0 3 -2 -2 -2 1 0 0 0 0.5 0 1 " + "0 " * (len(names) - 17)
    header = "".join(f"property float {name}\n" for name in names)
    (scratch / "flames.ply").write_text(f"ply\nformat ascii 1.0\nelement vertex 1\n{header}end_header\n{row}\n")
    model = scratch / "project/sparse/0"
    model.mkdir(parents=True)
    (model / "cameras.txt").write_text("1 PINHOLE 64 36 60 60 32 18\n")
    (model / "images.txt").write_text("1 1 0 0 0 0 0 1 1 IMG_0042.jpg\n\n")


def serve(command: str, scratch: Path, environment: dict[str, str]) -> str | None:
    """Starts a command that serves a page, reads the page and stops the command with Ctrl-C once its results exist; returns the error, if any."""
    words = command.split()
    server = subprocess.Popen(words, cwd=scratch, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    address, said = None, []
    while address is None and (line := server.stdout.readline()):
        said.append(line)
        address = re.search(r"http://\S+", line)
    page = urllib.request.urlopen(address[0], timeout=20).read() if address else b""
    if "--out" in words:
        record = scratch / words[words.index("--out") + 1] / "run.json"
        while server.poll() is None and not record.is_file():
            time.sleep(0.1)
    server.send_signal(signal.SIGINT)
    code = server.wait(20)
    return None if b"<html" in page and code == 0 else f"said {said!r}, served {len(page)} bytes, exit code {code}"


# Seconds that each command took, and the command.
TOOK: list[tuple[float, str]] = []


def run(command: str, scratch: Path, environment: dict[str, str]) -> str | None:
    """Runs a command to its end; returns the error, if any."""
    began = time.monotonic()
    result = subprocess.run(["bash", "-ec", f"set -o pipefail; {command}"], cwd=scratch, env=environment,
                            stdin=subprocess.DEVNULL, capture_output=True, text=True)
    TOOK.append((time.monotonic() - began, command))
    return f"exit code {result.returncode}: {result.stderr.strip()[-600:]}" if result.returncode else None


def recipes(page: Path, scratch: Path, environment: dict[str, str], pythons: list[str], used: set[str]) -> tuple[int, int]:
    """Runs all steps of a page of recipes; returns how many ran and how many failed."""
    ran = failed = 0
    for kind, text in steps_of(page):
        known = next((start for start in ELSEWHERE if text.startswith(start)), None)
        if known:
            used.add(known)
            continue
        for part, instead in REPLACED.items():
            if kind == "sh" and part in text:
                used.add(part)
                text = text.replace(part, instead)
        if kind == "sh":
            wrong = run(text, scratch, environment)
        else:
            (scratch / "recipe.py").write_text(text)
            wrong = run(f"{pythons['import torch' in text]} recipe.py", scratch, environment)
        ran += 1
        if wrong:
            failed += 1
            print(f"{page.name}: {text}\n  {wrong}")
    return ran, failed


def main() -> int:
    root, program, pythons = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:5]
    recipe_page = root / "docs/recipes.md"
    pages = [root / "README.md", *sorted((root / "docs").glob("*.md"))]
    used: set[str] = set()
    with tempfile.TemporaryDirectory() as scratch:
        ran, failed = recipes(recipe_page, Path(scratch), {**prepare(Path(scratch), root, program), "WITH_PACKAGE": pythons[0]}, pythons, used)
    print(f"{ran} steps of recipes, {failed} failed")
    pages.remove(recipe_page)
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
                wrong = (serve if SERVES.match(command) else run)(command, Path(scratch), environment)
                ran += 1
                if wrong:
                    failed += 1
                    print(f"{page.relative_to(root)}: {command}\n  {wrong}")
    stale = (REPLACED.keys() | ELSEWHERE.keys()) - used
    if stale:
        print(f"in a table of commands.py, on no page: {', '.join(sorted(stale))}")
    print(f"{ran} commands, {failed} failed; the longest:")
    for seconds, command in sorted(TOOK, reverse=True)[:10]:
        print(f"{seconds:6.1f} s  {command}")
    return 1 if failed or stale or ran < 10 else 0


if __name__ == "__main__":
    sys.exit(main())
