"""A failed test's teardown is watched, too: nothing keeps the suite waiting for ever."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.support import watchdog

SOURCE = """
import time
import pytest

@pytest.fixture
def endless():
    yield
    {wait}

def test_that_fails(endless):
    assert False
"""
# What hears no signal: Python code never runs again, as in a library that waits with the GIL.
HUNG = "import ctypes; ctypes.PyDLL(None).sleep(100)"


@pytest.mark.parametrize(
    ("wait", "limit", "words"),
    [
        ("time.sleep(100)", "timeout=1", "Timeout (>1.0s)"),
        (HUNG, "faulthandler_timeout=1", "Timeout (0:00:01)!"),
    ],
)
def test_watchdog_ends_the_teardown_of_a_failed_test(
    tmp_path: Path, wait: str, limit: str, words: str
) -> None:
    (tmp_path / "test_endless.py").write_text(SOURCE.format(wait=wait))
    command = [sys.executable, "-m", "pytest", "-p", watchdog.__name__, "-p", "no:xdist"]
    options = ["-o", limit, "-o", "faulthandler_exit_on_timeout=true", "-c", "/dev/null"]
    ended = subprocess.run(
        [*command, *options, "--rootdir", tmp_path, tmp_path],
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert ended.returncode != 0
    assert words in ended.stdout + ended.stderr
