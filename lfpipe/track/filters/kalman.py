"""Filter "kalman": constant velocity under white acceleration."""

import attrs

from lfpipe.config import Track
from lfpipe.track.filters.base import EyeFilter, Points


@attrs.frozen
class Covariance:
    """Covariance [[a, b], [b, c]] of (position, velocity), stored with its determinant.

    Both steps are the exact ones for white acceleration (Bar-Shalom, Li, Kirubarajan 2001, section
    6.2.2), rearranged so that they only add, multiply and divide non-negative numbers. Nothing
    cancels, so every entry keeps nearly all of its digits, and the matrix stays symmetric and
    positive semi-definite. (The Joseph form loses digits of c.) b >= 0 holds if the start is
    diagonal.
    """

    a: float
    b: float
    c: float
    det: float

    def predicted(self, dt_s: float, q: float) -> "Covariance":
        """After dt_s >= 0 under acceleration noise of density q."""
        a = self.a
        b = self.b
        c = self.c
        d = dt_s
        return Covariance(
            a + d * (2 * b + d * (c + q * d / 3)),
            b + d * (c + q * d / 2),
            c + q * d,
            self.det + q * d * (a + d * (b + d * (c / 3 + q * d / 12))),
        )

    def updated(self, r: float) -> tuple["Covariance", float, float]:
        """After a measurement of the position with variance r > 0; also the gains for position and
        velocity.
        """
        s = self.a + r
        kept = r / s
        return (
            Covariance(self.a * kept, self.b * kept, (self.det + self.c * r) / s, self.det * kept),
            self.a / s,
            self.b / s,
        )


class Kalman(EyeFilter):
    """One covariance for the four coordinates. Reports the estimated velocity.

    q_over_r: density of the acceleration noise divided by the variance of the measurement, 1/s^3.
    Only this ratio affects the gains.
    """

    predicts = True
    # variance of the first velocity over that of a measurement, 1/s^2: covers all head motion
    START_SPREAD = 1e6

    def __init__(self, q_over_r: float) -> None:
        self._q_over_r = q_over_r
        super().__init__()

    def _start(self, t_ns: int, measured: Points) -> None:
        self._covariance = Covariance(1.0, 0.0, self.START_SPREAD, self.START_SPREAD)

    def _step(self, t_ns: int, dt_s: float, measured: Points) -> tuple[Points, Points]:
        self._covariance, position_gain, velocity_gain = self._covariance.predicted(
            dt_s, self._q_over_r
        ).updated(1.0)
        predicted = self._position + self._velocity * dt_s
        innovation = measured - predicted
        return predicted + position_gain * innovation, self._velocity + velocity_gain * innovation


def make(track: Track, device_latency_s: float) -> Kalman:
    """Row "kalman" of the table of filters."""
    return Kalman(q_over_r=1e4)
