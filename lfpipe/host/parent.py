"""The end of a process with its parent, however the parent ends."""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import os
import signal
import threading
from multiprocessing import connection

PR_SET_PDEATHSIG = 1


def end_with_parent(parent_pid: int) -> bool:
    """Has this process get SIGTERM when its parent ends. False where it has ended already.

    A thread reads the pipe that multiprocessing holds open in the parent, to its end. Where the kernel can, it sends the signal
    as well: at once, and to a process whose threads do not run.
    """
    with contextlib.suppress(AttributeError, OSError):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_wait_for_end, args=(parent.sentinel,), name="parent", daemon=True).start()
    return os.getppid() == parent_pid


def _wait_for_end(sentinel: int) -> None:
    connection.wait([sentinel])
    os.kill(os.getpid(), signal.SIGTERM)
