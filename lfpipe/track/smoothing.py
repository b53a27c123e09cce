"""Smoothing and prediction of the eye positions: what all filters share, and those for comparison:
mean, One-Euro, Kalman.

No filter reads a clock. Stamps are subtracted as integers before conversion to float, so no
precision is lost on a machine that has been up for years. Speeds are in distances between the eyes
per second: a near head moves by more pixels, and the noise of its landmarks grows in proportion.
"""

import math
from abc import ABC, abstractmethod
from collections import deque

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.eyes import extrapolated

Points = NDArray[np.float64]

LIMIT_PX = 1e6  # beyond every camera's picture: such a measurement is a fault
# a stamp that near means a duplicate frame; noise / dt would give a wild velocity
MIN_STEP_NS = 200_000
MAX_STEP_NS = 500_000_000  # after a longer gap, the past is meaningless


class EyeFilter(ABC):
    """A filter: subclasses implement _start and _step. The prediction is position + velocity *
    horizon, so a filter reports the velocity to use for extrapolation.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Discards everything: the next measurement is the first."""
        self._t_ns: int | None = None
        self._position = np.full((2, 2), np.nan)
        self._velocity = np.zeros((2, 2))

    def update(self, t_ns: int, measurement: Points) -> tuple[Points, Points]:
        """Adds the eyes measured at t_ns, float64 (2, 2) px; returns (position, velocity), both (2,
        2), px and px/s, which the filter still uses: copy them before you change them.

        A measurement that is not finite or beyond LIMIT_PX counts as missing. A stamp less than
        MIN_STEP_NS after the last one means a duplicate frame, which is ignored. A step of at least
        MAX_STEP_NS, forwards or backwards, starts a new run. Before the first good measurement, the
        position is NaN.
        """
        t_ns = int(t_ns)  # a numpy integer could overflow in subtractions
        measured = np.array(measurement, np.float64)
        (lx, ly), (rx, ry) = measured.tolist()
        # false for NaN
        near = (
            abs(lx) <= LIMIT_PX
            and abs(ly) <= LIMIT_PX
            and abs(rx) <= LIMIT_PX
            and abs(ry) <= LIMIT_PX
        )
        if not near:
            return self.predict(t_ns), self._velocity
        step_ns = 0 if self._t_ns is None else t_ns - self._t_ns
        if self._t_ns is None or abs(step_ns) >= MAX_STEP_NS:
            self.reset()
            self._t_ns = t_ns
            self._position = measured
            self._start(t_ns, measured)
        elif step_ns >= MIN_STEP_NS:
            self._t_ns = t_ns
            self._position, self._velocity = self._step(t_ns, step_ns / 1e9, measured)
        return self._position, self._velocity

    def predict(self, t_ns: int) -> Points:
        """The predicted eyes at t_ns, (2, 2) px; at most `lfpipe.eyes.MAX_PREDICTION_S` ahead,
        never back.
        """
        return extrapolated(
            self._position, self._velocity, 0 if self._t_ns is None else int(t_ns) - self._t_ns
        )

    @abstractmethod
    def _start(self, t_ns: int, measured: Points) -> None:
        """Processes the first measurement of a run."""

    @abstractmethod
    def _step(self, t_ns: int, dt_s: float, measured: Points) -> tuple[Points, Points]:
        """New (position, velocity) at t_ns, dt_s after the last measurement."""


class Mean(EyeFilter):
    """Moving average of the last k measurements (or all, if there are fewer), as in the paper. No
    prediction.

    The sum is computed afresh each time: a running sum would accumulate rounding errors and keep
    glitches forever.
    """

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


class OneEuro(EyeFilter):
    """Low-pass whose cutoff rises with speed (Casiez, Roussel, Vogel, CHI 2012). No prediction.

    cutoff = min_cutoff_hz + beta * speed, the speed (distances between the eyes per second, both
    eyes together) itself low-passed at d_cutoff_hz.
    """

    def __init__(self, min_cutoff_hz: float, beta: float, d_cutoff_hz: float) -> None:
        self._min_cutoff_hz, self._beta, self._d_cutoff_hz = min_cutoff_hz, beta, d_cutoff_hz
        super().__init__()

    def _start(self, t_ns: int, measured: Points) -> None:
        self._last = measured
        self._slope = np.zeros((2, 2))

    def _step(self, t_ns: int, dt_s: float, measured: Points) -> tuple[Points, Points]:
        self._slope = blended(
            self._slope, (measured - self._last) / dt_s, weight(self._d_cutoff_hz, dt_s)
        )
        self._last = measured
        cutoff_hz = self._min_cutoff_hz + self._beta * speed(self._slope, measured)
        return blended(self._position, measured, weight(cutoff_hz, dt_s)), np.zeros((2, 2))


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

    def ahead(self, dt_s: float, q: float) -> "Covariance":
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

    def measured(self, r: float) -> tuple["Covariance", float, float]:
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
    """Constant-velocity model with one covariance for the four coordinates. Reports the estimated
    velocity.

    agility: density of the acceleration noise divided by the variance of the measurement, 1/s^3.
    Only this ratio affects the gains.
    """

    # variance of the first velocity over that of a measurement, 1/s^2: covers all head motion
    START_SPREAD = 1e6

    def __init__(self, q_over_r: float) -> None:
        self._agility = q_over_r
        super().__init__()

    def _start(self, t_ns: int, measured: Points) -> None:
        self._covariance = Covariance(1.0, 0.0, self.START_SPREAD, self.START_SPREAD)

    def _step(self, t_ns: int, dt_s: float, measured: Points) -> tuple[Points, Points]:
        self._covariance, k_position, k_velocity = self._covariance.ahead(
            dt_s, self._agility
        ).measured(1.0)
        ahead = self._position + self._velocity * dt_s
        innovation = measured - ahead
        return ahead + k_position * innovation, self._velocity + k_velocity * innovation


def weight(cutoff_hz: float, dt_s: float) -> float:
    """Share of the new value in a first-order low-pass over dt_s >= 0: backward Euler, within 0..1
    for every dt.

    (Explicit Euler's share, dt/tau, passes 2 at long steps or high cutoffs and then grows without
    bound.)
    """
    ratio = 2 * math.pi * cutoff_hz * dt_s
    return ratio / (1 + ratio) if ratio < math.inf else 1.0


def blended(old: Points, new: Points, share: float) -> Points:
    """old + share * (new - old), always between old and new, despite rounding."""
    return np.clip(old + share * (new - old), np.minimum(old, new), np.maximum(old, new))


def speed(velocity_px_s: Points, eyes_px: Points) -> float:
    """Speed of the head in distances between the eyes per second, both (2, 2); the distance counts
    as at least one pixel.
    """
    eye_distance_px = max(float(np.hypot(*(eyes_px[0] - eyes_px[1]))), 1.0)
    return math.sqrt(float(np.square(velocity_px_s).sum()) / 2) / eye_distance_px
