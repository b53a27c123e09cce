"""Outlier gate: discards frames whose landmarks jump further than a head can move.

One frame that is off by 0.58 eye distances moves the picture by 0.04 views instead of 2.32 (table
of bad frames in profiling/results/eyes.md).
"""

import math

from lfpipe.eyes import low_pass_gain
from lfpipe.track.filters.base import Vector

# Heads are no further from their prediction than this, in eye distances: 20 m/s^2, and twice the
# worst of 17 real heads.
MAX_DEVIATION, MAX_DEVIATION_S2 = 0.12, 158.0
# A head that shakes at 17 eye distances per second exceeds it in one frame of ten. In that case,
# the low-passed deviation of the last frames raises the limit.
USUAL_WEIGHT, USUAL_S = 2.0, 0.3


class OutlierGate:
    """Discards a jump, unless two successive frames show it: outliers last one frame."""

    def __init__(self) -> None:
        self._rejected: Vector | None = None
        self._usual_px = 0.0  # deviation of the last frames, low-passed

    def rejects(
        self,
        midpoint: Vector,
        predicted: Vector,
        deviation_px: float,
        eye_distance_px: float,
        since_s: float,
    ) -> bool:
        """Whether a frame is an outlier.

        midpoint, predicted: of the eyes, px. deviation_px: of the worse eye from its prediction.
        since_s: since the last frame that was accepted.
        """
        limit = (MAX_DEVIATION + MAX_DEVIATION_S2 * since_s * since_s) * eye_distance_px
        limit += USUAL_WEIGHT * self._usual_px
        self._usual_px += low_pass_gain(since_s, USUAL_S) * (deviation_px - self._usual_px)
        rejected = deviation_px > limit and not self._is_repeated_jump(midpoint, predicted)
        self._rejected = midpoint if rejected else None
        return rejected

    def _is_repeated_jump(self, midpoint: Vector, predicted: Vector) -> bool:
        """Whether the frame is nearer to the rejected one before it than to its prediction."""
        if self._rejected is None:
            return False
        return math.dist(midpoint, self._rejected) < math.dist(midpoint, predicted)
