"""Limits of the operating system, raised before a session is built: some libraries abort where they are too low."""

from __future__ import annotations

import contextlib
import resource
from pathlib import Path

from lfpipe.errors import UserError

OPEN_FILES = 128  # a stage has about 30 open, the supervisor as many, and a reserve
MOST_FILES = 1 << 16  # more is of no use, and some programs close every number up to the limit


def allowed_files() -> int:
    """How many files this process may have open."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return soft if soft >= 0 else MOST_FILES


def limit_memory(more_bytes: int) -> None:
    """Lets this process take that much more memory than it has now; mapped files do not count."""
    has_bytes = 0
    with contextlib.suppress(OSError, StopIteration):
        lines = Path("/proc/self/status").read_text().splitlines()
        has_bytes = 1024 * int(next(line.split()[1] for line in lines if line.startswith("VmData")))
    resource.setrlimit(resource.RLIMIT_DATA, (has_bytes + more_bytes, resource.RLIM_INFINITY))


def allow_files(needed: int = OPEN_FILES) -> None:
    """Lets this process and its children have as many files open as the hard limit allows.

    Raises UserError where that is fewer than needed.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if 0 <= hard < needed:
        raise UserError(
            f"{hard} open files are allowed here (RLIMIT_NOFILE), a session needs {needed}",
            f"`ulimit -n {max(1024, needed)}` in the shell that starts it, or LimitNOFILE= in its systemd unit",
        )
    most = MOST_FILES if hard < 0 else min(hard, MOST_FILES)
    if 0 <= soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


class MemoryLimit:
    """A context in which this process may have only so much more memory than it had when the limit was made: what asks for more
    gets none and fails. Shared memory and mapped files do not count.
    """

    def __init__(self, more_bytes: int) -> None:
        self._before = resource.getrlimit(resource.RLIMIT_DATA)
        self._inside = self._before
        with contextlib.suppress(OSError):  # where the system does not say what a process has, there is no limit
            lines = Path("/proc/self/status").read_text().splitlines()
            has_kb = next(int(line.split()[1]) for line in lines if line.startswith("VmData"))
            soft, hard = has_kb * 1024 + more_bytes, self._before[1]
            self._inside = (soft if hard < 0 else min(soft, hard), hard)

    def __enter__(self) -> None:
        self._before = resource.getrlimit(resource.RLIMIT_DATA)
        resource.setrlimit(resource.RLIMIT_DATA, self._inside)

    def __exit__(self, *_: object) -> None:
        resource.setrlimit(resource.RLIMIT_DATA, self._before)
