"""The velocity to predict with: gains learnt from earlier predictions, motion that repeats itself,
and a limit of its growth.
"""

import itertools
import math
import operator
from collections import deque
from typing import NamedTuple

from lfpipe.eyes import low_pass_gain
from lfpipe.track.filters.base import Vector

# Gains of velocity and acceleration in the prediction, learnt from earlier predictions.
#
# At constant acceleration a, the mean velocity over the next h seconds is v + a h / 2. Reaching and
# swaying follow this model. A nod reverses within a tenth of a second: the acceleration term then
# overshoots and, over a long prediction, the velocity term does, too. So both terms are scaled by
# least-squares gains over the prediction: the gain of the velocity regresses the actual
# displacement on v h, that of the acceleration regresses the residual on a h^2 / 2. Overshoot after
# 80 ms is 6.46 instead of 11.66 % of the eye distance (profiling/results/eyes.md).

# Prediction without a device latency: age of the frame, a camera period, half a refresh; the best
# of 0.05 to 0.1 on real heads.
FRAME_S = 0.07
ACCELERATION_S = 0.03  # time constant of the acceleration: about one frame of a webcam
MEMORY_S = 10.0  # of the gains: a person's motion pattern changes slowly
MAX_EVIDENCE = 2.0  # of one prediction, relative to the predicted displacement; more is a glitch
# Displacements in squared eye distances above which a prediction counts less: landmarks jump.
MAX_DISPLACEMENT, MAX_BEND = 1.0, 0.1
# Evidence below which the velocity keeps its full gain, and the acceleration a gain near 0.
PRIOR_VELOCITY, PRIOR_ACCELERATION = 0.05, 0.01
# Device latency after which the velocity needs twice the evidence.
PRIOR_LATENCY_S = 0.1
# A velocity that changes little over the prediction is used in full, whatever its gain: a head at
# constant speed does not lag. The change is low-passed over CHANGE_S.
CHANGE_WEIGHT, CHANGE_S = 6.0, 0.15


class _Prediction(NamedTuple):
    """Position, velocity and acceleration (px, s) at a frame, to be compared with a later one."""

    t_ns: int
    position: Vector
    velocity: Vector
    acceleration: Vector


class VelocityGain:
    """The gains for one run of the filter; lengths in px.

    device_latency_s: delay of camera and display.
    """

    def __init__(self, device_latency_s: float) -> None:
        self._prediction_ns = round((FRAME_S + device_latency_s) * 1e9)
        self._velocity = self._acceleration = (0.0, 0.0)
        self._predictions: deque[_Prediction] = deque()
        self._prior = prior = PRIOR_VELOCITY * (1 + device_latency_s / PRIOR_LATENCY_S)
        # sums of the regressions: actual over predicted displacement, and residual over bend
        self._moved = self._predicted = prior
        self._residual = self._bend = 0.0
        self._change_px_s = 0.0  # of the velocity over the prediction, low-passed

    def apply(
        self,
        t_ns: int,
        dt_s: float,
        position: Vector,
        velocity: Vector,
        measured: Vector,
        eye_distance_px: float,
    ) -> Vector:
        """The velocity to predict with from t_ns on.

        dt_s: since the last call. position, velocity: estimates at t_ns, px and px/s. measured:
        midpoint of the eyes at t_ns, px.
        """
        gain = low_pass_gain(dt_s, ACCELERATION_S)
        (ax, ay), (last_u, last_v) = self._acceleration, self._velocity
        ax += gain * ((velocity[0] - last_u) / dt_s - ax)
        ay += gain * ((velocity[1] - last_v) / dt_s - ay)
        self._forget(dt_s)
        while self._predictions and t_ns - self._predictions[0].t_ns > self._prediction_ns:
            self._score(
                self._predictions.popleft(), t_ns, measured, eye_distance_px * eye_distance_px
            )
        self._velocity = velocity
        self._acceleration = (ax, ay)
        self._predictions.append(_Prediction(t_ns, position, velocity, (ax, ay)))
        speed_gain = self._speed_gain(dt_s)
        ahead_s = (
            self._prediction_ns / 2e9 * _clamped(self._residual / (self._bend + PRIOR_ACCELERATION))
        )
        return speed_gain * velocity[0] + ahead_s * ax, speed_gain * velocity[1] + ahead_s * ay

    def _forget(self, dt_s: float) -> None:
        """Lets the sums decay towards their priors."""
        keep = math.exp(-dt_s / MEMORY_S)
        prior = self._prior
        self._moved = prior + keep * (self._moved - prior)
        self._predicted = prior + keep * (self._predicted - prior)
        self._residual, self._bend = keep * self._residual, keep * self._bend

    def _speed_gain(self, dt_s: float) -> float:
        """The gain of the velocity, raised towards 1 where the velocity hardly changes."""
        gain = _clamped(self._moved / self._predicted)
        (ax, ay), (u, v) = self._acceleration, self._velocity
        change_px_s = math.hypot(ax, ay) * self._prediction_ns / 1e9
        self._change_px_s += low_pass_gain(dt_s, CHANGE_S) * (change_px_s - self._change_px_s)
        square = u * u + v * v
        change = (CHANGE_WEIGHT * self._change_px_s) ** 2
        return gain + (1 - gain) * square / max(square + change, 1e-300)

    def _score(self, old: _Prediction, t_ns: int, measured: Vector, unit_px2: float) -> None:
        """Compares a prediction with the measurement.

        unit_px2: square of the eye distance.
        """
        ahead_s = (t_ns - old.t_ns) / 1e9
        half_square = ahead_s * ahead_s / 2
        gain = _clamped(self._moved / self._predicted)
        moved_x, moved_y = measured[0] - old.position[0], measured[1] - old.position[1]
        x, y = old.velocity[0] * ahead_s, old.velocity[1] * ahead_s
        predicted, moved = _evidence((x, y), (moved_x, moved_y), unit_px2, MAX_DISPLACEMENT)
        self._predicted += predicted
        self._moved += moved
        bend, residual = _evidence(
            (old.acceleration[0] * half_square, old.acceleration[1] * half_square),
            (moved_x - gain * x, moved_y - gain * y),
            unit_px2,
            MAX_BEND,
        )
        self._bend += bend
        self._residual += residual


def _evidence(
    predicted: Vector, actual: Vector, unit_px2: float, limit: float
) -> tuple[float, float]:
    """The terms that a predicted displacement (px) and the actual one add to a regression's sums.

    limit: squared length, in unit_px2, above which they count less.
    """
    (x, y), (dx, dy) = predicted, actual
    length, along = (x * x + y * y) / unit_px2, (dx * x + dy * y) / unit_px2
    weight = 1 / (1 + length / limit) ** 2
    return weight * length, weight * min(max(along, -MAX_EVIDENCE * length), MAX_EVIDENCE * length)


def _clamped(gain: float) -> float:
    return min(max(gain, 0.0), 1.0)


# Learnt motion: a linear prediction from the last steps of the head, fitted while the filter runs.
#
# Models of constant velocity cannot follow a head that shakes three times a second over a delay of
# 150 ms, but its last four steps determine the next ones. The share of this prediction follows from
# its recent errors against those of the models: 0.52 instead of 0.90 views for shakes at 3.5 Hz
# after 80 ms, and hardly any change for heads that do not repeat themselves
# (profiling/results/eyes.md).
#
# Points and displacements are complex numbers, x + iy: one recursive least-squares fit (forgetting
# FIT_S) serves both axes.

LAGS = 4
FIT_S, ERROR_S = 1.5, 2.0  # memory of the fit, and of the errors
# In eye distances: smaller steps are noise and not fitted; smaller errors count as equal.
MIN_STEPS, MIN_ERROR = 0.03, 0.006
PRIOR = 30.0  # prior weight of the models relative to the fit
POWER = 3  # exponent of the mean square errors
# Variance of the weights: initial and largest; beyond the latter, the fit is reset.
FIRST_COVARIANCE, MAX_COVARIANCE = 30.0, 1e3


class _LearntPrediction(NamedTuple):
    """Displacements from a midpoint (px) over the delay, in eye distances."""

    t_ns: int
    midpoint: complex
    steps: list[complex]
    models: complex
    learnt: complex


class LearntMotion:
    """The learnt prediction for one run of the filter.

    device_latency_s: delay of camera and display.
    """

    def __init__(self, device_latency_s: float) -> None:
        self._prediction_s = FRAME_S + device_latency_s
        self._midpoints: deque[complex] = deque(maxlen=LAGS + 1)
        self._predictions: deque[_LearntPrediction] = deque()
        self._weights = [0j] * LAGS
        self._covariance = _first_covariance()
        self._errors = 1e-4, 1e-4  # mean squares: of the models, learnt

    def apply(
        self,
        t_ns: int,
        dt_s: float,
        midpoint: Vector,
        position: Vector,
        velocity: Vector,
        eye_distance_px: float,
    ) -> Vector:
        """The velocity to predict with from t_ns on, px/s.

        dt_s: since the last call. midpoint: measured; position, velocity: of the models.
        """
        here = complex(*midpoint)
        while (
            self._predictions
            and (t_ns - self._predictions[0].t_ns) / 1e9 >= self._prediction_s - dt_s / 2
        ):
            old = self._predictions.popleft()
            moved = (here - old.midpoint) / eye_distance_px
            if dt_s > self._prediction_s:  # a slow camera: no frame is nearer to the predicted time
                moved *= self._prediction_s * 1e9 / (t_ns - old.t_ns)
            self._learn(old, moved, dt_s)
        self._midpoints.append(here)
        if len(self._midpoints) <= LAGS:
            return velocity
        steps = [(b - a) / eye_distance_px for a, b in itertools.pairwise(self._midpoints)]
        learnt = sum(map(operator.mul, self._weights, steps))
        moved = complex(*velocity) * self._prediction_s
        models = (complex(*position) + moved - here) / eye_distance_px
        self._predictions.append(_LearntPrediction(t_ns, here, steps, models, learnt))
        of_models, of_learnt = (one**-POWER for one in self._errors)
        share = of_learnt / (of_learnt + PRIOR * of_models)
        result = complex(*velocity)
        result += share * (learnt * eye_distance_px / self._prediction_s - result)
        return result.real, result.imag

    def _learn(self, old: _LearntPrediction, moved: complex, dt_s: float) -> None:
        """Compares a prediction with the measurement, and fits the weights to it."""
        keep = math.exp(-dt_s / ERROR_S)
        of_models, of_learnt = (
            keep * error + (1 - keep) * min(max(abs(moved - one), MIN_ERROR), 1.0) ** 2
            for error, one in zip(self._errors, (old.models, old.learnt), strict=True)
        )
        self._errors = of_models, of_learnt
        if sum(abs(step) for step in old.steps) < LAGS * MIN_STEPS:
            return
        keep = math.exp(-dt_s / FIT_S)
        inputs = [step.conjugate() for step in old.steps]
        gains = [sum(map(operator.mul, row, inputs)) for row in self._covariance]
        total = keep + sum(map(operator.mul, gains, old.steps)).real
        missed = (moved - sum(map(operator.mul, self._weights, old.steps))) / total
        self._weights = [a + gain * missed for a, gain in zip(self._weights, gains, strict=True)]
        others = [gain.conjugate() for gain in gains]
        self._covariance = [
            [(one - gain * other / total) / keep for one, other in zip(row, others, strict=True)]
            for row, gain in zip(self._covariance, gains, strict=True)
        ]
        if max(row[k].real for k, row in enumerate(self._covariance)) > MAX_COVARIANCE:
            self._covariance = _first_covariance()


def _first_covariance() -> list[list[complex]]:
    return [[FIRST_COVARIANCE * (i == j) + 0j for j in range(LAGS)] for i in range(LAGS)]


# Growth limit: a velocity grows only as far as the innovations of two frames support it.
#
# Wrong landmarks in one frame would otherwise be predicted ahead: one frame off by 0.12 eye
# distances moves the picture after 80 ms by 0.85 instead of 1.32 views (table of bad frames in
# profiling/results/eyes.md).

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
        share = min(max((u * old_u + v * old_v) / square, 0.0), 1.0) if square > 0 else 0.0
        old_u, old_v = share * old_u, share * old_v
        du, dv = u - old_u, v - old_v
        last_du, last_dv = self._growth
        self._growth = du, dv
        growth = math.hypot(du, dv)
        if growth > 0:
            limit += GAIN_GROWTH * max(du * last_du + dv * last_dv, 0.0) / growth
        share = limit / growth if growth > limit else 1.0
        self.velocity = old_u + share * du, old_v + share * dv
        return self.velocity
