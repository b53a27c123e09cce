"""Gains of velocity and acceleration in the prediction, learnt from earlier predictions.

At constant acceleration a, the mean velocity over the next h seconds is v + a h / 2. Reaching and
swaying follow this model. A nod reverses within a tenth of a second: the acceleration term then
overshoots and, over a long prediction, the velocity term does, too. So both terms are scaled by
least-squares gains over the prediction: the gain of the velocity regresses the actual displacement
on v h, that of the acceleration regresses the residual on a h^2 / 2. Overshoot after 80 ms is 6.46
instead of 11.66 % of the eye distance (profiling/results/eyes.md).
"""

import math
from collections import deque
from typing import NamedTuple

from lfpipe.eyes import low_pass_gain
from lfpipe.track.filters.base import Vector

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
