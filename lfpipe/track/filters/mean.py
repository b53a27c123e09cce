"""Filter "mean": the paper's moving average."""

from collections import deque

import numpy as np

from lfpipe.config import Track
from lfpipe.track.filters.base import EyeFilter, Points


class Mean(EyeFilter):
    """Moving average of the last k measurements, or of all if there are fewer. No prediction.

    The sum is computed afresh each time: a running sum would accumulate rounding errors and keep
    glitches forever.
    """

    restarts_after_loss = True

    def __init__(self, k: int) -> None:
        self._ring: deque[Points] = deque(maxlen=k)
        super().__init__()

    def _start(self, t_ns: int, measured: Points) -> None:
        self._ring.clear()
        self._ring.append(measured)

    def _step(self, t_ns: int, dt_s: float, measured: Points) -> tuple[Points, Points]:
        self._ring.append(measured)
        total: Points = sum(self._ring, np.zeros((2, 2)))
        return total / len(self._ring), np.zeros((2, 2))


def make(track: Track, device_latency_s: float) -> Mean:
    """Row "mean" of the table of filters."""
    return Mean(track.mean_k)
