"""Measurement noise of the landmarks, estimated while the filter runs.

The estimate uses third differences of the half distance, in which head motion cancels. A fixed
noise would fit either bright or dark pictures only: still heads would tremble, or moving heads lag
(profiling/results/eyes.md).
"""

from lfpipe.track.filters.base import Vector

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
