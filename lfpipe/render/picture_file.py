"""One picture as a file: whole, or not there."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray


def save(path: Path, picture: NDArray[np.uint8]) -> str:
    """Writes picture, uint8 (height, width, 3) BGR, as the PNG path; returns what to report. An existing file stays until the
    new one is whole.
    """
    done, data = cv2.imencode(".png", picture)
    assert done, "a uint8 picture is always a PNG"
    new = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        new.write_bytes(data.tobytes())
        new.replace(path)
    except OSError as error:
        new.unlink(missing_ok=True)
        return f"{path}: the picture is not saved: {error.strerror}"
    return f"picture saved as {path}"
