"""Ends a process with its parent, however the parent ends."""

import contextlib
import ctypes
import multiprocessing
import os
import signal
import threading
from multiprocessing import connection

PR_SET_PDEATHSIG = 1


def end_with_parent(parent_pid: int) -> bool:
    """Sends this process SIGTERM when its parent ends. Returns False if the parent has already ended.

    A thread reads the pipe that multiprocessing holds open in the parent until it ends. On Linux, the kernel sends the signal
    too: at once, and even to a process whose threads do not run.
    """
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_wait_for_end, args=(parent.sentinel,), name="parent", daemon=True).start()
    return os.getppid() == parent_pid


def _wait_for_end(sentinel: int) -> None:
    connection.wait([sentinel])
    os.kill(os.getpid(), signal.SIGTERM)
