"""How much OpenCV prints by itself, past Python, under the name that this OpenCV gives to it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import cv2

SILENT, ERROR = 0, 2  # cv::utils::logging::LogLevel


def set_log_level(level: int) -> int:
    """Sets the level for the whole process and returns the one before."""
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
    """OpenCV's warnings are dropped: an error that follows says it in the user's words."""
    before = set_log_level(SILENT)
    try:
        yield
    finally:
        set_log_level(before)
