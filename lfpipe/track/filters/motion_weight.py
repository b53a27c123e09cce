"""Separates motion from noise in a change of position.

Without it a still head steps from picture to picture (column `step` of profiling/results/eyes.md).
"""

import math

from lfpipe.eyes import low_pass_gain
from lfpipe.track.filters.base import Vector
from lfpipe.track.filters.noise import RATE_HZ

MOTION_BAND = 9.0  # motion below so many standard deviations counts as noise
# Motion is the larger of DRIFT times the way from the position low-passed over DRIFT_S, and of the
# speed over one frame at RATE_HZ.
DRIFT, DRIFT_S = 0.6, 0.13


class MotionWeight:
    """Weight of a velocity, 0 to 1: the fourth power of motion relative to that of noise."""

    def __init__(self, position: Vector) -> None:
        self._low_passed = position

    def update(self, position: Vector, velocity: Vector, variance: float, dt_s: float) -> float:
        """The weight at a position (px) and velocity (px/s); variance: of the half distance."""
        (x, y), (u, v) = self._low_passed, velocity
        dx, dy = position[0] - x, position[1] - y
        gain = low_pass_gain(dt_s, DRIFT_S)
        self._low_passed = x + gain * dx, y + gain * dy
        motion = max((dx * dx + dy * dy) * DRIFT**2, (u * u + v * v) / RATE_HZ**2)
        noise = MOTION_BAND**2 * variance
        return motion * motion / max(motion * motion + noise * noise, 1e-300)


def eye_distance_of(half: Vector) -> float:
    """Eye distance of a half distance, px; at least 1."""
    return max(2 * math.hypot(*half), 1.0)
