"""Lines of production code in Rust by folder: without comments, blank lines and tests.

python3 .ci/lines.py             counts the working tree
python3 .ci/lines.py REVISION    counts a commit

Left out: files and folders named test or tests, modules under `#[cfg(test)]`, `fixtures`, the tests' programs and `bench/experiments`.
Test modules in files of other names are counted.
"""
import collections
import pathlib
import re
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[1]
LEFT_OUT = re.compile(r"(^|/)tests?(/|\.rs$)|^(fixtures|bench/experiments|examples)/|_tests\.rs$")


def git(*arguments):
    return subprocess.run(["git", *arguments], cwd=ROOT, check=True, capture_output=True, text=True).stdout


def production(lines):
    """The number of lines that are code, outside of items under `#[cfg(test)]`."""
    count = at = 0
    while at < len(lines):
        text = lines[at].strip()
        if text.startswith("#![cfg(test)]"):
            break
        if text.startswith("#[cfg(test)]"):
            at += 1
            while lines[at].strip().startswith("#["):
                at += 1
            if not lines[at].rstrip().endswith(";"):
                indent = len(lines[at]) - len(lines[at].lstrip())
                at += 1
                while at < len(lines) and not lines[at].startswith(" " * indent + "}"):
                    at += 1
            at += 1
            continue
        count += bool(text) and not text.startswith("//")
        at += 1
    return count


def folder(path):
    """The folder under which a file is counted: a module of the engine, or a crate."""
    parts = path.split("/")
    deep = 3 if parts[:2] == ["engine", "src"] and len(parts) > 3 else 2
    return "/".join(parts[:deep])


def main():
    revision = sys.argv[1] if len(sys.argv) > 1 else None
    names = git("ls-tree", "-r", "--name-only", revision) if revision else git("ls-files")
    counts = collections.Counter()
    for name in names.split("\n"):
        if name.endswith(".rs") and not LEFT_OUT.search(name) and (revision or (ROOT / name).exists()):
            text = git("show", f"{revision}:{name}") if revision else (ROOT / name).read_text()
            counts[folder(name)] += production(text.split("\n"))
    for name, count in sorted(counts.items()):
        print(f"{name:32}{count:7}")
    print(f"{'all':32}{sum(counts.values()):7}")


main()
