"""The fixture `golden`: what `streamsplat golden check` found of a render, by its name."""

import json
import os
import subprocess
from pathlib import Path

import pytest

LIST = Path(__file__).parent.parent / "renders.toml"


@pytest.fixture(scope="session")
def golden(tmp_path_factory):
    """Draws the whole list once; golden("front") fails where an image of that render differs."""
    failed = tmp_path_factory.mktemp("golden") / "failed"
    program = os.environ.get("STREAMSPLAT", "streamsplat")
    command = [program, "golden", "check", str(LIST), "--json", "--out", str(failed)]
    done = subprocess.run(command, capture_output=True, text=True)
    if not done.stdout:
        pytest.fail(done.stderr)
    checks = json.loads(done.stdout)["checks"]

    def check(name):
        found = [check for check in checks if check["render"] == name]
        assert found, f"{name} is not in {LIST.name}"
        wrong = [f"{name} at {check['time']} s: {check['failure']}" for check in found if not check["passed"]]
        assert not wrong, "\n".join([*wrong, f"see {failed}"])

    return check
