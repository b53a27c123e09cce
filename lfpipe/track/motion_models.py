"""The default filter: several models of head motion, run in parallel and weighted by how well each predicts.

Interacting multiple models (Blom and Bar-Shalom 1988; Bar-Shalom, Li, Kirubarajan 2001, section 11.6.6), on the point midway
between the eyes: one model of rest, the others of constant velocity under accelerations of different strength. At rest, the model
of rest dominates, and noise does not move the picture. If the eyes move by more than noise explains, a livelier model takes over
within a frame. The eyes' half distance, which changes slowly, is smoothed separately. How far velocity and acceleration
carry predictions is measured: see `extrapolation`.

The noise is measured while running, from third differences of the half distance, in which head motion cancels. Lengths are in
distances between the eyes, so the constants are valid for any camera and viewing distance.
"""

import math

import attrs
import numpy as np

from lfpipe.track.extrapolation import Extrapolation, Pair
from lfpipe.track.smoothing import Filter, Points

FIRST_SPEED = 8.0  # distances between the eyes per second (500 mm/s): all that is known of a face that has just appeared
RATE_HZ = 30.0  # of the recordings that the constants were chosen on
# No head is further from its prediction than this, in distances between the eyes: 20 m/s^2, and twice the worst of real heads.
STEP, STEP_S2 = 0.12, 158.0


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
    estimate. first, least: initial and smallest noise, in distances between the eyes. rate_common: `common` grows with this power
    of the frame rate above 30 Hz, because each picture then shows another measurement and its step is seen.
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
    rate_common: float = 0.4


@attrs.define
class _Model:
    """State of one model: position and velocity (px, px/s) along both axes, one covariance for both axes, and its weight."""

    motion: Motion | None  # None: the model of rest
    x: float
    y: float
    u: float
    v: float
    a: float
    b: float
    c: float
    share: float


class Predictive(Filter):
    """See the module. All arithmetic uses plain numbers: numpy's overhead would dominate for so few.

    loop_s: delay of camera and display that predictions must cover.
    """

    def __init__(self, tuning: Tuning | None = None, loop_s: float = 0.0) -> None:
        self._tuning, self._loop_s = tuning or Tuning(), loop_s
        super().__init__()

    def _start(self, t_ns: int, measured: Points) -> None:
        (lx, ly), (rx, ry) = measured.tolist()
        half = (lx - rx) / 2, (ly - ry) / 2
        apart = max(2 * math.hypot(*half), 1.0)
        self._halves, self._half = [half], half
        self._noise = (self._tuning.first * apart) ** 2  # variance of the half distance, px^2
        spread = self._noise * self._tuning.common**2
        x, y = (lx + rx) / 2, (ly + ry) / 2
        fast = (FIRST_SPEED * apart) ** 2
        motions = (None, *self._tuning.motions)
        self._models = [
            _Model(motion, x, y, 0.0, 0.0, spread, 0.0, fast if motion else 0.0, 1 / len(motions)) for motion in motions
        ]
        self._extrapolation = Extrapolation(self._loop_s)
        self._held: Pair | None = None
        self._used_ns = t_ns

    def _step(self, t_ns: int, dt_s: float, measured: Points) -> tuple[Points, Points]:
        (lx, ly), (rx, ry) = measured.tolist()
        x, y = (lx + rx) / 2, (ly + ry) / 2
        (plx, ply), (prx, pry) = self._position.tolist()
        u, v = self._velocity[0].tolist()
        px, py = u * dt_s, v * dt_s
        used_s = (t_ns - self._used_ns) / 1e9
        off = max(math.hypot(lx - plx - px, ly - ply - py), math.hypot(rx - prx - px, ry - pry - py))
        apart = max(2 * math.hypot(*self._half), 1.0)
        if off > (STEP + STEP_S2 * used_s * used_s) * apart and not self._confirmed(
            x, y, (plx + prx) / 2 + px, (ply + pry) / 2 + py
        ):
            self._held = x, y
            return self._position + self._velocity * dt_s, self._velocity
        self._held, self._used_ns = None, t_ns
        half = (lx - rx) / 2, (ly - ry) / 2
        apart = max(2 * math.hypot(*half), 1.0)
        self._measure_noise(half, apart, used_s)
        self._update(x, y, apart, used_s)
        self._follow_half(half)
        mx = my = u = v = 0.0
        for model in self._models:
            share, motion = model.share, model.motion
            mx, my = mx + share * model.x, my + share * model.y
            if motion is not None:
                share *= motion.trust
                u, v = u + share * model.u, v + share * model.v
        band = (30 * self._tuning.speed_band) ** 2 * self._noise  # a smaller speed may be noise
        fast = (u * u + v * v) / max(u * u + v * v + band, 1e-300)
        u, v = self._extrapolation.corrected(t_ns, used_s, (mx, my), (fast * u, fast * v), (x, y), apart)
        hx, hy = self._half
        return np.array(((mx + hx, my + hy), (mx - hx, my - hy))), np.array(((u, v), (u, v)))

    def _confirmed(self, x: float, y: float, ahead_x: float, ahead_y: float) -> bool:
        """Whether a step that no head makes is one, because the frame before showed it already: a landmark is wrong only once."""
        if self._held is None:
            return False
        return math.hypot(x - self._held[0], y - self._held[1]) < math.hypot(x - ahead_x, y - ahead_y)

    def _measure_noise(self, half: Pair, apart: float, dt_s: float) -> None:
        """The variance of a third difference is 20 times that of its input. A glitch counts as at most three standard
        deviations."""
        halves = self._halves
        halves.append(half)
        if len(halves) < 4:
            return
        (x0, y0), (x1, y1), (x2, y2), (x3, y3) = halves
        del halves[0]
        variance = ((x3 - 3 * x2 + 3 * x1 - x0) ** 2 + (y3 - 3 * y2 + 3 * y1 - y0) ** 2) / 40
        self._noise += (min(variance, 9 * self._noise) - self._noise) * min(dt_s / self._tuning.noise_s, 1.0)
        self._noise = max(self._noise, (self._tuning.least * apart) ** 2)

    def _update(self, x: float, y: float, apart: float, dt_s: float) -> None:
        """One cycle of the models: mix, predict, compare with the point (x, y) between the eyes, and update the weights.

        Moments are taken about the measurement, so that the mixture of each model follows from common sums.
        """
        tuning, models = self._tuning, self._models
        count = len(models)
        noise = self._noise * tuning.common**2 * max(1 / (RATE_HZ * dt_s), 1.0) ** (2 * tuning.rate_common)
        stay = math.exp(-dt_s / tuning.stay_s)
        leave = (1 - stay) / (count - 1)
        extra = stay - leave
        total = sx = sy = su = sv = sa = sb = sc = 0.0
        for model in models:
            share, dx, dy, u, v = model.share, model.x - x, model.y - y, model.u, model.v
            model.x, model.y = dx, dy
            model.a += (dx * dx + dy * dy) / 2
            model.b += (dx * u + dy * v) / 2
            model.c += (u * u + v * v) / 2
            total, sx, sy, su, sv = total + share, sx + share * dx, sy + share * dy, su + share * u, sv + share * v
            sa, sb, sc = sa + share * model.a, sb + share * model.b, sc + share * model.c
        logs, best = [], -math.inf
        for model in models:
            own = extra * model.share
            prior = leave * total + own
            dx, dy = (leave * sx + own * model.x) / prior, (leave * sy + own * model.y) / prior
            u, v = (leave * su + own * model.u) / prior, (leave * sv + own * model.v) / prior
            a = max((leave * sa + own * model.a) / prior - (dx * dx + dy * dy) / 2, 0.0)
            b = (leave * sb + own * model.b) / prior - (dx * u + dy * v) / 2
            c = max((leave * sc + own * model.c) / prior - (u * u + v * v) / 2, 0.0)
            if model.motion is None:
                u = v = b = c = 0.0
                a += tuning.wander * apart**2 * dt_s
            else:  # white acceleration of density q, exactly
                q = model.motion.acceleration * apart**2
                dx, dy = dx + u * dt_s, dy + v * dt_s
                a += dt_s * (2 * b + dt_s * (c + q * dt_s / 3))
                b += dt_s * (c + q * dt_s / 2)
                c += q * dt_s
            a = max(a, 0.0)
            spread = a + noise
            log = -tuning.caution * ((dx * dx + dy * dy) / (2 * spread) + math.log(spread))
            best = max(best, log)
            logs.append((prior, log))
            to_speed, kept = b / spread, noise / spread
            model.x, model.y = x + dx * kept, y + dy * kept
            model.u, model.v = u - to_speed * dx, v - to_speed * dy
            model.a, model.b, model.c = a * kept, b * kept, max(c - to_speed * b, 0.0)
        total = 0.0
        for model, (prior, log) in zip(models, logs, strict=True):
            model.share = prior * math.exp(max(log - best, -60.0))
            total += model.share
        for model in models:
            model.share /= total

    def _follow_half(self, half: Pair) -> None:
        """Passes large changes of the half distance unchanged, and attenuates changes within its noise band."""
        dx, dy = half[0] - self._half[0], half[1] - self._half[1]
        off = dx * dx + dy * dy
        share = off / max(off + self._noise * self._tuning.half_band**2, 1e-300)
        self._half = self._half[0] + share * dx, self._half[1] + share * dy
