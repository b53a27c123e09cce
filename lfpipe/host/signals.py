"""Signals: those of a terminal to all its processes, which only the supervisor handles, and those
between processes.
"""

import contextlib
import signal
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

END, KILL, LEAVE_STACK = signal.SIGTERM, signal.SIGKILL, signal.SIGUSR1
SENT_TWICE = (signal.SIGHUP,)  # the shell and the kernel both send it
TERMINAL = (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT)  # Ctrl-C, the window closed, Ctrl-\\


class Interrupted(KeyboardInterrupt):
    """A signal that ends the command as Ctrl-C does."""

    def __init__(self, signum: int) -> None:
        super().__init__(signal.strsignal(signum))
        self.signum = signum


def exit_code(error: BaseException | None) -> int:
    """That of a command which this has interrupted, as a shell reports it."""
    return 128 + (error.signum if isinstance(error, Interrupted) else signal.SIGINT)


def end_cleanly() -> None:
    """From now on, SIGTERM raises Interrupted: a command removes what it has begun."""

    def interrupt(signum: int, _frame: FrameType | None) -> None:
        raise Interrupted(signum)

    signal.signal(END, interrupt)


@contextlib.contextmanager
def blocked() -> Iterator[None]:
    """Processes started inside the block begin with these signals blocked."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, TERMINAL)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def ignore() -> None:
    """Ignores the signals, in a process that was started `blocked`."""
    for signum in TERMINAL:
        signal.signal(signum, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, TERMINAL)


@contextlib.contextmanager
def handled(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Calls handler for signals that end a session.

    A hang-up stays ignored if it was: a session started with nohup should outlive the terminal.
    """
    ends = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        ends.append(signal.SIGHUP)
    before: dict[signal.Signals, Any] = {signum: signal.signal(signum, handler) for signum in ends}
    try:
        yield
    finally:
        for signum, earlier in before.items():
            signal.signal(signum, earlier)
