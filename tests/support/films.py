"""Films for tests."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
from numpy.typing import NDArray


def write_film(
    path: Path,
    frames: Iterable[NDArray[Any]],
    codec: str = "MJPG",
    rate_hz: float = 30.0,
    backend: int = cv2.CAP_ANY,
) -> Path:
    """A video of BGR frames; returns its path."""
    first, *others = frames
    fourcc = cv2.VideoWriter.fourcc(*codec)
    writer = cv2.VideoWriter(str(path), backend, fourcc, rate_hz, first.shape[1::-1])
    for frame in (first, *others):
        writer.write(frame)
    writer.release()
    return path
