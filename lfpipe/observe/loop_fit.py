"""The model of a camera that sees a flipping screen, and its least-squares fit.

Fitted by damped least squares (Levenberg 1944, Marquardt 1963): delay, time from row to row, exposure, response, gamma and stray
light, with an amplitude for each band of rows. The interval comes from the delay's profile likelihood, so it stays valid if the
likelihood is flat: a short exposure in step with the screen sees only black or white, and shows little of the time between.
"""

from typing import NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray

SLOW_S = 1.0  # slower changes come from the room's light and automatic exposure
BANDS = 6  # of rows: enough for the time from row to row
MODEL_MS = 0.35  # error of the delay from a non-exponential pixel response, in simulated recordings

Float = NDArray[np.float64]


@attrs.frozen
class Recording:
    """t_flip_ns: int64 (m,), times at which the screen presented another level; bright: bool (m,), that level. t_frame_ns: int64
    (n,), the camera's stamps. pictures: uint8 (n, height, width), small grey pictures. stamped: the stamps come from the driver,
    not from the time of reading. refresh_ms: period of the screen."""

    t_flip_ns: NDArray[np.int64]
    bright: NDArray[np.bool_]
    t_frame_ns: NDArray[np.int64]
    pictures: NDArray[np.uint8]
    stamped: bool
    refresh_ms: float


def without_slow(series: Float, frames: int) -> Float:
    """series (n, ...) minus its running mean over this many frames."""
    n, half = len(series), frames // 2
    sums = np.concatenate([np.zeros((1, *series.shape[1:])), np.cumsum(series, axis=0)])
    low, high = np.maximum(np.arange(n) - half, 0), np.minimum(np.arange(n) + half + 1, n)
    means = (sums[high] - sums[low]) / (high - low).reshape(-1, *[1] * (series.ndim - 1))
    return np.asarray(series - means)


def times_ms(recording: Recording) -> tuple[Float, Float]:
    """Stamps and flips from the first flip on."""
    zero = recording.t_flip_ns[0]
    return (recording.t_frame_ns - zero) / 1e6, (recording.t_flip_ns - zero) / 1e6


class ScreenLight:
    """The screen's light over time, 0..1, integrated exactly. tau_ms: of the pixels' exponential response."""

    def __init__(self, flips_ms: Float, bright: NDArray[np.bool_], tau_ms: float) -> None:
        self._flips_ms, self._goal, self._tau_ms = flips_ms, bright.astype(float), tau_ms
        gaps = np.diff(flips_ms)
        decay = np.exp(-gaps / tau_ms)
        above = np.empty(len(flips_ms))  # light above its goal at each flip
        above[0] = 1.0 - 2.0 * self._goal[0]
        for j in range(len(gaps)):
            above[j + 1] = self._goal[j] + above[j] * decay[j] - self._goal[j + 1]
        self._above = above
        steps = self._goal[:-1] * gaps + above[:-1] * tau_ms * (1 - decay)
        self._sum = np.concatenate([[0.0], np.cumsum(steps)])

    def integral(self, t_ms: Float) -> Float:
        at = np.clip(np.searchsorted(self._flips_ms, t_ms, "right") - 1, 0, None)
        since = np.maximum(t_ms - self._flips_ms[at], 0.0)
        fading = self._tau_ms * -np.expm1(-since / self._tau_ms)
        return np.asarray(self._sum[at] + self._goal[at] * since + self._above[at] * fading)

    def mean(self, t_ms: Float, width_ms: float) -> Float:
        """The mean light within width_ms around each of t_ms."""
        return (self.integral(t_ms + width_ms / 2) - self.integral(t_ms - width_ms / 2)) / width_ms


class Solution(NamedTuple):
    """A vector of `LoopFit` and half its sum of squares."""

    vector: Float
    cost: float


class LoopFit:
    """Least squares for a vector of delay (ms), time over the picture's height (ms), log exposure, log response, log gamma, log
    stray light. row: position of the screen, from -0.5 at the top of the picture to 0.5."""

    PRIOR = np.array([0.0, 15.0, np.log(12.0), np.log(2.0), np.log(2.1), np.log(0.05)])
    SPREAD = np.array([np.inf, 30.0, np.inf, 0.8, 0.2, 1.5])
    STEP = np.array([0.05, 0.2, 0.02, 0.05, 0.02, 0.05])
    LOW = np.array([-100.0, -200.0, np.log(0.3), np.log(0.1), np.log(1.0), np.log(1e-3)])
    HIGH = np.array([500.0, 200.0, np.log(200.0), np.log(20.0), np.log(3.5), np.log(10.0)])

    def __init__(self, recording: Recording, weights: Float) -> None:
        """weights: float (height, width), 0 outside the screen's area."""
        self._times, self._flips = times_ms(recording)
        self._bright, self._period = recording.bright, float(np.median(np.diff(self._times)))
        self._slow = max(3, round(SLOW_S * 1e3 / self._period))
        rows, height = np.nonzero(weights.any(axis=1))[0], len(weights)
        series, places, masses = [], [], []
        for band in np.array_split(rows, min(BANDS, len(rows))):
            share = weights[band]
            series.append(np.einsum("nhw,hw->n", recording.pictures[:, band].astype(float), share) / share.sum())
            places.append(float((share.sum(axis=1) * (band + 0.5)).sum() / share.sum()) / height - 0.5)
            masses.append(float(share.sum()))
        self._seen = without_slow(np.stack(series, axis=1), self._slow)
        self.row = float(np.average(places, weights=masses))
        self._extent = (rows[-1] + 1 - rows[0]) / height
        self._places = np.array(places) - self.row
        self._sigma = np.full(len(places), np.maximum(self._seen.std(axis=0), 1e-6))

    def _model(self, vector: Float) -> Float:
        delay, slope, width, tau, gamma, stray = vector
        light = ScreenLight(self._flips, self._bright, float(np.exp(tau)))
        # the response's mean is tau after the flip, and is part of the delay
        at = self._times[:, None] - (delay - np.exp(tau)) + slope * self._places
        x = light.mean(at, float(np.exp(width)))
        return without_slow((np.clip(x, 0, 1) + np.exp(stray)) ** np.exp(-gamma), self._slow)

    def _residuals(self, vector: Float) -> Float:
        light = self._model(vector)
        size = np.maximum((light * self._seen).sum(axis=0) / np.maximum(np.square(light).sum(axis=0), 1e-12), 0)
        off = (self._seen - size * light) / self._sigma
        return np.concatenate([off.ravel(), (vector - self.PRIOR) / self.SPREAD])

    def explained(self, vector: Float) -> float:
        """R squared."""
        return 1 - self.unexplained(vector) * self._seen.size / float(np.square(self._seen).sum())

    def unexplained(self, vector: Float) -> float:
        """Mean square of the residuals, levels squared."""
        off = self._residuals(vector)[: self._seen.size].reshape(self._seen.shape) * self._sigma
        return float(np.square(off).mean())

    def _minimised(self, vector: Float, steps: int, held: int = 0) -> Solution:
        """Marquardt's steps over the entries from `held` on."""
        damping, off = 1e-2, self._residuals(vector)
        free = np.arange(held, len(vector))
        cost = float(off @ off)
        for _ in range(steps):
            slopes = np.stack([(self._residuals(vector + self.STEP * (free[k] == np.arange(6))) - off) / self.STEP[free[k]]
                               for k in range(len(free))], axis=1)  # fmt: skip
            normal, right = slopes.T @ slopes, slopes.T @ off
            for _ in range(4):
                move = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-9), right)
                tried = vector.copy()
                tried[free] = np.clip(vector[free] - move, self.LOW[free], self.HIGH[free])
                tried_off = self._residuals(tried)
                if (tried_cost := float(tried_off @ tried_off)) < cost:
                    break
                damping *= 6
            else:
                break
            gained = cost - tried_cost
            vector, off, cost, damping = tried, tried_off, tried_cost, damping / 4
            if gained < 1e-4 * cost / len(off):
                break
        return Solution(vector, cost)

    def solved(self, delay_ms: float, width_ms: float) -> Solution:
        """The best vector near these."""
        start = self.PRIOR.copy()
        start[0], start[2] = delay_ms, np.log(width_ms)
        self._sigma = np.full(len(self._places), np.maximum(self._seen.std(axis=0), 1e-6)) * 0.2
        return self._minimised(start, 25)

    def interval(self, vector: Float) -> tuple[float, float, float]:
        """5 %, mean and 95 % of the delay, by its profile likelihood under a flat prior."""
        off = self._residuals(vector)[: self._seen.size].reshape(self._seen.shape) * self._sigma
        self._sigma = np.maximum(off.std(axis=0), 0.05)
        best, least = self._minimised(vector, 10)
        weight = len(self._times) / self._seen.size  # bands share the errors of stamps: as independent as one band
        span = 0.1
        while True:
            grid = best[0] + span * np.linspace(-1, 1, 21)
            costs = np.empty(len(grid))
            for half in (range(10, 21), range(10, -1, -1)):
                near = best
                for k in half:
                    near = near.copy()
                    near[0] = grid[k]
                    near, costs[k] = self._minimised(near, 3, held=1)
            edges = weight * (min(costs[0], costs[-1]) - min(costs.min(), least)) / 2
            if edges > 5 or span > 20:
                break
            span *= 2
        chances = np.exp(-weight * (costs - costs.min()) / 2)
        sums = np.concatenate([[0.0], np.cumsum((chances[1:] + chances[:-1]) / 2)])
        low, high = np.interp([0.05, 0.95], sums / sums[-1], grid)
        return float(low), float((chances * grid).sum() / chances.sum()), float(high)

    def to_middle_row(self, vector: Float, refresh_ms: float) -> tuple[float, float]:
        """The correction of the delay to the middle row of the picture, and its uncertainty.

        The time from row to row is the camera's readout minus the screen's own scan, both unknown: the screen takes up to a
        refresh for its visible height, the camera up to a frame for its picture.
        """
        low = max(0.0, vector[1])
        high = min(max(vector[1] + refresh_ms / self._extent, low), max(self._period, low))
        return (low + high) / 2 * self.row, abs(self.row) * (high - low) / 2 + MODEL_MS
