"""Keeps what native libraries write, past Python, off the user's terminal."""

import contextlib
import os
import sys
import tempfile
from collections.abc import Iterator
from typing import Any

import cv2

SILENT, ERROR = 0, 2  # cv::utils::logging::LogLevel


def set_log_level(level: int) -> int:
    """Sets the level of OpenCV 4 or 5 for the whole process; returns the previous one."""
    utils: Any = cv2.utils
    if hasattr(utils, "logging"):  # OpenCV 5
        before: int = utils.logging.setLogLevel(level)
        return before
    older: Any = cv2
    before = older.getLogLevel()
    older.setLogLevel(level)
    return before


@contextlib.contextmanager
def silent() -> Iterator[None]:
    """Drops OpenCV's warnings: the error that follows reports the cause in the user's words."""
    before = set_log_level(SILENT)
    try:
        yield
    finally:
        set_log_level(before)


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
