"""Ends a process with its parent, however the parent ends."""

import contextlib
import multiprocessing
import os
import signal
import threading
from multiprocessing import connection

import psutil


def end_with_parent(parent_pid: int) -> bool:
    """Sends this process SIGTERM when its parent ends; on Windows ends it at once. Returns False if the parent has already ended.

    A thread reads the pipe that multiprocessing holds open in the parent until it ends. In other processes it waits for the
    parent itself.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_wait_for_end, args=(parent.sentinel,), name="parent", daemon=True).start()
    else:
        threading.Thread(target=_wait_for_process, args=(parent_pid,), name="parent", daemon=True).start()
    return os.getppid() == parent_pid


def _wait_for_end(sentinel: int) -> None:
    connection.wait([sentinel])
    os.kill(os.getpid(), signal.SIGTERM)


def _wait_for_process(pid: int) -> None:
    with contextlib.suppress(psutil.Error):
        psutil.Process(pid).wait()
    os.kill(os.getpid(), signal.SIGTERM)
