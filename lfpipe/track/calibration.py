"""The camera's focal length from an object of known size at a known distance: the viewer's eyes, or a bank card."""

from collections import deque

import numpy as np

from lfpipe.track.engine import Face

FRAMES = 45  # frames per measurement
SPREAD = 0.05  # the viewer has moved if the quartiles differ by more than this share of the median


class EyeGauge:
    """Distance between the eyes in px over the last FRAMES frames with a face: median and spread."""

    def __init__(self) -> None:
        self._apart_px: deque[float] = deque(maxlen=FRAMES)

    def add(self, face: Face | None) -> None:
        """Adds a frame's face; ignores a frame without one."""
        if face is not None:
            self._apart_px.append(float(np.hypot(*(face.eyes_px[0] - face.eyes_px[1]))))

    @property
    def full(self) -> bool:
        """Whether FRAMES frames are collected."""
        return len(self._apart_px) == FRAMES

    @property
    def median_px(self) -> float:
        """0 before the first face."""
        return float(np.median(self._apart_px)) if self._apart_px else 0.0

    @property
    def steady(self) -> bool:
        """Whether the viewer kept still enough for a reliable median."""
        low, middle, high = np.percentile(self._apart_px, [25, 50, 75]) if self._apart_px else (0.0, 0.0, 1.0)
        return bool(high - low <= SPREAD * middle)
