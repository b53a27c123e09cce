"""The log: silent on the terminal unless asked (`-v`, `-vv`, LFPIPE_LOG); a session keeps the
newest lines of each of its processes in its run directory.

Every module logs to `logging.getLogger(__name__)` what a session decides, never what happens in
every frame.
"""

import contextlib
import logging
import multiprocessing
import os
import re
import sys
from collections.abc import Iterator
from logging.handlers import RotatingFileHandler
from pathlib import Path

from lfpipe.errors import UserError, plain, quoted

VARIABLE = "LFPIPE_LOG"
FILE = "session.log"
MAX_BYTES = 1 << 20  # of a process's file, and of its predecessor: hours at level info
TIME_BYTES = len("2026-11-28 12:00:00,000")
LEVELS = ("debug", "info", "warning", "error")


class PlainFormatter(logging.Formatter):
    """Escapes control characters: a record may quote anything."""

    def format(self, record: logging.LogRecord) -> str:
        return plain(super().format(record), MAX_BYTES)


_ROOT = logging.getLogger("lfpipe")
_ROOT.addHandler(logging.NullHandler())
_FORMAT = PlainFormatter("%(asctime)s %(levelname)s %(processName)s %(name)s: %(message)s")


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
    """Logs to the session's file inside the block."""
    logging.raiseExceptions = False  # a log that cannot be written ends nothing
    path = run_dir / f"{multiprocessing.current_process().name}.log"
    handler = RotatingFileHandler(
        path, maxBytes=MAX_BYTES, backupCount=1, delay=True, errors="backslashreplace"
    )
    handler.setFormatter(_FORMAT)
    _ROOT.addHandler(handler)
    try:
        yield
    finally:
        _ROOT.removeHandler(handler)
        handler.close()


def lines(run_dir: Path) -> bytes:
    """The logs of all processes in a run directory, in the order of their times. Raises OSError."""
    text = b"".join(path.read_bytes() for path in sorted(run_dir.glob("*.log*"), reverse=True))
    records = re.split(rb"(?m)^(?=\d{4}-\d\d-\d\d )", text)  # one may have several lines
    return b"".join(sorted(records, key=lambda record: bytes(record)[:TIME_BYTES]))


def last_file() -> Path:
    """Where the log of the session that ended last is kept."""
    import platformdirs

    return Path(platformdirs.user_state_dir("lfpipe")) / f"last_{FILE}"


def keep_last(run_dir: Path) -> None:
    """Stores the log of a session that ends, for a report; ignores one that cannot be written."""
    with contextlib.suppress(OSError):
        last_file().parent.mkdir(parents=True, exist_ok=True)
        last_file().write_bytes(lines(run_dir))
