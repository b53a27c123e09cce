"""The filters by their names in the configuration, and the default one: several models of head
motion, run in parallel and weighted by how well each predicts.

Interacting multiple models (Blom and Bar-Shalom 1988; Bar-Shalom, Li, Kirubarajan 2001, section
11.6.6), on the point midway between the eyes: one model of rest, which dominates at rest, so that
noise does not move the picture; the others of constant velocity under accelerations of different
strength, which take over within a frame. The half distance is smoothed separately.

The noise is measured while running, from third differences of the half distance, in which head
motion cancels. Constants are in distances between the eyes and in seconds, so they hold for any
camera and viewer (profiling/results/eyes.md).
"""

import math
from collections import deque
from types import NoneType

import attrs
import numpy as np

from lfpipe.config import Track
from lfpipe.plugins import FILTERS, make
from lfpipe.track.smoothing import EyeFilter, Kalman, Mean, OneEuro, Points

Pair = tuple[float, float]

# distances between the eyes per second (500 mm/s):
# all that is known of a face that has just appeared
FIRST_SPEED = 8.0
RATE_HZ = 30.0  # of the recordings that the constants were chosen on
# No head is further from its prediction than this, in distances between the eyes: 20 m/s^2, and
# twice the worst of real heads.
STEP, STEP_S2 = 0.12, 158.0
# Horizon of predictions without a loop: age of the frame, a camera period, half a refresh; the best
# of 0.05 to 0.1 on real heads.
FRAME_S = 0.07
SMOOTH_S = 0.03  # time constant of the acceleration: about one frame of a webcam
MEMORY_S = 10.0  # of what is learnt: a person's way of moving changes slowly
MAX_GAINED = 2.0  # by one line, times what it adds; more is a glitch of the landmarks
# Squared distances between the eyes that a line of velocity or of acceleration adds at most;
# landmarks that jump add more.
MAX_MOVED, MAX_BENT = 1.0, 0.1
# A velocity whose change over the delay is small beside it is used in full, whatever the share: a
# head at constant speed does not lag. The change is that of the last STEADY_S.
STEADY, STEADY_S = 6.0, 0.15
# Motion since the last DRIFT_S: DRIFT of the way from there, or the speed times 1 / RATE_HZ.
DRIFT, DRIFT_S = 0.6, 0.13
# What lets the way that is predicted grow in a frame: a share of the frame's surprise, of the
# velocity that this and the last surprise agree on, and of the last frame's growth.
# A glitch is seen once.
ONCE, AGAIN, GROWING = 0.7, 0.9, 1.5
# The same as evidence: less than this leaves velocity at its full share, and acceleration near 0.
UNPROVEN, NOTHING = 0.05, 0.01
# a delay of camera and display after which a line adds so
# much more that twice as much must be proved
UNPROVEN_S = 0.1


@attrs.frozen(kw_only=True)
class Tuning:
    """Constants of the filter, by the rule in profiling/results/eyes.md.

    accelerations: densities of the noise of acceleration of the models that move, squared distances
    between the eyes per s^3. wander: variance of the drift of a head at rest, squared distances
    between the eyes per s. stay_s: mean time in a model. common: noise of the point between the
    eyes divided by that of their half distance. blur_s: noise of a moving point, divided by its
    speed: stamps and exposures are not exact. caution: exponent of the likelihoods, because noise
    is correlated between frames. half_band: changes of the half distance below this many standard
    deviations count as noise. motion_band: the same for motion over DRIFT_S. noise_s: time constant
    of the noise estimate. first, least: initial and smallest noise, in distances between the eyes.
    rate_common: `common` grows with this power of the frame rate above 30 Hz, because each picture
    then shows another measurement and its step is seen.
    """

    accelerations: tuple[float, ...] = (1.0, 3.5, 85.0)
    wander: float = 1.5e-5
    stay_s: float = 0.7
    common: float = 2.2
    blur_s: float = 0.0035
    caution: float = 0.175
    half_band: float = 4.5
    motion_band: float = 9.0
    noise_s: float = 2.6
    first: float = 1.5e-3
    least: float = 1e-3
    rate_common: float = 0.2


@attrs.define(kw_only=True)
class _Model:
    """State of one model: position and velocity (px, px/s) along both axes, one covariance for both
    axes, and its weight.
    """

    acceleration: float | None  # density of its noise; None: the model of rest
    x: float
    y: float
    u: float
    v: float
    a: float
    b: float
    c: float
    share: float


class Extrapolation:
    """Corrects velocities by what has improved predictions. All in px; a new run of the filter
    needs a new one.

    At constant acceleration a, the mean velocity over the next h seconds is v + a h / 2. Reaches
    and swaying follow that. A nod turns within a tenth of a second: there an acceleration carries
    too far, and over a long delay a velocity does, too. So the shares of both that are used are
    least-squares factors, measured over the delay that predictions cover: of velocity between where
    the head went and where the velocity pointed, of acceleration between what that missed and what
    acceleration would have added. device_latency_s: delay of camera and display.
    """

    def __init__(self, device_latency_s: float) -> None:
        self._prediction_ns = round((FRAME_S + device_latency_s) * 1e9)
        self._velocity = self._acceleration = (0.0, 0.0)
        # stamp, position, velocity, acceleration
        self._lines: deque[tuple[int, Pair, Pair, Pair]] = deque()
        self._unproven = unproven = UNPROVEN * (1 + device_latency_s / UNPROVEN_S)
        self._moved = self._pointed = unproven
        self._gained = self._bent = 0.0
        self._change = 0.0  # of the velocity over the horizon, low-passed, px/s

    def corrected(
        self,
        t_ns: int,
        dt_s: float,
        position: Pair,
        velocity: Pair,
        measured: Pair,
        eye_distance_px: float,
    ) -> Pair:
        """The velocity to predict with from t_ns on.

        position, velocity: estimates at t_ns, px and px/s. measured: the eyes' midpoint at t_ns,
        px. dt_s: since the last one.
        """
        share = dt_s / (dt_s + SMOOTH_S)
        (ax, ay), (ux, uy) = self._acceleration, self._velocity
        ax += share * ((velocity[0] - ux) / dt_s - ax)
        ay += share * ((velocity[1] - uy) / dt_s - ay)
        keep = math.exp(-dt_s / MEMORY_S)
        unproven = self._unproven
        self._moved = unproven + keep * (self._moved - unproven)
        self._pointed = unproven + keep * (self._pointed - unproven)
        self._gained, self._bent = keep * self._gained, keep * self._bent
        while self._lines and t_ns - self._lines[0][0] > self._prediction_ns:
            self._score(t_ns, measured, eye_distance_px * eye_distance_px)
        self._velocity = velocity
        self._acceleration = (ax, ay)
        self._lines.append((t_ns, position, velocity, (ax, ay)))
        speed = min(max(self._moved / self._pointed, 0.0), 1.0)
        change = math.hypot(ax, ay) * self._prediction_ns / 1e9
        self._change += dt_s / (dt_s + STEADY_S) * (change - self._change)
        square = velocity[0] * velocity[0] + velocity[1] * velocity[1]
        speed += (1 - speed) * square / max(square + (STEADY * self._change) ** 2, 1e-300)
        ahead_s = (
            self._prediction_ns / 2e9 * min(max(self._gained / (self._bent + NOTHING), 0.0), 1.0)
        )
        return speed * velocity[0] + ahead_s * ax, speed * velocity[1] + ahead_s * ay

    def _score(self, t_ns: int, measured: Pair, unit: float) -> None:
        """Compares the oldest line with the measurement that it predicted.

        unit: squared px of one distance between the eyes.
        """
        began_ns, (x, y), (u, v), (ax, ay) = self._lines.popleft()
        ahead_s = (t_ns - began_ns) / 1e9
        bend = ahead_s * ahead_s / 2
        share = min(max(self._moved / self._pointed, 0.0), 1.0)
        dx = measured[0] - x
        dy = measured[1] - y
        px = u * ahead_s
        py = v * ahead_s
        pointed, moved = _proof(px, py, dx, dy, unit, MAX_MOVED)
        self._pointed += pointed
        self._moved += moved
        bent, gained = _proof(
            ax * bend, ay * bend, dx - share * px, dy - share * py, unit, MAX_BENT
        )
        self._bent += bent
        self._gained += gained


def _proof(x: float, y: float, dx: float, dy: float, unit: float, most: float) -> Pair:
    """What a motion by (x, y) px that was predicted, and one by (dx, dy) that came, add to the sums
    whose ratio is the share to use. most: the length, squared, from which on they count less.
    """
    length, along = (x * x + y * y) / unit, (dx * x + dy * y) / unit
    weight = 1 / (1 + length / most) ** 2
    return weight * length, weight * min(max(along, -MAX_GAINED * length), MAX_GAINED * length)


class ImmFilter(EyeFilter):
    """See the module. All arithmetic uses plain numbers: numpy's overhead would dominate for so
    few.

    device_latency_s: delay of camera and display that predictions must cover.
    """

    def __init__(self, tuning: Tuning | None = None, device_latency_s: float = 0.0) -> None:
        self._tuning = tuning or Tuning()
        self._device_latency_s = device_latency_s
        super().__init__()

    def _start(self, t_ns: int, measured: Points) -> None:
        (lx, ly), (rx, ry) = measured.tolist()
        half = (lx - rx) / 2, (ly - ry) / 2
        eye_distance = max(2 * math.hypot(*half), 1.0)
        self._halves = [half]
        self._half = half
        self._noise = (
            self._tuning.first * eye_distance
        ) ** 2  # variance of the half distance, px^2
        spread = self._noise * self._tuning.common**2
        x, y = (lx + rx) / 2, (ly + ry) / 2
        fast = (FIRST_SPEED * eye_distance) ** 2
        motions = (None, *self._tuning.accelerations)
        self._models = [
            _Model(
                acceleration=motion,
                x=x,
                y=y,
                u=0.0,
                v=0.0,
                a=spread,
                b=0.0,
                c=fast if motion else 0.0,
                share=1 / len(motions),
            )
            for motion in motions
        ]
        self._moving = 0.0, 0.0  # velocity of the models together
        self._before = x, y  # the low-passed position
        self._surprise = 0.0, 0.0  # of the last frame
        self._growth = 0.0, 0.0  # of the velocity in the last frame
        self._extrapolation = Extrapolation(self._device_latency_s)
        self._held: Pair | None = None
        self._used_ns = t_ns

    def _step(self, t_ns: int, dt_s: float, measured: Points) -> tuple[Points, Points]:
        (lx, ly), (rx, ry) = measured.tolist()
        x, y = (lx + rx) / 2, (ly + ry) / 2
        (plx, ply), (prx, pry) = self._position.tolist()
        u, v = self._velocity[0].tolist()
        px, py = u * dt_s, v * dt_s
        used_s = (t_ns - self._used_ns) / 1e9
        off = max(
            math.hypot(lx - plx - px, ly - ply - py), math.hypot(rx - prx - px, ry - pry - py)
        )
        eye_distance = max(2 * math.hypot(*self._half), 1.0)
        if off > (STEP + STEP_S2 * used_s * used_s) * eye_distance and not self._confirmed(
            x, y, (plx + prx) / 2 + px, (ply + pry) / 2 + py
        ):
            self._held = x, y
            return self._position + self._velocity * dt_s, self._velocity
        self._held = None
        self._used_ns = t_ns
        half = (lx - rx) / 2, (ly - ry) / 2
        eye_distance = max(2 * math.hypot(*half), 1.0)
        self._measure_noise(half, eye_distance, used_s)
        self._update(x, y, eye_distance, used_s)
        hx, hy = self._half
        dx, dy = half[0] - hx, half[1] - hy
        off = dx * dx + dy * dy
        # changes within the band of noise count less
        share = off / max(off + self._noise * self._tuning.half_band**2, 1e-300)
        self._half = hx, hy = hx + share * dx, hy + share * dy
        mx = my = u = v = 0.0
        for model in self._models:
            share = model.share
            mx, my = mx + share * model.x, my + share * model.y
            u, v = u + share * model.u, v + share * model.v
        self._moving = u, v
        was_x, was_y = self._before
        dx, dy = mx - was_x, my - was_y
        share = used_s / (used_s + DRIFT_S)
        self._before = was_x + share * dx, was_y + share * dy
        moved = max((dx * dx + dy * dy) * DRIFT**2, (u * u + v * v) / RATE_HZ**2)
        # a smaller motion may be noise
        noise = self._tuning.motion_band**2 * self._noise
        fast = moved * moved / max(moved * moved + noise * noise, 1e-300)
        velocity = self._extrapolation.corrected(
            t_ns, used_s, (mx, my), (fast * u, fast * v), (x, y), eye_distance
        )
        innovation = x - (plx + prx) / 2 - px, y - (ply + pry) / 2 - py
        u, v = self._believed(velocity, innovation, used_s)
        return np.array(((mx + hx, my + hy), (mx - hx, my - hy))), np.array(((u, v), (u, v)))

    def _believed(self, velocity: Pair, innovation: Pair, dt_s: float) -> Pair:
        """As much of a new velocity as the surprise (px, measured minus predicted) of this frame
        and the last one supports. A velocity that only falls is believed at once.
        """
        (u, v), (dx, dy), (last_x, last_y) = velocity, innovation, self._surprise
        self._surprise = innovation
        size = math.hypot(dx, dy)
        again = max(dx * last_x + dy * last_y, 0.0) / size if size > 0 else 0.0
        limit = ONCE * size / (FRAME_S + self._device_latency_s) + AGAIN * again / dt_s
        old_u, old_v = self._velocity[0].tolist()
        square = old_u * old_u + old_v * old_v
        kept = min(max((u * old_u + v * old_v) / square, 0.0), 1.0) if square > 0 else 0.0
        old_u, old_v = kept * old_u, kept * old_v
        du, dv = u - old_u, v - old_v
        last_u, last_v = self._growth
        self._growth = du, dv
        grown = math.hypot(du, dv)
        if grown > 0:
            limit += GROWING * max(du * last_u + dv * last_v, 0.0) / grown
        share = limit / grown if grown > limit else 1.0
        return old_u + share * du, old_v + share * dv

    def _confirmed(self, x: float, y: float, ahead_x: float, ahead_y: float) -> bool:
        """Whether a step that no head makes is one, because the frame before showed it already: a
        landmark is wrong only once.
        """
        if self._held is None:
            return False
        return math.hypot(x - self._held[0], y - self._held[1]) < math.hypot(
            x - ahead_x, y - ahead_y
        )

    def _measure_noise(self, half: Pair, eye_distance: float, dt_s: float) -> None:
        """The variance of a third difference is 20 times that of its input. A glitch counts as at
        most three standard deviations.
        """
        halves = self._halves
        halves.append(half)
        if len(halves) < 4:
            return
        (x0, y0), (x1, y1), (x2, y2), (x3, y3) = halves
        del halves[0]
        variance = ((x3 - 3 * x2 + 3 * x1 - x0) ** 2 + (y3 - 3 * y2 + 3 * y1 - y0) ** 2) / 40
        self._noise += (min(variance, 9 * self._noise) - self._noise) * min(
            dt_s / self._tuning.noise_s, 1.0
        )
        self._noise = max(self._noise, (self._tuning.least * eye_distance) ** 2)

    def _update(self, x: float, y: float, eye_distance: float, dt_s: float) -> None:
        """One cycle of the models: mix, predict, compare with the point (x, y) between the eyes,
        and update the weights.

        Moments are taken about the measurement, so that the mixture of each model follows from
        common sums.
        """
        tuning = self._tuning
        models = self._models
        count = len(models)
        noise = (
            self._noise
            * tuning.common**2
            * max(1 / (RATE_HZ * dt_s), 1.0) ** (2 * tuning.rate_common)
        )
        u, v = self._moving
        noise += (u * u + v * v) * tuning.blur_s**2
        stay = math.exp(-dt_s / tuning.stay_s)
        leave = (1 - stay) / (count - 1)
        extra = stay - leave
        total = sx = sy = su = sv = sa = sb = sc = 0.0
        for model in models:
            share = model.share
            dx = model.x - x
            dy = model.y - y
            u = model.u
            v = model.v
            model.x, model.y = dx, dy
            model.a += (dx * dx + dy * dy) / 2
            model.b += (dx * u + dy * v) / 2
            model.c += (u * u + v * v) / 2
            total = total + share
            sx = sx + share * dx
            sy = sy + share * dy
            su = su + share * u
            sv = sv + share * v
            sa, sb, sc = sa + share * model.a, sb + share * model.b, sc + share * model.c
        logs = []
        best = -math.inf
        for model in models:
            own = extra * model.share
            prior = leave * total + own
            dx, dy = (leave * sx + own * model.x) / prior, (leave * sy + own * model.y) / prior
            u, v = (leave * su + own * model.u) / prior, (leave * sv + own * model.v) / prior
            a = max((leave * sa + own * model.a) / prior - (dx * dx + dy * dy) / 2, 0.0)
            b = (leave * sb + own * model.b) / prior - (dx * u + dy * v) / 2
            c = max((leave * sc + own * model.c) / prior - (u * u + v * v) / 2, 0.0)
            if model.acceleration is None:
                u = v = b = c = 0.0
                a += tuning.wander * eye_distance**2 * dt_s
            else:  # white acceleration of density q, exactly
                q = model.acceleration * eye_distance**2
                dx, dy = dx + u * dt_s, dy + v * dt_s
                a += dt_s * (2 * b + dt_s * (c + q * dt_s / 3))
                b += dt_s * (c + q * dt_s / 2)
                c += q * dt_s
            a = max(a, 0.0)
            spread = a + noise
            log = -tuning.caution * ((dx * dx + dy * dy) / (2 * spread) + math.log(spread))
            best = max(best, log)
            logs.append((prior, log))
            to_speed = b / spread
            kept = noise / spread
            model.x, model.y = x + dx * kept, y + dy * kept
            model.u, model.v = u - to_speed * dx, v - to_speed * dy
            model.a = a * kept
            model.b = b * kept
            model.c = max(c - to_speed * b, 0.0)
        total = 0.0
        for model, (prior, log) in zip(models, logs, strict=True):
            model.share = prior * math.exp(max(log - best, -60.0))
            total += model.share
        for model in models:
            model.share /= total


def make_filter(track: Track, device_latency_s: float = 0.0) -> EyeFilter:
    """A new filter of the name in track.

    device_latency_s: delay of camera and display that predictions must cover.
    """
    name: str = track.filter
    if name == "predictive":
        return ImmFilter(device_latency_s=device_latency_s)
    if name == "mean":
        return Mean(track.mean_k)
    if name == "one-euro":
        return OneEuro(1.0, 2.0, 4.0)
    if name == "kalman":
        return Kalman(1e4)
    plugin: EyeFilter = make(
        FILTERS, name, {"update": tuple, "reset": NoneType}, track, device_latency_s
    )
    return plugin
