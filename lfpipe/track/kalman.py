"""Kalman filter of constant velocity, and the default filter built on it."""

from __future__ import annotations

import attrs

from lfpipe.track.smoothing import Filter, OneEuro, Points, speed


@attrs.frozen
class Covariance:
    """[[a, b], [b, c]] of (position, velocity), with its determinant carried along.

    Both steps are the exact ones for white acceleration (Bar-Shalom, Li, Kirubarajan 2001, section 6.2.2), rearranged so that
    they only add, multiply and divide numbers that are not negative: nothing cancels, so every entry keeps nearly all of its
    digits and the matrix stays symmetric and positive semi-definite, where the Joseph form loses digits of c. b >= 0 holds
    from a diagonal start on.
    """

    a: float
    b: float
    c: float
    det: float

    def ahead(self, dt_s: float, q: float) -> Covariance:
        """After dt_s >= 0 under acceleration noise of density q."""
        a, b, c, d = self.a, self.b, self.c, dt_s
        return Covariance(
            a + d * (2 * b + d * (c + q * d / 3)),
            b + d * (c + q * d / 2),
            c + q * d,
            self.det + q * d * (a + d * (b + d * (c / 3 + q * d / 12))),
        )

    def measured(self, r: float) -> tuple[Covariance, float, float]:
        """After a measurement of the position with variance r > 0; also the gains for position and velocity."""
        s = self.a + r
        kept = r / s
        return Covariance(self.a * kept, self.b * kept, (self.det + self.c * r) / s, self.det * kept), self.a / s, self.b / s


class Kalman(Filter):
    """Constant velocity, the same covariance for the four coordinates. Velocity as it is estimated.

    agility: density of the acceleration noise over variance of the measurement, 1/s^3; only the ratio decides the gains.
    """

    START_SPREAD = 1e6  # variance of the first velocity over that of a measurement, 1/s^2: all that a head can do

    def __init__(self, agility: float) -> None:
        self._agility = agility
        super().__init__()

    def _start(self, t_ns: int, measured: Points) -> None:
        self._covariance = Covariance(1.0, 0.0, self.START_SPREAD, self.START_SPREAD)

    def _step(self, t_ns: int, dt_s: float, measured: Points) -> tuple[Points, Points]:
        self._covariance, k_position, k_velocity = self._covariance.ahead(dt_s, self._agility).measured(1.0)
        ahead = self._position + self._velocity * dt_s
        surprise = measured - ahead
        return ahead + k_position * surprise, self._velocity + k_velocity * surprise


class Predictive(Filter):
    """Steady at rest, ahead in motion: One-Euro's position and no velocity at rest, the Kalman filter's of both in motion.

    Between the two stands g = s^4 / (1 + s^4), s the speed over `gate`, both in distances between the eyes per second:
    where the head is still, noise in the velocity would shake every prediction, and where it moves, One-Euro lags. (The square
    in place of the fourth power lets more noise through at rest for the same error in motion.)
    """

    def __init__(self, rest: OneEuro, motion: Kalman, gate: float) -> None:
        self._rest, self._motion, self._gate = rest, motion, gate
        super().__init__()

    def _start(self, t_ns: int, measured: Points) -> None:
        for part in (self._rest, self._motion):
            part.reset()
            part.update(t_ns, measured)

    def _step(self, t_ns: int, dt_s: float, measured: Points) -> tuple[Points, Points]:
        steady, _ = self._rest.update(t_ns, measured)
        ahead, velocity = self._motion.update(t_ns, measured)
        s4 = min(speed(velocity, measured) / self._gate, 1e3) ** 4
        gate = s4 / (1 + s4)
        return steady + gate * (ahead - steady), gate * velocity
