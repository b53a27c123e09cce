"""Limits of the operating system. Open files: raised before a session starts, because some libraries abort if the limit is too
low. Memory: limited only if the system reports the use of a process.
"""

import contextlib
import sys
from pathlib import Path

from lfpipe.errors import UserError

try:
    import resource
except ImportError:
    resource = None  # type: ignore[assignment]  # Windows: neither is limited

OPEN_FILES = 128  # about 30 for a stage, as many for the supervisor, and a reserve
# more is useless, and some programs close every number up to the limit; macOS refuses more than OPEN_MAX
MOST_FILES = 1 << 16 if sys.platform == "linux" else 1 << 13


def allowed_files() -> int:
    """The number of files that this process may have open."""
    soft = resource.getrlimit(resource.RLIMIT_NOFILE)[0] if resource else -1
    return soft if soft >= 0 else MOST_FILES


def allow_files(needed: int = OPEN_FILES) -> None:
    """Raises the limit of open files, for this process and its children, to the hard limit.

    Raises UserError if that is fewer than needed.
    """
    if not resource:
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if 0 <= hard < needed:
        raise UserError(
            f"{hard} open files are allowed here (RLIMIT_NOFILE), a session needs {needed}",
            f"`ulimit -n {max(1024, needed)}` in the shell that starts it, or LimitNOFILE= in its systemd unit",
        )
    most = MOST_FILES if hard < 0 else min(hard, MOST_FILES)
    if 0 <= soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


def _used_bytes() -> int | None:
    """Memory of this process that the limit counts; None if the system does not report it."""
    with contextlib.suppress(OSError, StopIteration):
        lines = Path("/proc/self/status").read_text().splitlines()
        return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmData"))
    return None


def limit_memory(more_bytes: int) -> None:
    """Limits this process to this much more memory than it uses now; mapped files do not count."""
    used = _used_bytes()
    if resource and used is not None:
        hard = resource.getrlimit(resource.RLIMIT_DATA)[1]  # of the user or of a container: it stays
        most = used + more_bytes if hard < 0 else min(used + more_bytes, hard)
        resource.setrlimit(resource.RLIMIT_DATA, (most, hard))


class MemoryLimit:
    """A context in which this process may use only this much more memory than at its creation: larger allocations fail. Shared
    memory and mapped files do not count.
    """

    def __init__(self, more_bytes: int) -> None:
        used = _used_bytes()
        self._most = None if resource is None or used is None else used + more_bytes

    def __enter__(self) -> None:
        if self._most is not None:
            self._before = resource.getrlimit(resource.RLIMIT_DATA)
            soft, hard = self._most, self._before[1]
            resource.setrlimit(resource.RLIMIT_DATA, (soft if hard < 0 else min(soft, hard), hard))

    def __exit__(self, *_: object) -> None:
        if self._most is not None:
            resource.setrlimit(resource.RLIMIT_DATA, self._before)
