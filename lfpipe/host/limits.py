"""Limits of the operating system. Open files: raised before a session starts, because some
libraries abort if the limit is too low. Memory: limited only if the system reports the use of a
process.
"""

import contextlib
import errno
import resource
import sys
from pathlib import Path
from typing import Self

from lfpipe.errors import UserError

OPEN_FILES = 128  # about 30 for a stage, as many for the supervisor, and a reserve
# more is useless, and some programs close every number up to the limit;
# macOS refuses more than OPEN_MAX
MAX_FILES = 1 << 16 if sys.platform == "linux" else 1 << 13


# errno of a call -> what helps against the limit that it hit
REMEDIES = {
    errno.EFBIG: "raise the limit of a file's size: `ulimit -f unlimited`, or LimitFSIZE= in a"
    " systemd unit",
    errno.EMFILE: "raise the limit of open files: `ulimit -n 1024`, or LimitNOFILE= in a systemd"
    " unit",
    errno.ENFILE: "end other programs: the whole system may open no more files",
}


def allow_files() -> None:
    """Raises the limit of open files, for this process and its children, to the hard limit.

    Raises UserError if that is fewer than OPEN_FILES.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if 0 <= hard < OPEN_FILES:
        raise UserError(
            f"{hard} open files are allowed here (RLIMIT_NOFILE); a session needs {OPEN_FILES}",
            "run `ulimit -n 1024` in the shell that starts it, or set LimitNOFILE= in its systemd"
            " unit",
        )
    most = MAX_FILES if hard < 0 else min(hard, MAX_FILES)
    if 0 <= soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


def free_files() -> int:
    """How many more files this process may open."""
    return resource.getrlimit(resource.RLIMIT_NOFILE)[0] - len([*Path("/dev/fd").iterdir()])


class MemoryLimit:
    """A context in which this process may use only this much more memory than at its creation:
    larger allocations fail. Shared memory and mapped files do not count.
    """

    def __init__(self, more_bytes: int) -> None:
        self._most: int | None = None
        with contextlib.suppress(OSError, StopIteration):
            lines = Path("/proc/self/status").read_text().splitlines()
            self._most = more_bytes + 1024 * next(
                int(line.split()[1]) for line in lines if line.startswith("VmData")
            )

    def __enter__(self) -> Self:
        if self._most is not None:
            self._before = resource.getrlimit(resource.RLIMIT_DATA)
            hard = self._before[1]  # of the user or of a container: it stays
            resource.setrlimit(
                resource.RLIMIT_DATA, (self._most if hard < 0 else min(self._most, hard), hard)
            )
        return self

    def __exit__(self, *_: object) -> None:
        if self._most is not None:
            resource.setrlimit(resource.RLIMIT_DATA, self._before)
