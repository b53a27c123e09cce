"""Limits of the operating system, where it has such that a process can see and set."""

from __future__ import annotations

from lfpipe.errors import UserError

try:
    import resource
except ImportError:
    resource = None  # type: ignore[assignment]  # Windows: neither is limited

OPEN_FILES = 128  # a stage has about 30 open, the supervisor as many, and a reserve
MOST_FILES = 1 << 13  # more is of no use; macOS refuses more than OPEN_MAX


def allowed_files() -> int:
    """How many files this process may have open."""
    soft = resource.getrlimit(resource.RLIMIT_NOFILE)[0] if resource else -1
    return min(soft, MOST_FILES) if soft >= 0 else MOST_FILES


def limit_memory(more_bytes: int) -> None:
    """Nothing: what a process has is not known everywhere, and macOS does not keep to such a limit."""


def allow_files(needed: int = OPEN_FILES) -> None:
    """Lets this process and its children have as many files open as the hard limit allows.

    Raises UserError where that is fewer than needed.
    """
    if not resource:
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if 0 <= hard < needed:
        raise UserError(
            f"{hard} open files are allowed here (RLIMIT_NOFILE), a session needs {needed}",
            f"`ulimit -n {max(1024, needed)}` in the shell that starts it",
        )
    most = MOST_FILES if hard < 0 else min(hard, MOST_FILES)
    if 0 <= soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


class MemoryLimit:
    """A context without a limit, see `limit_memory`."""

    def __init__(self, more_bytes: int) -> None:
        del more_bytes

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        pass
