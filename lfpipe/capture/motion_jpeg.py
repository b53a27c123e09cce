"""A video whose packets are JPEGs: taken apart by FFmpeg, decoded as a camera's JPEGs are, and handed on as they stand."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.files.decoding import fitted, retrieved_jpeg


class MotionJpeg:
    """A `Recording`. Measured at 640x480: 1.15 ms a frame, as with FFmpeg's own decoder.

    packet: see `Recording`.
    """

    def __init__(self, capture: cv2.VideoCapture, path: Path) -> None:
        """capture: opened. Raises ValueError where its packets are no JPEGs of the size that it tells."""
        self._capture, self._path = capture, path
        self.width_px = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        self.height_px = int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        rate_hz = float(capture.get(cv2.CAP_PROP_FPS))
        self.rate_hz = rate_hz if 0.01 <= rate_hz < 1e6 else 0.0
        self.packet: NDArray[np.uint8] | None = None
        self._ready: tuple[int, NDArray[np.uint8]] | None = None
        if capture.get(cv2.CAP_PROP_FOURCC) == cv2.VideoWriter.fourcc(*"MJPG") and capture.set(cv2.CAP_PROP_FORMAT, -1):
            self._ready = self._decode_next()
        if self.packet is None:
            raise ValueError(f"{path}: no Motion JPEG, or two half pictures a packet")

    def _decode_next(self) -> tuple[int, NDArray[np.uint8]] | None:
        """Stamp in ns and picture of the next packet that is one (an AVI has empty ones); None at the end."""
        while self._capture.grab():
            stamp_ns = round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
            if found := retrieved_jpeg(self._capture):
                packet, picture = found
                self.packet = packet if picture.shape == (self.height_px, self.width_px, 3) else None
                return stamp_ns, picture
        return None

    def next(self, out: NDArray[np.uint8]) -> int | None:
        """See `Recording.next`."""
        found, self._ready = self._ready or self._decode_next(), None
        if found is None:
            return None
        stamp_ns, picture = found
        fitted(picture, out)
        return stamp_ns

    def rewind(self) -> None:
        self._capture.set(cv2.CAP_PROP_POS_FRAMES, 0)
        self._ready = self._decode_next()
        if self._ready is None:  # a stream that cannot seek is opened anew
            self._capture.open(str(self._path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
            self._capture.set(cv2.CAP_PROP_FORMAT, -1)

    def close(self) -> None:
        self._capture.release()
