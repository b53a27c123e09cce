"""The shared memory of a running session, for other programs (docs/contracts.md).

All of it is part of the frozen contracts: `open_ring` opens a ring, `EYES` and `SHOWN` are the
records of two of them, and `run_dir` is where the sockets are.
"""

import contextlib
from pathlib import Path
from typing import Self

from lfpipe.errors import UserError
from lfpipe.eyes import EYES, SHOWN
from lfpipe.host.wake import Wake, readable
from lfpipe.supervisor.rundir import find
from lfpipe.transport.clock import now_ns
from lfpipe.transport.control import Client
from lfpipe.transport.ring import Reader, Stamp, StampKind

__all__ = [
    "EYES",
    "SHOWN",
    "Reader",
    "Stamp",
    "StampKind",
    "Wakes",
    "now_ns",
    "open_ring",
    "run_dir",
]
ANSWER_S = 3.0  # the stages apply a change within 1 s


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


class Wakes:
    """Wakes this program when a ring has a new slot, without polling. It holds a connection to the
    session, and ends with it: with the block, with `close`, or with this program.

    Parameters
    ----------
    ring : str
        "frames", "eyes", or "shown" while something reads it.
    session : str
        As `lfpipe up --session`.

    Raises
    ------
    UserError
        If no session of that name runs, if it has no such ring, or if it wakes 8 programs already.
    """

    def __init__(self, ring: str, session: str = "default") -> None:
        place = find(session).run_dir
        with contextlib.ExitStack() as parts:
            client = parts.enter_context(contextlib.closing(Client(place)))
            answer = client.request({"cmd": "wake", "ring": ring}, ANSWER_S)
            self._wake = parts.enter_context(contextlib.closing(Wake(place / answer["fifo"])))
            self._parts = parts.pop_all()

    def fileno(self) -> int:
        """The descriptor of the FIFO, for `select` and event loops; empty it with `wait(0)`."""
        return self._wake.fd

    def wait(self, timeout_s: float) -> bool:
        """Sleeps until a slot was published since the last call.

        Parameters
        ----------
        timeout_s : float

        Returns
        -------
        bool
            False after timeout_s; the session may have ended.
        """
        if not readable([self._wake.fd], timeout_s):
            return False
        self._wake.drain()
        return True

    def close(self) -> None:
        """Ends the wake-ups. May be called again."""
        self._parts.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


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
