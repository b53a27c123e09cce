"""A teardown that hangs after a failure is ended, although pytest has cancelled its time-outs."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

HANGS = """
import signal
import threading
import pytest

@pytest.fixture(params=[(), (signal.SIGALRM,)])
def stuck(request):
    yield
    signal.pthread_sigmask(signal.SIG_BLOCK, request.param)
    threading.Event().wait()

def test_fails(stuck):
    raise AssertionError
"""


@pytest.mark.live
def test_teardown_that_hangs_after_a_failure_is_ended(tmp_path: Path) -> None:
    (tmp_path / "test_it.py").write_text(HANGS)
    words = [sys.executable, "-m", "pytest", "-p", "tests.conftest", "-n", "1", "--timeout=2"]
    env = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    words += ["-o", "faulthandler_timeout=4", "test_it.py"]
    done = subprocess.run(
        words, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=120, check=False
    )
    assert "Timeout (>2.0s)" in done.stdout and "crashed while running" in done.stdout, done.stdout
