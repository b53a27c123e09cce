"""The terminal: single keys, and native libraries kept from writing to it, past Python."""

import contextlib
import os
import select
import sys
import termios
import tty
from collections.abc import Iterator
from typing import Any, Self

OPENCV_SILENT, OPENCV_ERROR = 0, 2  # cv::utils::logging::LogLevel


class Keyboard:
    """Single keys, without waiting for Enter and without an echo. A context, which always restores
    the terminal; without a terminal on stdin there are no keys.
    """

    def __enter__(self) -> Self:
        self._fd = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else -1
        if self._fd >= 0:
            self._before = termios.tcgetattr(self._fd)
            tty.setcbreak(self._fd)
        return self

    def key(self, timeout_s: float) -> str:
        """The next key pressed within timeout_s, in lower case, or nothing."""
        fds = [self._fd] if self._fd >= 0 else []
        if not select.select(fds, [], [], max(timeout_s, 0.0))[0]:
            return ""
        data = os.read(self._fd, 1)
        # the terminal is gone, and nobody reads the output
        return data.decode(errors="ignore").lower() if data else "q"

    def __exit__(self, *_: object) -> None:
        if self._fd >= 0:
            termios.tcsetattr(self._fd, termios.TCSADRAIN, self._before)


@contextlib.contextmanager
def opencv_logging(level: int = OPENCV_SILENT) -> Iterator[None]:
    """Drops OpenCV's less severe messages in the whole process meanwhile: the error that follows
    reports the cause to the user.
    """
    import cv2

    utils: Any = cv2.utils
    log: Any = utils.logging if hasattr(utils, "logging") else cv2  # OpenCV 5, 4
    before = log.getLogLevel()
    log.setLogLevel(level)
    try:
        yield
    finally:
        log.setLogLevel(before)


def drop_output(fd: int) -> None:
    """Redirects a descriptor of this process to the null device."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, fd)
    os.close(null)


def open_standard_files() -> None:
    """Opens the null device for those of 0, 1 and 2 that are closed: otherwise the next opened file
    would become standard error, also of the children.
    """
    while (fd := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(fd, True)
    os.close(fd)


@contextlib.contextmanager
def quiet_stderr() -> Iterator[None]:
    """Drops output to stderr inside the block, also that of native code and of other threads: only
    for noisy moments (a network's start).
    """
    copy = os.dup(2)
    drop_output(2)
    try:
        yield
    finally:
        os.dup2(copy, 2)
        os.close(copy)
