"""The two commands of the README, as a person types them into the terminal of a new system."""

import os
import re
import shlex
import subprocess
from pathlib import Path

import pytest

from profiling.hosts import find_python
from tests.docs.conftest import ROOT, blocks

STOCK = "/usr/bin:/bin"  # Debian's and Ubuntu's own Python, which is externally managed
LINES = [line for line in blocks("README.md", "sh")[0].splitlines() if "uv run" in line]
DEMO, TESTS = (re.sub(r"\s+#.*", "", line) for line in LINES)

pytestmark = pytest.mark.nightly


def on(path: str, *command: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Runs a command with that PATH, without an environment of ours and without a screen."""
    ours = ("VIRTUAL_ENV", "PYTHONPATH", "DISPLAY", "WAYLAND_DISPLAY", "UV")
    env = {key: value for key, value in os.environ.items() if key not in ours}
    return subprocess.run(
        command, cwd=cwd, env=env | {"PATH": path}, capture_output=True, text=True
    )


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A clone with the present state of the files that git tracks."""
    folder = tmp_path / "clone"
    subprocess.run(["git", "clone", "-q", "--no-hardlinks", ROOT, folder], check=True)
    changes = subprocess.run(["git", "diff", "--binary", "HEAD"], cwd=ROOT, capture_output=True)
    if changes.stdout:
        subprocess.run(["git", "apply"], cwd=folder, input=changes.stdout, check=True)
    return folder


def path_of(system: str) -> str:
    """PATH of a kind of system, without uv; the test is skipped where it isn't there."""
    if system == "stock":
        return STOCK
    python = find_python(system)
    if python is None:
        pytest.skip(f"no Python {system}")
    return f"{Path(python).resolve().parent}:{STOCK}"


def run_demo(path: str, command: str, clone: Path) -> None:
    done = on(path, "bash", "-c", f"{command} --duration 2", cwd=clone)
    assert done.returncode == 0, done.stderr
    assert list((clone / "lfpipe-demo").glob("demo.*"))
    status = on(path, "git", "status", "--short", "--untracked-files=all", cwd=clone).stdout
    assert not [line for line in status.splitlines() if line.startswith("??")], status


@pytest.mark.parametrize("system", ["stock", "3.12"])
def test_demo_command_works_on_a_new_system(clone: Path, system: str) -> None:
    """Nothing but the folder changes. Images such as python:3.12-slim have pip and no uv."""
    path = path_of(system)
    new_enough = "import sys, pip; sys.exit(sys.version_info < (3, 11))"
    if on(path, "python3", "-c", new_enough, cwd=clone).returncode:
        pytest.skip("python3 has no pip, or is older than 3.11")
    install = shlex.split(DEMO.partition(" && ")[0])
    if "ould not find a version" in on(path, *install, cwd=clone).stderr:
        pytest.skip("no package index")
    run_demo(path, DEMO, clone)
    if system == "stock":
        done = on(path, "bash", "-c", f"{TESTS} -q -n 0 tests/test_errors.py", cwd=clone)
        assert done.returncode == 0 and "[100%]" in done.stdout, done.stdout + done.stderr
