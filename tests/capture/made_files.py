"""Recordings for the tests of capture."""

from pathlib import Path

import cv2
import numpy as np

from lfpipe import config
from tests.support.films import write_film

SIZE = (64, 48)
SHAPE = (SIZE[1], SIZE[0], 3)
CAMERA = config.Camera(width_px=SIZE[0], height_px=SIZE[1], rate_hz=50.0)
RATE_HZ = 25.0  # of videos


def flat(index: int) -> np.ndarray:
    """A frame that encodes its number: its grey is 10 * index + 5."""
    return np.full(SHAPE, 10 * index + 5, np.uint8)


def noise(index: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """A unique frame."""
    return np.random.default_rng(index).integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)


def jpeg(index: int, size: tuple[int, int] = SIZE) -> bytes:
    """A unique frame as a JPEG."""
    return cv2.imencode(
        ".jpg",
        cv2.GaussianBlur(noise(index, size), (5, 5), 0),
        [cv2.IMWRITE_JPEG_QUALITY, 70 + index],
    )[1].tobytes()


def seen(packet: bytes) -> np.ndarray:
    picture = cv2.imdecode(np.frombuffer(packet, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return picture


def video(path: Path, fourcc: str, frames: list[np.ndarray]) -> Path:
    """Motion JPEG is written by OpenCV itself, whose packets are those of a camera."""
    backend = cv2.CAP_OPENCV_MJPEG if fourcc == "MJPG" else cv2.CAP_ANY
    return write_film(path, frames, fourcc, RATE_HZ, backend)
