"""The log level of OpenCV's own output, past Python, for OpenCV 4 and 5."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import cv2

SILENT, ERROR = 0, 2  # cv::utils::logging::LogLevel


def set_log_level(level: int) -> int:
    """Sets the level for the whole process; returns the previous one."""
    utils: Any = cv2.utils
    if hasattr(utils, "logging"):  # OpenCV 5
        before: int = utils.logging.setLogLevel(level)
        return before
    older: Any = cv2
    before = older.getLogLevel()
    older.setLogLevel(level)
    return before


@contextmanager
def silent() -> Iterator[None]:
    """Drops OpenCV's warnings: the error that follows reports the cause in the user's words."""
    before = set_log_level(SILENT)
    try:
        yield
    finally:
        set_log_level(before)
