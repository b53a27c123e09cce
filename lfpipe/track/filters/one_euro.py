"""Filter "one-euro": a low-pass whose cutoff rises with speed (Casiez et al., CHI 2012)."""

import math

import numpy as np

from lfpipe.config import Track
from lfpipe.eyes import low_pass_gain
from lfpipe.track.filters.base import EyeFilter, Points


class OneEuro(EyeFilter):
    """cutoff = min_cutoff_hz + beta * speed. No prediction.

    The speed of both eyes together, in eye distances per second, is itself low-passed at
    d_cutoff_hz.
    """

    def __init__(self, min_cutoff_hz: float, beta: float, d_cutoff_hz: float) -> None:
        self._min_cutoff_hz, self._beta, self._d_cutoff_hz = min_cutoff_hz, beta, d_cutoff_hz
        super().__init__()

    def _start(self, t_ns: int, measured: Points) -> None:
        self._last = measured
        self._slope = np.zeros((2, 2))

    def _step(self, t_ns: int, dt_s: float, measured: Points) -> tuple[Points, Points]:
        slope = (measured - self._last) / dt_s
        self._last = measured
        self._slope = _blended(self._slope, slope, dt_s, self._d_cutoff_hz)
        cutoff_hz = self._min_cutoff_hz + self._beta * _speed(self._slope, measured)
        return _blended(self._position, measured, dt_s, cutoff_hz), np.zeros((2, 2))


def _blended(old: Points, new: Points, dt_s: float, cutoff_hz: float) -> Points:
    """One step of a low-pass, always between old and new, despite rounding."""
    step = low_pass_gain(2 * math.pi * cutoff_hz * dt_s, 1.0) * (new - old)
    return np.clip(old + step, np.minimum(old, new), np.maximum(old, new))


def _speed(velocity_px_s: Points, eyes_px: Points) -> float:
    """Speed of the head in eye distances per second, both (2, 2); the eye distance counts as at
    least one pixel.
    """
    eye_distance_px = max(float(np.hypot(*(eyes_px[0] - eyes_px[1]))), 1.0)
    return math.sqrt(float(np.square(velocity_px_s).sum()) / 2) / eye_distance_px


def make(track: Track, device_latency_s: float) -> OneEuro:
    """Row "one-euro" of the table of filters."""
    return OneEuro(min_cutoff_hz=1.0, beta=2.0, d_cutoff_hz=4.0)
