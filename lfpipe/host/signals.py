"""Signals, as far as the system has them: those of a terminal to all its processes, which only the supervisor handles, and those
between processes. Windows has Ctrl-C and process termination.
"""

import contextlib
import faulthandler
import os
import signal
from collections.abc import Callable, Iterator
from types import FrameType
from typing import IO, Any

END = signal.SIGTERM
KILL = getattr(signal, "SIGKILL", signal.SIGTERM)  # on Windows SIGTERM ends a process at once
_HANGUP = getattr(signal, "SIGHUP", None)
_STACK = getattr(signal, "SIGUSR1", None)
SENT_TWICE = tuple(filter(None, (_HANGUP,)))  # the shell and the kernel both send it
# Ctrl-C, the window closed, Ctrl-\, Ctrl-Break
TERMINAL = tuple(filter(None, (signal.SIGINT, _HANGUP, getattr(signal, "SIGQUIT", None), getattr(signal, "SIGBREAK", None))))


@contextlib.contextmanager
def blocked() -> Iterator[None]:
    """Processes started inside the block begin with these signals blocked, if the system can block signals."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    before = signal.pthread_sigmask(signal.SIG_BLOCK, TERMINAL)
    try:
        resource_tracker.ensure_running()  # ends with SIGINT unblocked
        signal.pthread_sigmask(signal.SIG_BLOCK, TERMINAL)
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def ignore() -> None:
    """Ignores the signals, in a process that was started `blocked`."""
    for signum in TERMINAL:
        signal.signal(signum, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, TERMINAL)


@contextlib.contextmanager
def handled(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Calls handler for signals that end a session.

    A hang-up stays ignored if it was: a session started with nohup should outlive the terminal.
    """
    with blocked():
        pass  # multiprocessing's resource tracker starts outside the terminal's session
    ends = [signal.SIGINT, signal.SIGTERM]
    if _HANGUP is not None and signal.getsignal(_HANGUP) != signal.SIG_IGN:
        ends.append(_HANGUP)
    before: dict[signal.Signals, Any] = {signum: signal.signal(signum, handler) for signum in ends}
    try:
        yield
    finally:
        for signum, earlier in before.items():
            signal.signal(signum, earlier)


def leave_stack_on_request(file: IO[str]) -> None:
    """Makes this process write the stacks of its threads to file when `ask_for_stack` is called with its pid."""
    if _STACK is not None:
        faulthandler.register(_STACK, file)


def ask_for_stack(pid: int) -> None:
    """Requests the stacks of a process, if the system can. Raises OSError if it is gone."""
    if _STACK is not None:
        os.kill(pid, _STACK)
