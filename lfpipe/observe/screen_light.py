"""The light of a screen that flips between black and white, seen by a camera: integrals over exposures in closed form."""

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]


class ScreenLight:
    """The screen's light over time, 0..1, integrated exactly. tau_ms: of the pixels' exponential response."""

    def __init__(self, flips_ms: Float, bright: NDArray[np.bool_], tau_ms: float) -> None:
        self._flips_ms, self._goal, self._tau_ms = flips_ms, bright.astype(float), tau_ms
        gaps = np.diff(flips_ms)
        decay = np.exp(-gaps / tau_ms)
        above = np.empty(len(flips_ms))  # light above its goal at each flip
        above[0] = 1.0 - 2.0 * self._goal[0]
        for j in range(len(gaps)):
            above[j + 1] = self._goal[j] + above[j] * decay[j] - self._goal[j + 1]
        self._above = above
        steps = self._goal[:-1] * gaps + above[:-1] * tau_ms * (1 - decay)
        self._sum = np.concatenate([[0.0], np.cumsum(steps)])

    def integral(self, t_ms: Float) -> Float:
        at = np.clip(np.searchsorted(self._flips_ms, t_ms, "right") - 1, 0, None)
        since = np.maximum(t_ms - self._flips_ms[at], 0.0)
        fading = self._tau_ms * -np.expm1(-since / self._tau_ms)
        return np.asarray(self._sum[at] + self._goal[at] * since + self._above[at] * fading)

    def mean(self, t_ms: Float, width_ms: float) -> Float:
        """The mean light within width_ms around each of t_ms."""
        return (self.integral(t_ms + width_ms / 2) - self.integral(t_ms - width_ms / 2)) / width_ms
