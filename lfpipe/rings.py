"""The shared memory of a running session, for other programs (docs/contracts.md).

All of it is part of the frozen contracts: `open_ring` opens a ring, `EYES` and `SHOWN` are the
records of two of them, and `run_dir` is where the sockets are.
"""

from pathlib import Path

from lfpipe.errors import UserError
from lfpipe.eyes import EYES, SHOWN
from lfpipe.supervisor.rundir import find
from lfpipe.transport.ring import Reader, Stamp, StampKind, now_ns

__all__ = [
    "EYES",
    "SHOWN",
    "Reader",
    "Stamp",
    "StampKind",
    "now_ns",
    "open_ring",
    "run_dir",
]


def open_ring(name: str, session: str = "default") -> Reader:
    """Opens a ring of a running session. It begins with the next slot that is published.

    Parameters
    ----------
    name : str
        "frames": uint8, shape (height, width, 3), BGR. "eyes": dtype `EYES`, shape (). "shown":
        dtype `SHOWN`, shape (). Or the name that a command returned.
    session : str
        As `lfpipe up --session`.

    Returns
    -------
    Reader

    Raises
    ------
    UserError
        If no session of that name runs, or if it has no such ring now.
    """
    try:
        return Reader(find(session).segment(name))
    except FileNotFoundError:
        raise UserError(
            f"session {session!r} has no ring {name!r} now",
            "see when it exists: docs/contracts.md",
        ) from None


def run_dir(session: str = "default") -> Path:
    """The run directory of a running session, which contains `ctl`, `tap` and `session.json`.

    Parameters
    ----------
    session : str
        As `lfpipe up --session`.

    Returns
    -------
    Path

    Raises
    ------
    UserError
        If no session of that name runs.
    """
    return find(session).run_dir
