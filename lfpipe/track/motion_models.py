"""The default filter: several models of head motion, run in parallel and weighted by how well each predicts.

Interacting multiple models (Blom and Bar-Shalom 1988; Bar-Shalom, Li, Kirubarajan 2001, section 11.6.6), on the point midway
between the eyes: one model of rest, the others of constant velocity under accelerations of different strength. At rest, the model
of rest dominates, and noise does not move the picture. If the eyes move by more than noise explains, a livelier model takes over
within a frame. The eyes' half distance, which changes slowly, is smoothed separately. See `acceleration` for curved paths.

The noise is measured while running, from third differences of the half distance, in which head motion cancels. Lengths are in
distances between the eyes, so the constants are valid for any camera and viewing distance.
"""

import math

import attrs
import numpy as np

from lfpipe.host.addition import add
from lfpipe.track.acceleration import Acceleration
from lfpipe.track.smoothing import Filter, Points

FIRST_SPEED = 8.0  # distances between the eyes per second (500 mm/s): all that is known of a face that has just appeared


@attrs.frozen
class Motion:
    """A model of constant velocity. acceleration: density of its noise, squared distances between the eyes per s^3. trust:
    share of its velocity used for prediction; a lively model sees velocities that end before the picture is shown."""

    acceleration: float
    trust: float


@attrs.frozen
class Tuning:
    """Constants of the filter, by the rule in profiling/results/eyes.md.

    motions: the models. wander: variance of the drift of a head at rest, squared distances between the eyes per s. stay_s: mean
    time in a model. common: noise of the point between the eyes divided by that of their half distance. caution: exponent of
    the likelihoods, because noise is correlated between frames. half_band: changes of the half distance below this many
    standard deviations count as noise. speed_band: the same for the speed, per 1/30 s. noise_s: time constant of the noise
    estimate. first, least: initial and smallest noise, in distances between the eyes.
    """

    motions: tuple[Motion, ...] = (Motion(1.0, 1.0), Motion(4.7, 1.0), Motion(85.0, 0.45), Motion(1200.0, 0.31))
    wander: float = 1e-7
    stay_s: float = 0.7
    common: float = 2.1
    caution: float = 0.34
    half_band: float = 4.5
    speed_band: float = 9.0
    noise_s: float = 2.6
    first: float = 1.5e-3
    least: float = 1e-3


@attrs.define
class _Estimate:
    """State of one model: position and velocity (px, px/s) along both axes, and one covariance for both axes."""

    x: float
    y: float
    u: float
    v: float
    a: float
    b: float
    c: float


class Predictive(Filter):
    """See the module. All arithmetic uses plain numbers: numpy's overhead would dominate for so few."""

    def __init__(self, tuning: Tuning | None = None) -> None:
        self._tuning = tuning or Tuning()
        super().__init__()

    def _start(self, t_ns: int, measured: Points) -> None:
        (lx, ly), (rx, ry) = measured.tolist()
        half = (lx - rx) / 2, (ly - ry) / 2
        apart = max(2 * math.hypot(*half), 1.0)
        self._halves, self._half = [half], half
        self._noise = (self._tuning.first * apart) ** 2  # variance of the half distance, px^2
        spread = self._noise * self._tuning.common**2
        x, y = (lx + rx) / 2, (ly + ry) / 2
        moving = [_Estimate(x, y, 0.0, 0.0, spread, 0.0, (FIRST_SPEED * apart) ** 2) for _ in self._tuning.motions]
        self._models = [_Estimate(x, y, 0.0, 0.0, spread, 0.0, 0.0), *moving]
        self._shares = [1 / len(self._models)] * len(self._models)
        self._acceleration = Acceleration()

    def _step(self, t_ns: int, dt_s: float, measured: Points) -> tuple[Points, Points]:
        (lx, ly), (rx, ry) = measured.tolist()
        half = (lx - rx) / 2, (ly - ry) / 2
        apart = max(2 * math.hypot(*half), 1.0)
        self._measure_noise(half, apart, dt_s)
        self._update((lx + rx) / 2, (ly + ry) / 2, apart, dt_s)
        self._follow_half(half)
        x = add(share * model.x for share, model in zip(self._shares, self._models, strict=True))
        y = add(share * model.y for share, model in zip(self._shares, self._models, strict=True))
        trusted = [
            (share * motion.trust, model)
            for share, motion, model in zip(self._shares[1:], self._tuning.motions, self._models[1:], strict=True)
        ]
        u, v = add(share * model.u for share, model in trusted), add(share * model.v for share, model in trusted)
        band = (30 * self._tuning.speed_band) ** 2 * self._noise  # a smaller speed may be noise
        fast = (u * u + v * v) / max(u * u + v * v + band, 1e-300)
        measured_px = (lx + rx) / 2, (ly + ry) / 2
        u, v = self._acceleration.corrected(t_ns, dt_s, (x, y), (fast * u, fast * v), measured_px, apart)
        hx, hy = self._half
        return np.array(((x + hx, y + hy), (x - hx, y - hy))), np.array(((u, v), (u, v)))

    def _measure_noise(self, half: tuple[float, float], apart: float, dt_s: float) -> None:
        """The variance of a third difference is 20 times that of its input. A glitch counts as at most three standard
        deviations."""
        halves = self._halves
        halves.append(half)
        if len(halves) < 4:
            return
        (x0, y0), (x1, y1), (x2, y2), (x3, y3) = halves
        del halves[0]
        found = ((x3 - 3 * x2 + 3 * x1 - x0) ** 2 + (y3 - 3 * y2 + 3 * y1 - y0) ** 2) / 40
        self._noise += (min(found, 9 * self._noise) - self._noise) * min(dt_s / self._tuning.noise_s, 1.0)
        self._noise = max(self._noise, (self._tuning.least * apart) ** 2)

    def _update(self, x: float, y: float, apart: float, dt_s: float) -> None:
        """One cycle of the models: mix, predict, compare with the point (x, y) between the eyes, and update the weights."""
        tuning, before, shares = self._tuning, self._models, self._shares
        count, noise = len(before), self._noise * tuning.common**2
        stay = math.exp(-dt_s / tuning.stay_s)
        leave = (1 - stay) / (count - 1)
        after, priors, logs = [], [], []
        for j in range(count):
            weights = [share * (stay if i == j else leave) for i, share in enumerate(shares)]
            prior = add(weights)
            one = _mixed(before, [weight / prior for weight in weights])
            if j == 0:
                one.u = one.v = one.b = one.c = 0.0
                one.a += tuning.wander * apart**2 * dt_s
            else:
                _predict(one, tuning.motions[j - 1].acceleration * apart**2, dt_s)
            spread = one.a + noise
            dx, dy = x - one.x, y - one.y
            logs.append(-tuning.caution * ((dx * dx + dy * dy) / (2 * spread) + math.log(spread)))
            to_place, to_speed = one.a / spread, one.b / spread
            one.x, one.y = one.x + to_place * dx, one.y + to_place * dy
            one.u, one.v = one.u + to_speed * dx, one.v + to_speed * dy
            kept = noise / spread
            one.c = max(one.c - to_speed * one.b, 0.0)
            one.a, one.b = one.a * kept, one.b * kept
            after.append(one)
            priors.append(prior)
        best = max(logs)
        likely = [prior * math.exp(max(log - best, -60.0)) for prior, log in zip(priors, logs, strict=True)]
        total = add(likely)
        self._models, self._shares = after, [value / total for value in likely]

    def _follow_half(self, half: tuple[float, float]) -> None:
        """Passes large changes of the half distance unchanged, and attenuates changes within its noise band."""
        dx, dy = half[0] - self._half[0], half[1] - self._half[1]
        off = dx * dx + dy * dy
        share = off / max(off + self._noise * self._tuning.half_band**2, 1e-300)
        self._half = self._half[0] + share * dx, self._half[1] + share * dy


def _mixed(models: list[_Estimate], weights: list[float]) -> _Estimate:
    """Mean and covariance of a mixture; weights sum to 1."""
    x = y = u = v = a = b = c = 0.0
    for weight, model in zip(weights, models, strict=True):
        x, y, u, v = x + weight * model.x, y + weight * model.y, u + weight * model.u, v + weight * model.v
    for weight, model in zip(weights, models, strict=True):
        dx, dy, du, dv = model.x - x, model.y - y, model.u - u, model.v - v
        a += weight * (model.a + (dx * dx + dy * dy) / 2)
        b += weight * (model.b + (dx * du + dy * dv) / 2)
        c += weight * (model.c + (du * du + dv * dv) / 2)
    return _Estimate(x, y, u, v, a, b, c)


def _predict(one: _Estimate, q: float, dt_s: float) -> None:
    """After dt_s under white acceleration of density q, exactly."""
    one.x, one.y = one.x + one.u * dt_s, one.y + one.v * dt_s
    one.a += dt_s * (2 * one.b + dt_s * (one.c + q * dt_s / 3))
    one.b += dt_s * (one.c + q * dt_s / 2)
    one.c += q * dt_s
