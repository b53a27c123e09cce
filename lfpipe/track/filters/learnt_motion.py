"""Learnt motion: a linear prediction from the last steps of the head, fitted while the filter runs.

Models of constant velocity cannot follow a head that shakes three times a second over a delay of
150 ms, but its last four steps determine the next ones. The share of this prediction follows from
its recent errors against those of the models: 0.52 instead of 0.90 views for shakes at 3.5 Hz after
80 ms, and hardly any change for heads that do not repeat themselves (profiling/results/eyes.md).

Points and displacements are complex numbers, x + iy: one recursive least-squares fit (forgetting
FIT_S) serves both axes.
"""

import itertools
import math
import operator
from collections import deque
from typing import NamedTuple

from lfpipe.track.filters.base import Vector
from lfpipe.track.filters.velocity_gain import FRAME_S

LAGS = 4
FIT_S, ERROR_S = 1.5, 2.0  # memory of the fit, and of the errors
# In eye distances: smaller steps are noise and not fitted; smaller errors count as equal.
MIN_STEPS, MIN_ERROR = 0.03, 0.006
PRIOR = 30.0  # prior weight of the models relative to the fit
POWER = 3  # exponent of the mean square errors
# Variance of the weights: initial and largest; beyond the latter, the fit is reset.
FIRST_COVARIANCE, MAX_COVARIANCE = 30.0, 1e3


class _Prediction(NamedTuple):
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
        self._predictions: deque[_Prediction] = deque()
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
        self._predictions.append(_Prediction(t_ns, here, steps, models, learnt))
        of_models, of_learnt = (one**-POWER for one in self._errors)
        share = of_learnt / (of_learnt + PRIOR * of_models)
        result = complex(*velocity)
        result += share * (learnt * eye_distance_px / self._prediction_s - result)
        return result.real, result.imag

    def _learn(self, old: _Prediction, moved: complex, dt_s: float) -> None:
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
