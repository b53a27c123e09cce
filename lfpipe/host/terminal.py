"""The terminal: single keys, output that survives its end, and native libraries kept from writing to it, past Python."""

import contextlib
import importlib
import io
import os
import select
import sys
import tempfile
import time
from collections.abc import Iterator
from types import TracebackType
from typing import Any, Self

from lfpipe.host import WINDOWS

_POLL_S = 0.02  # between looks at Windows's console: not felt by a person
OPENCV_SILENT, OPENCV_ERROR = 0, 2  # cv::utils::logging::LogLevel


class Keyboard:
    """Single keys, without waiting for Enter and without an echo. A context, which always restores the terminal; without a
    terminal on stdin there are no keys."""

    def __enter__(self) -> Self:
        self._fd = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else -1
        self._system: Any = importlib.import_module("msvcrt" if WINDOWS else "termios") if self._fd >= 0 else None
        if self._system and not WINDOWS:
            self._before = self._system.tcgetattr(self._fd)
            importlib.import_module("tty").setcbreak(self._fd)
        return self

    def key(self, timeout_s: float) -> str:
        """The next key pressed within timeout_s, in lower case, or nothing."""
        if not self._system:
            time.sleep(max(timeout_s, 0.0))
            return ""
        if WINDOWS:
            end_s = time.monotonic() + timeout_s
            while not self._system.kbhit():
                if time.monotonic() >= end_s:
                    return ""
                time.sleep(_POLL_S)
            return str(self._system.getwch()).lower()
        if not select.select([self._fd], [], [], max(timeout_s, 0.0))[0]:
            return ""
        data = os.read(self._fd, 1)
        return data.decode(errors="ignore").lower() if data else "q"  # the terminal is gone, and nobody reads the output

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._system and not WINDOWS:
            self._system.tcsetattr(self._fd, self._system.TCSADRAIN, self._before)


class _Forgiving(io.RawIOBase):
    """Writes to a descriptor; drops output that it does not accept instead of raising."""

    def __init__(self, fd: int) -> None:
        self._fd = fd

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._fd

    def isatty(self) -> bool:
        return os.isatty(self._fd)

    def write(self, data: Any) -> int:
        try:
            return os.write(self._fd, data)
        except OSError:  # EIO: the terminal is closed; EPIPE: the reader has ended; ENOSPC: the disk is full
            return len(data)


def protect_output(*names: str) -> None:
    """Makes the named ones of sys.stdout and sys.stderr drop output instead of raising. Redirected streams (a test's) stay.

    Opens /dev/null for those of 0, 1 and 2 that are closed: otherwise the next opened file would become standard error.
    """
    while (fd := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(fd, True)
    os.close(fd)
    for name in names:
        fd = {"stdout": 1, "stderr": 2}[name]
        stream = getattr(sys, name)
        if stream is None:  # it was closed when Python started
            encoding, errors = "utf-8", "backslashreplace"
        elif isinstance(stream, io.TextIOWrapper) and _descriptor(stream) == fd:
            stream.flush()
            encoding, errors = stream.encoding, stream.errors or "strict"
        else:
            continue
        lines = name == "stderr" or os.isatty(fd)
        setattr(sys, name, io.TextIOWrapper(io.BufferedWriter(_Forgiving(fd)), encoding, errors, line_buffering=lines))


def _descriptor(stream: io.TextIOWrapper) -> int:
    try:
        return stream.fileno()
    except (OSError, ValueError):
        return -1


@contextlib.contextmanager
def opencv_logging(level: int = OPENCV_SILENT) -> Iterator[None]:
    """Drops OpenCV's less severe messages in the whole process meanwhile: the error that follows reports the cause in the user's
    words."""
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
