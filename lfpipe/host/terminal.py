"""The terminal: single keys, and native libraries kept from writing to it, past Python."""

import contextlib
import os
import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from typing import Any

OPENCV_SILENT, OPENCV_ERROR = 0, 2  # cv::utils::logging::LogLevel


@contextlib.contextmanager
def keyboard() -> Iterator[Callable[[float], str]]:
    """Single keys, without waiting for Enter and without an echo: yields a function that returns
    the next key pressed within some seconds, in lower case, or nothing. Always restores the
    terminal; without a terminal on stdin there are no keys.
    """
    fds = [sys.stdin.fileno()] if sys.stdin is not None and sys.stdin.isatty() else []

    def key(timeout_s: float) -> str:
        if not select.select(fds, [], [], max(timeout_s, 0.0))[0]:
            return ""
        data = os.read(fds[0], 1)
        # the terminal is gone, and nobody reads the output
        return data.decode(errors="ignore").lower() if data else "q"

    before = [termios.tcgetattr(fd) for fd in fds]
    try:
        for fd in fds:
            tty.setcbreak(fd)
        yield key
    finally:
        for fd, settings in zip(fds, before, strict=True):
            termios.tcsetattr(fd, termios.TCSADRAIN, settings)


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
