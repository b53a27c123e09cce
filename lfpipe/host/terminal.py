"""The terminal: single keys, output that survives its end, and native libraries kept from writing
to it, past Python.
"""

import contextlib
import io
import os
import select
import sys
import tempfile
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


class _Forgiving(io.FileIO):
    """Drops output that its descriptor does not accept instead of raising. patience_s: time for a
    reader; None for any.
    """

    def __init__(self, fd: int, patience_s: float | None) -> None:
        super().__init__(fd, "w", closefd=False)
        self._patience_s = self._left_s = patience_s

    def write(self, data: Any) -> int:
        try:
            if self._patience_s is not None:
                ready = select.select([], [self], [], self._left_s)[1]
                # once: a reader that has stopped delays nothing else
                self._left_s = self._patience_s if ready else 0.0
                if not ready:
                    return len(data)
                data = data[: select.PIPE_BUF]  # what a pipe that is ready takes at once
            return os.write(self.fileno(), data)
        # EIO: the terminal is closed; EPIPE: the reader has ended; ENOSPC: the disk is full
        except OSError:
            return len(data)


def protect_output(*names: str, patience_s: float | None = None) -> None:
    """Makes the named ones of sys.stdout and sys.stderr drop output instead of raising, and after
    patience_s without a reader instead of waiting. Redirected streams (a test's) stay.

    Opens /dev/null for those of 0, 1 and 2 that are closed: otherwise the next opened file would
    become standard error.
    """
    while (fd := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(fd, True)
    os.close(fd)
    for name in names:
        fd = {"stdout": 1, "stderr": 2}[name]
        stream = getattr(sys, name)
        encoding, errors = "utf-8", "backslashreplace"
        if stream is not None:  # else it was closed when Python started
            try:
                if stream.fileno() != fd:
                    continue
            except (OSError, ValueError):
                continue
            stream.flush()
            encoding = stream.encoding
            errors = stream.errors or "strict"
        lines = name == "stderr" or os.isatty(fd)
        forgiving = io.BufferedWriter(_Forgiving(fd, patience_s))
        setattr(sys, name, io.TextIOWrapper(forgiving, encoding, errors, line_buffering=lines))


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


@contextlib.contextmanager
def quiet_stderr() -> Iterator[None]:
    """Drops output of native code to stderr inside the block; shows it if the block raises.

    Only for noisy moments (a network's start): it also drops what other threads write.
    """
    sys.stderr.flush()
    kept = os.dup(2)
    with tempfile.TemporaryFile() as sink:
        os.dup2(sink.fileno(), 2)
        try:
            yield
        except BaseException:
            os.dup2(kept, 2)
            sink.seek(0)
            os.write(2, sink.read())
            raise
        finally:
            os.dup2(kept, 2)
            os.close(kept)
