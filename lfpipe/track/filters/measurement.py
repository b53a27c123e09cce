"""What a measurement of the eyes is worth: its noise, outliers, the half distance of the eyes, and
whether a change of position is motion.
"""

import math

from lfpipe.eyes import low_pass_gain
from lfpipe.track.filters.base import Vector

# Measurement noise of the landmarks, estimated while the filter runs.
#
# The estimate uses third differences of the half distance, in which head motion cancels. A fixed
# noise would fit either bright or dark pictures only: still heads would tremble, or moving heads
# lag (profiling/results/eyes.md).

RATE_HZ = 30.0  # frame rate of the recordings that the constants were chosen on
FIRST_NOISE, MIN_NOISE = 1.5e-3, 1e-3  # initial and smallest deviation, in eye distances
NOISE_S = 2.6  # time constant of the estimate
MIDPOINT_NOISE = 2.2  # of the midpoint of the eyes, divided by that of their half distance
# MIDPOINT_NOISE grows with this power of the frame rate above RATE_HZ: there, each picture shows
# a new measurement, and steps between them are visible.
RATE_POWER = 0.2
# Noise of a moving midpoint, divided by its speed: stamps and exposures are not exact.
BLUR_S = 0.0035


class MeasurementNoise:
    """Variance of the half distance, px^2, and of the midpoint that follows from it."""

    def __init__(self, half: Vector, eye_distance_px: float) -> None:
        self._halves = [half]
        self.variance = (FIRST_NOISE * eye_distance_px) ** 2

    @property
    def midpoint_variance(self) -> float:
        """Of the midpoint of a head at rest at RATE_HZ, px^2."""
        return self.variance * MIDPOINT_NOISE**2

    def update(self, half: Vector, eye_distance_px: float, dt_s: float) -> None:
        """Adds a half distance, px.

        The variance of a third difference is 20 times that of its input. A glitch counts as at
        most three standard deviations.
        """
        halves = self._halves
        halves.append(half)
        if len(halves) < 4:
            return
        (x0, y0), (x1, y1), (x2, y2), (x3, y3) = halves
        del halves[0]
        variance = ((x3 - 3 * x2 + 3 * x1 - x0) ** 2 + (y3 - 3 * y2 + 3 * y1 - y0) ** 2) / 40
        self.variance += (min(variance, 9 * self.variance) - self.variance) * min(
            dt_s / NOISE_S, 1.0
        )
        self.variance = max(self.variance, (MIN_NOISE * eye_distance_px) ** 2)

    def of_midpoint(self, dt_s: float, velocity: Vector) -> float:
        """Variance of a measured midpoint dt_s after the last one, px^2, at a velocity in px/s."""
        u, v = velocity
        at_rest: float = self.midpoint_variance * max(1 / (RATE_HZ * dt_s), 1.0) ** (2 * RATE_POWER)
        return at_rest + (u * u + v * v) * BLUR_S**2


# Outlier gate: discards frames whose landmarks jump further than a head can move.
#
# One frame that is off by 0.58 eye distances moves the picture by 0.04 views instead of 2.32 (table
# of bad frames in profiling/results/eyes.md).

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


# Half the eye distance as a vector: smoothed within its noise, and predicted by the rotation that
# successive frames confirm.
#
# Without the rotation, a head that rolls by 60 degrees in 1.5 s is off by 0.036 instead of 0.019
# views after 80 ms, and real heads in motion by 6.01 instead of 5.68 % of the eye distance
# (profiling/results/eyes.md).

BAND = 4.5  # changes below so many standard deviations count as noise
ROTATION_S = 0.06  # time constant of the rotation


class HalfDistance:
    """Smooths and predicts the half distance, px. half: of the first frame."""

    def __init__(self, half: Vector) -> None:
        self.half = half
        self._turned = self._rate = 0.0  # by the last frame, rad; low-passed, rad/s

    @property
    def velocity(self) -> Vector:
        """Of the rotation, px/s."""
        x, y = self.half
        return -self._rate * y, self._rate * x

    def update(self, measured: Vector, variance: float, dt_s: float) -> None:
        """Moves half towards the measured one, by less within the noise.

        dt_s: since the last frame used.
        """
        x, y = self.half
        dx, dy = measured[0] - x, measured[1] - y
        square = dx * dx + dy * dy
        gain = square / max(square + variance * BAND**2, 1e-300)
        self.half = x + gain * dx, y + gain * dy
        turned = gain * (x * dy - y * dx) / max(x * x + y * y, 1.0)
        # only the part that the last frame confirms: a single outlier rotates nothing
        repeated = min(turned, self._turned, key=abs) if turned * self._turned > 0 else 0.0
        self._turned = turned
        self._rate += low_pass_gain(dt_s, ROTATION_S) * (repeated / dt_s - self._rate)


# Separates motion from noise in a change of position.
#
# Without it a still head steps from picture to picture (column `step` of
# profiling/results/eyes.md).

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
