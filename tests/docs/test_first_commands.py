"""The two commands of the README, as a person types them into the terminal of a stock system."""

import os
import re
import shlex
import subprocess
from pathlib import Path

import pytest

from tests.docs.conftest import ROOT, blocks

SYSTEM = Path("/usr/bin/python3")


def stock_machine(*command: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Runs a command with the system's Python, no uv in PATH, no environment and no screen."""
    ours = ("VIRTUAL_ENV", "PYTHONPATH", "DISPLAY", "WAYLAND_DISPLAY", "UV")
    env = {key: value for key, value in os.environ.items() if key not in ours}
    return subprocess.run(
        command, cwd=cwd, env=env | {"PATH": "/usr/bin:/bin"}, capture_output=True, text=True
    )


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clone with the present state of the files that git tracks."""
    folder = tmp_path_factory.mktemp("first") / "clone"
    subprocess.run(["git", "clone", "-q", "--no-hardlinks", ROOT, folder], check=True)
    changes = subprocess.run(["git", "diff", "--binary", "HEAD"], cwd=ROOT, capture_output=True)
    if changes.stdout:
        subprocess.run(["git", "apply"], cwd=folder, input=changes.stdout, check=True)
    return folder


@pytest.mark.live
def test_both_commands_of_the_readme_work_on_a_stock_system(clone: Path) -> None:
    """Nothing but the folder changes, although Debian calls its Python externally managed."""
    if not SYSTEM.exists():
        pytest.skip(f"no {SYSTEM}")
    new_enough = "import sys, pip; sys.exit(sys.version_info < (3, 11))"
    if stock_machine(str(SYSTEM), "-c", new_enough, cwd=clone).returncode:
        pytest.skip(f"{SYSTEM} has no pip, or is older than 3.11")
    lines = blocks("README.md", "sh")[0].splitlines()
    demo, tests = (re.sub(r"\s+#.*", "", line) for line in lines if "uv run" in line)
    install = shlex.split(demo.partition(" && ")[0])
    if "ould not find a version" in stock_machine(*install, cwd=clone).stderr:
        pytest.skip("no package index")
    done = stock_machine("bash", "-c", f"{demo} --duration 2", cwd=clone)
    assert done.returncode == 0, done.stderr
    assert list((clone / "lfpipe-demo").glob("demo.*"))
    done = stock_machine("bash", "-c", f"{tests} -q -n 0 tests/test_errors.py", cwd=clone)
    assert done.returncode == 0 and "[100%]" in done.stdout, done.stdout + done.stderr
    status = stock_machine("git", "status", "--short", "--untracked-files=all", cwd=clone).stdout
    assert not [line for line in status.splitlines() if line.startswith("??")], status
