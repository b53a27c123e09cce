"""Filter "predictive", the default one: several models of head motion, run in parallel and weighted
by how well each predicts, with measured noise and an outlier gate (`measurement`), learnt gains of
the prediction and a limit of its growth (`velocity`).

The midpoint of the eyes goes through the models; their half distance is smoothed separately.
Constants are in eye distances and in seconds, so they hold for any camera and viewer
(profiling/results/eyes.md). All arithmetic uses plain numbers: numpy's overhead would dominate.

The models are interacting multiple models (Blom and Bar-Shalom 1988; Bar-Shalom, Li, Kirubarajan
2001, section 11.6.6). One model of rest dominates at rest, so that noise does not move the picture.
The others, of constant velocity under accelerations of different strength, take over within a
frame. Compared with one Kalman filter on real heads: error in motion 2.11 instead of 2.30 % of the
eye distance, step of a still head 0.11 instead of 0.28 (profiling/results/eyes.md).
"""

import math

import attrs
import numpy as np

from lfpipe.config import Track
from lfpipe.track.filters.base import EyeFilter, Points, Vector
from lfpipe.track.filters.measurement import (
    HalfDistance,
    MeasurementNoise,
    MotionWeight,
    OutlierGate,
    eye_distance_of,
)
from lfpipe.track.filters.velocity import FRAME_S, GrowthLimit, LearntMotion, VelocityGain

# Densities of the noise of acceleration of the models that move, squared eye distances per s^3.
ACCELERATIONS = (1.0, 3.5, 85.0)
# Variance of the drift of a head at rest, squared eye distances per s.
WANDER = 1.5e-5
STAY_S = 0.7  # mean time in a model
CAUTION = 0.175  # exponent of the likelihoods: noise is correlated between frames
# Eye distances per second (500 mm/s): prior deviation of the velocity of a new face.
FIRST_SPEED = 8.0


@attrs.define(kw_only=True)
class Model:
    """State of one model; between two calls of `Models.update` in px of the picture."""

    acceleration: float | None
    """Density of its noise; None: the model of rest."""
    x: float
    y: float
    """Position, px."""
    u: float
    v: float
    """Velocity, px/s."""
    a: float
    b: float
    c: float
    """Covariance [[a, b], [b, c]] of position and velocity, the same for both axes."""
    weight: float
    """Probability."""

    def cycle(
        self,
        sums: tuple[float, ...],
        leave: float,
        extra: float,
        dt_s: float,
        unit_px2: float,
        measured: Vector,
        noise: float,
    ) -> tuple[float, float]:
        """Mixes with the other models, predicts, and updates with the measurement, which is the
        origin of the state before. Returns the probability without the measurement, and the
        log-likelihood of the measurement.

        sums: see `Models._moments`. leave: probability of a change to one other model. extra: of
        staying, less leave. unit_px2: square of the eye distance.
        """
        total, sx, sy, su, sv, sa, sb, sc = sums
        own = extra * self.weight
        prior = leave * total + own
        x, y = (leave * sx + own * self.x) / prior, (leave * sy + own * self.y) / prior
        u, v = (leave * su + own * self.u) / prior, (leave * sv + own * self.v) / prior
        a = max((leave * sa + own * self.a) / prior - (x * x + y * y) / 2, 0.0)
        b = (leave * sb + own * self.b) / prior - (x * u + y * v) / 2
        c = max((leave * sc + own * self.c) / prior - (u * u + v * v) / 2, 0.0)

        if self.acceleration is None:
            u = v = b = c = 0.0
            a += WANDER * unit_px2 * dt_s
        else:  # white acceleration of density q, exactly
            q = self.acceleration * unit_px2
            x, y = x + u * dt_s, y + v * dt_s
            a += dt_s * (2 * b + dt_s * (c + q * dt_s / 3))
            b += dt_s * (c + q * dt_s / 2)
            c += q * dt_s
        a = max(a, 0.0)

        spread = a + noise
        velocity_gain = b / spread
        share = noise / spread
        self.x, self.y = measured[0] + x * share, measured[1] + y * share
        self.u, self.v = u - velocity_gain * x, v - velocity_gain * y
        self.a, self.b, self.c = a * share, b * share, max(c - velocity_gain * b, 0.0)
        return prior, -CAUTION * ((x * x + y * y) / (2 * spread) + math.log(spread))


class Models:
    """All models of one run.

    position: of the first frame, px. variance: of its measurement, px^2.
    """

    def __init__(self, position: Vector, variance: float, eye_distance_px: float) -> None:
        motions = (None, *ACCELERATIONS)
        x, y = position
        self.models = [
            Model(
                acceleration=motion,
                x=x,
                y=y,
                u=0.0,
                v=0.0,
                a=variance,
                b=0.0,
                c=(FIRST_SPEED * eye_distance_px) ** 2 if motion else 0.0,
                weight=1 / len(motions),
            )
            for motion in motions
        ]
        self.position = position
        self.velocity = 0.0, 0.0
        """Of the models together, px/s."""

    def update(self, measured: Vector, noise: float, eye_distance_px: float, dt_s: float) -> None:
        """One cycle: mix, predict, compare with the measured midpoint (px) of variance noise
        (px^2), and update the probabilities.
        """
        models = self.models
        stay = math.exp(-dt_s / STAY_S)
        leave = (1 - stay) / (len(models) - 1)
        sums = self._moments(measured)
        unit_px2 = eye_distance_px**2
        likelihoods = [
            model.cycle(sums, leave, stay - leave, dt_s, unit_px2, measured, noise)
            for model in models
        ]
        best = max(log for _, log in likelihoods)
        total = 0.0
        for model, (prior, log) in zip(models, likelihoods, strict=True):
            model.weight = prior * math.exp(max(log - best, -60.0))
            total += model.weight
        x = y = u = v = 0.0
        for model in models:
            model.weight = weight = model.weight / total
            x, y = x + weight * model.x, y + weight * model.y
            u, v = u + weight * model.u, v + weight * model.v
        self.position, self.velocity = (x, y), (u, v)

    def _moments(self, measured: Vector) -> tuple[float, ...]:
        """Moves all states to the measurement as origin, and covariances to second moments about
        it, so that the mixture of each model follows from common sums: of the probability, and
        weighted by it of x, y, u, v, a, b, c.
        """
        total = x = y = u = v = a = b = c = 0.0
        for model in self.models:
            weight, du, dv = model.weight, model.u, model.v
            model.x = dx = model.x - measured[0]
            model.y = dy = model.y - measured[1]
            model.a = da = model.a + (dx * dx + dy * dy) / 2
            model.b = db = model.b + (dx * du + dy * dv) / 2
            model.c = dc = model.c + (du * du + dv * dv) / 2
            total += weight
            x, y = x + weight * dx, y + weight * dy
            u, v = u + weight * du, v + weight * dv
            a, b, c = a + weight * da, b + weight * db, c + weight * dc
        return total, x, y, u, v, a, b, c


class ImmFilter(EyeFilter):
    """The default filter. device_latency_s: delay of camera and display that predictions cover."""

    holds_when_hidden = True

    def __init__(self, device_latency_s: float = 0.0) -> None:
        self._device_latency_s = device_latency_s
        super().__init__()

    def _start(self, t_ns: int, measured: Points) -> None:
        (lx, ly), (rx, ry) = measured.tolist()
        midpoint = (lx + rx) / 2, (ly + ry) / 2
        half = (lx - rx) / 2, (ly - ry) / 2
        self._half = HalfDistance(half)
        eye_distance_px = eye_distance_of(half)
        self._noise = MeasurementNoise(half, eye_distance_px)
        self._models = Models(midpoint, self._noise.midpoint_variance, eye_distance_px)
        self._motion = MotionWeight(midpoint)
        self._gain = VelocityGain(self._device_latency_s)
        self._learnt = LearntMotion(self._device_latency_s)
        self._growth = GrowthLimit(FRAME_S + self._device_latency_s)
        self._outliers = OutlierGate()
        self._used_ns = t_ns

    def _step(self, t_ns: int, dt_s: float, measured: Points) -> tuple[Points, Points]:
        (lx, ly), (rx, ry) = measured.tolist()
        (last_lx, last_ly), (last_rx, last_ry) = self._position.tolist()
        last_u, last_v = self._growth.velocity
        moved_x, moved_y = last_u * dt_s, last_v * dt_s
        midpoint = x, y = (lx + rx) / 2, (ly + ry) / 2
        last_x, last_y = (last_lx + last_rx) / 2, (last_ly + last_ry) / 2
        deviation_px = max(
            math.hypot(lx - last_lx - moved_x, ly - last_ly - moved_y),
            math.hypot(rx - last_rx - moved_x, ry - last_ry - moved_y),
        )
        since_s = (t_ns - self._used_ns) / 1e9
        if self._outliers.rejects(
            midpoint,
            (last_x + moved_x, last_y + moved_y),
            deviation_px,
            eye_distance_of(self._half.half),
            since_s,
        ):
            return self._position + self._velocity * dt_s, self._velocity
        self._used_ns = t_ns
        half = (lx - rx) / 2, (ly - ry) / 2
        eye_distance_px = eye_distance_of(half)
        noise = self._noise
        noise.update(half, eye_distance_px, since_s)
        models = self._models
        models.update(
            midpoint, noise.of_midpoint(since_s, models.velocity), eye_distance_px, since_s
        )
        self._half.update(half, noise.variance, since_s)
        mx, my = models.position
        u, v = models.velocity
        weight = self._motion.update(models.position, models.velocity, noise.variance, since_s)
        velocity = self._gain.apply(
            t_ns, since_s, models.position, (weight * u, weight * v), midpoint, eye_distance_px
        )
        innovation = x - last_x - moved_x, y - last_y - moved_y
        u, v = self._growth.limit(velocity, innovation, since_s)
        hx, hy = self._half.half
        hu, hv = self._half.velocity
        u, v = self._learnt.apply(t_ns, since_s, midpoint, (mx, my), (u, v), eye_distance_px)
        return (
            np.array(((mx + hx, my + hy), (mx - hx, my - hy))),
            np.array(((u + hu, v + hv), (u - hu, v - hv))),
        )


def make(track: Track, device_latency_s: float) -> ImmFilter:
    """Row "predictive" of the table of filters."""
    return ImmFilter(device_latency_s)
