"""Programs of a test: run to their end, or ended; and this process under limits."""

import contextlib
import os
import resource
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

PATIENCE_S = 30.0  # with what is ended


def printed(*words: str | Path, timeout_s: float = 250.0, **more: Any) -> str:
    """What a program prints that succeeds."""
    done = subprocess.run(words, capture_output=True, text=True, timeout=timeout_s, **more)
    assert done.returncode == 0, done.stdout + done.stderr
    return str(done.stdout)


def end(process: subprocess.Popen[Any]) -> None:
    """Terminates a process, and kills one that does not end."""
    process.terminate()
    try:
        process.wait(PATIENCE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait(PATIENCE_S)


@contextlib.contextmanager
def largest_file(size_bytes: int) -> Iterator[None]:
    """Files that this process writes end at so many bytes, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@contextlib.contextmanager
def open_umask() -> Iterator[None]:
    """This process's new files are open to everybody, unless they say otherwise."""
    before = os.umask(0)
    try:
        yield
    finally:
        os.umask(before)
