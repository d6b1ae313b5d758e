"""The procedural clip, from which the tests cut theirs."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def procedural():
    """The header line of the procedural clip, and its frames, each with its mark."""
    header, rest = (Path(os.environ["STREAMSPLAT_ROOT"]) / "fixtures/clips/moving.y4m").read_bytes().split(b"\n", 1)
    width, height = (int(next(t[1:] for t in header.split() if t[:1] == key)) for key in (b"W", b"H"))
    size = len(b"FRAME\n") + width * height * 3 // 2
    assert b"420" in header and len(rest) % size == 0
    return header + b"\n", [rest[i : i + size] for i in range(0, len(rest), size)]
