"""Growth limit: a velocity grows only as far as the innovations of two frames support it.

Wrong landmarks in one frame would otherwise be predicted ahead: one frame off by 0.12 eye distances
moves the picture after 80 ms by 0.85 instead of 1.32 views (table of bad frames in
profiling/results/eyes.md).
"""

import math

from lfpipe.track.filters.base import Vector

# Gains of the permitted growth: of this frame's innovation, of its part that the last innovation
# confirms, and of growth that continues that of the last frame.
GAIN_SINGLE, GAIN_REPEATED, GAIN_GROWTH = 0.7, 0.9, 1.5


class GrowthLimit:
    """Limits the growth of the velocity. prediction_s: the time that predictions cover."""

    def __init__(self, prediction_s: float) -> None:
        self._prediction_s = prediction_s
        self.velocity = self._innovation = self._growth = (
            0.0,
            0.0,
        )  # velocity: the last one reported

    def limit(self, velocity: Vector, innovation: Vector, dt_s: float) -> Vector:
        """The velocity (px/s) to report; decreases are accepted at once.

        innovation: measured minus predicted midpoint, px. dt_s: since the last frame used.
        """
        (u, v), (dx, dy), (last_x, last_y) = velocity, innovation, self._innovation
        self._innovation = innovation
        size = math.hypot(dx, dy)
        repeated = max(dx * last_x + dy * last_y, 0.0) / size if size > 0 else 0.0
        limit = GAIN_SINGLE * size / self._prediction_s + GAIN_REPEATED * repeated / dt_s
        old_u, old_v = self.velocity
        square = old_u * old_u + old_v * old_v
        kept = min(max((u * old_u + v * old_v) / square, 0.0), 1.0) if square > 0 else 0.0
        old_u, old_v = kept * old_u, kept * old_v
        du, dv = u - old_u, v - old_v
        last_du, last_dv = self._growth
        self._growth = du, dv
        growth = math.hypot(du, dv)
        if growth > 0:
            limit += GAIN_GROWTH * max(du * last_du + dv * last_dv, 0.0) / growth
        share = limit / growth if growth > limit else 1.0
        self.velocity = old_u + share * du, old_v + share * dv
        return self.velocity
