"""Signals: those of a terminal to all processes in it, on which the supervisor alone acts, and those between processes."""

from __future__ import annotations

import contextlib
import faulthandler
import os
import signal
from collections.abc import Callable, Iterator
from multiprocessing import resource_tracker
from types import FrameType
from typing import IO, Any

END, KILL = signal.SIGTERM, signal.SIGKILL
SENT_TWICE = (signal.SIGHUP,)  # the shell and the kernel both send it
TERMINAL = (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT)  # Ctrl-C, the window closed, Ctrl-\


@contextlib.contextmanager
def blocked() -> Iterator[None]:
    """Processes that start within begin with these signals blocked: none dies of one before it can ignore it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, TERMINAL)
    try:
        resource_tracker.ensure_running()  # ends with SIGINT unblocked
        signal.pthread_sigmask(signal.SIG_BLOCK, TERMINAL)
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def ignore() -> None:
    """In a process that started `blocked`."""
    for signum in TERMINAL:
        signal.signal(signum, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, TERMINAL)


def handle(handler: Callable[[int, FrameType | None], None]) -> dict[signal.Signals, Any]:
    """Has handler called for what ends a session; returns what was in force before, for `restore`.

    SIGHUP stays ignored where it was: who started the session with nohup wants it to outlive the terminal.
    """
    with blocked():
        pass  # multiprocessing's resource tracker starts out of the terminal's reach
    ends = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        ends.append(signal.SIGHUP)
    return {signum: signal.signal(signum, handler) for signum in ends}


def restore(before: dict[signal.Signals, Any]) -> None:
    """Puts back what `handle` found."""
    for signum, handler in before.items():
        signal.signal(signum, handler)


def send(pid: int, signum: int) -> None:
    """Sends END or KILL. Raises OSError where the process is gone."""
    os.kill(pid, signum)


def leave_stack_on_request(file: IO[str]) -> None:
    """Has this process write the stacks of its threads to file when `ask_for_stack` is called with its number."""
    faulthandler.register(signal.SIGUSR1, file)


def ask_for_stack(pid: int) -> None:
    """Asks a process for its stacks. Raises OSError where it is gone."""
    os.kill(pid, signal.SIGUSR1)
