"""The log: silent on the terminal unless asked (`-v`, `-vv`, LFPIPE_LOG); a session keeps the
newest lines in its run directory.

Every module logs to `logging.getLogger(__name__)` what a session decides, never what happens in
every frame.
"""

import contextlib
import logging
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from lfpipe.errors import UserError, plain, quoted

VARIABLE = "LFPIPE_LOG"
FILE = "session.log"
MAX_BYTES = 1 << 20  # of the file, and of its predecessor FILE.1: hours of a session at level info
LEVELS = ("debug", "info", "warning", "error")


class PlainFormatter(logging.Formatter):
    """Escapes control characters: a record may quote anything."""

    def format(self, record: logging.LogRecord) -> str:
        return plain(super().format(record), MAX_BYTES)


_ROOT = logging.getLogger("lfpipe")
_ROOT.addHandler(logging.NullHandler())
_FORMAT = PlainFormatter("%(asctime)s %(levelname)s %(processName)s %(name)s: %(message)s")


class SessionFile(logging.Handler):
    """Appends to a file that several processes write, and keeps it near MAX_BYTES: each line is one
    write at its end, and the process whose line crosses the limit renames it.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path = path
        self.setFormatter(_FORMAT)

    def emit(self, record: logging.LogRecord) -> None:
        """Writes a record; ignores a log that cannot be written."""
        with contextlib.suppress(Exception):
            data = (self.format(record) + "\n").encode(errors="backslashreplace")
            fd = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
            try:
                os.write(fd, data)
                end = os.lseek(fd, 0, os.SEEK_CUR)
            finally:
                os.close(fd)
            if end - len(data) < MAX_BYTES <= end:
                self.path.replace(self.path.with_name(f"{self.path.name}.1"))


def set_up(verbose: int = 0) -> None:
    """Logs to the terminal as LFPIPE_LOG says, or at level info with verbose = 1, debug with more;
    the same in every process that this one starts. Raises UserError for an invalid LFPIPE_LOG.
    """
    if verbose:
        os.environ[VARIABLE] = "info" if verbose == 1 else "debug"
    level = os.environ.get(VARIABLE, "").lower()
    if level and level not in LEVELS:
        raise UserError(f"{VARIABLE}={quoted(level)} is not a level", f"use {', '.join(LEVELS)}")
    _ROOT.setLevel((level or "info").upper())  # the file has what is decided, in any case
    _ROOT.propagate = False
    if level:
        handler = logging.StreamHandler(sys.stderr)
        handler.setFormatter(_FORMAT)
        _ROOT.addHandler(handler)


def is_shown() -> bool:
    """Whether the terminal shows the log: the user asked for details."""
    return bool(os.environ.get(VARIABLE))


@contextlib.contextmanager
def kept_in(run_dir: Path) -> Iterator[None]:
    """Logs to the session's file inside the block, also in a program that has not called
    `set_up`.
    """
    level = _ROOT.level
    if level == logging.NOTSET:
        _ROOT.setLevel(logging.INFO)
    handler = SessionFile(run_dir / FILE)
    _ROOT.addHandler(handler)
    try:
        yield
    finally:
        _ROOT.removeHandler(handler)
        _ROOT.setLevel(level)


def lines(run_dir: Path) -> bytes:
    """The log in a run directory. Raises OSError."""
    data = b""
    for path in (run_dir / f"{FILE}.1", run_dir / FILE):
        with contextlib.suppress(FileNotFoundError):
            data += path.read_bytes()
    return data


def last_file() -> Path:
    """Where the log of the session that ended last is kept."""
    import platformdirs

    return Path(platformdirs.user_state_dir("lfpipe")) / f"last_{FILE}"


def keep_last(run_dir: Path) -> None:
    """Stores the log of a session that ends, for a report; ignores one that cannot be written."""
    with contextlib.suppress(OSError):
        last_file().parent.mkdir(parents=True, exist_ok=True)
        last_file().write_bytes(lines(run_dir))
