"""Filters on the eyes of real people: what is shown beside where the eyes were.

    python -m profiling.eyes_tracks FOLDER [--loop-ms 80] [--camera-hz 60]

FOLDER holds tracks, one CSV a clip: t_s, face, left_x, left_y, right_x, right_y, in px, as measured
in every frame. Each stretch of more than 60 frames with a face runs offline as the pipeline runs
it: measurements 10 ms old, a refresh every 1/60 s, eyes predicted to its middle; the paper's way,
the mean of five, changes with the camera's frames instead. Truth is the track smoothed
without causality: at each frame the parabola through its neighbours, weighted by a Gaussian of 50
ms. With --loop-ms light leaves the screen that much later, and the eyes are predicted to that
moment. With --camera-hz the truth is measured at that rate, with the residuals of the real frames
in random order as noise.

Figures are medians over the stretches, in % of the distance between the eyes, RMS over both eyes
and every 2 ms: moving (over 0.5 distances/s), still (under 0.1 for 0.2 s), step from picture to
picture while still, how far ahead of a head that has just stopped the eyes are shown (after it fell
from 1.0 to 0.25 distances/s, for 0.2 s), and all. Then, by stretch, the error over all time.
"""

import copy
import csv
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Track
from lfpipe.track.filters import make_filter
from lfpipe.track.smoothing import EyeFilter, Mean
from profiling.arguments import existing, parser_of, start

REFRESH_S = 1 / 60
AGE_S = 0.010
SMOOTH_S = 0.05
FINE_S = 0.002
LEAST_FRAMES = 60
Float = NDArray[np.float64]


class Clip:
    """One stretch: t_s (n,), eyes (n, 4) px; and the truth at fine times."""

    def __init__(self, name: str, t_s: Float, eyes: Float) -> None:
        self.name = name
        self.t_s = t_s - t_s[0]
        self.eyes = eyes
        self.apart_px = float(np.median(np.hypot(eyes[:, 0] - eyes[:, 2], eyes[:, 1] - eyes[:, 3])))
        smooth, slope = self._smoothed()
        self.fine_s = np.arange(0.6, self.t_s[-1] - 0.05, FINE_S)
        k = np.clip(np.searchsorted(self.t_s, self.fine_s, side="right") - 1, 0, len(t_s) - 2)
        h = (self.t_s[k + 1] - self.t_s[k])[:, None]
        u = (self.fine_s - self.t_s[k])[:, None] / h
        ends = (1 + 2 * u) * (1 - u) ** 2 * smooth[k] + u * u * (3 - 2 * u) * smooth[k + 1]
        self.truth = ends + u * (1 - u) ** 2 * h * slope[k] + u * u * (u - 1) * h * slope[k + 1]
        self.velocity = np.gradient(self.truth, FINE_S, axis=0)
        self.speed = np.sqrt(np.square(self.velocity).sum(axis=1) / 2) / self.apart_px
        slow = np.cumsum(np.r_[0, self.speed < 0.1])
        half = int(0.1 / FINE_S)
        low, high = (
            np.clip(np.arange(len(self.fine_s)) + off, 0, len(self.fine_s))
            for off in (-2 * half, half)
        )
        self.still = slow[high] - slow[low] == high - low

    def _smoothed(self) -> tuple[Float, Float]:
        smooth, slope = np.empty_like(self.eyes), np.empty_like(self.eyes)
        for i, t in enumerate(self.t_s):
            away = self.t_s - t
            # the square root of the Gaussian
            weight = np.exp(-0.25 * (away / SMOOTH_S) ** 2)[:, None]
            powers = np.stack([np.ones_like(away), away, away**2], axis=1)
            smooth[i], slope[i] = np.linalg.lstsq(powers * weight, self.eyes * weight, rcond=None)[
                0
            ][:2]
        return smooth, slope

    def measured(self, rate_hz: float) -> "Clip":
        """The same truth as a camera of that rate measures it."""
        other = copy.copy(self)
        rng = np.random.default_rng(1)
        other.t_s = np.arange(self.fine_s[0], self.fine_s[-1], 1 / rate_hz)
        k = np.clip(np.searchsorted(self.fine_s, other.t_s), 0, len(self.fine_s) - 1)
        noise = self.eyes - self._smoothed()[0]
        other.eyes = self.truth[k] + noise[rng.integers(len(noise), size=len(k))]
        return other

    def stops(self) -> list[tuple[int, Float]]:
        """(place in fine_s, direction) of each time that a fast head has become slow."""
        found = []
        fast = -(10**9)
        for i in range(1, len(self.speed)):
            fast = i if self.speed[i] > 1.0 else fast
            if self.speed[i] < 0.25 <= self.speed[i - 1] and i - fast < 0.3 / FINE_S:
                found.append((i, self.velocity[fast] / np.linalg.norm(self.velocity[fast])))
        return found


def clips(folder: Path) -> list[Clip]:
    out = []
    for path in sorted(folder.glob("*.csv")):
        with path.open(newline="") as file:
            rows = list(csv.DictReader(file))
        start = 0
        for end in range(len(rows) + 1):
            if end < len(rows) and rows[end]["face"] == "1":
                continue
            part = rows[start:end]
            start = end + 1
            if len(part) > LEAST_FRAMES:
                eyes = [
                    [float(row[name]) for name in ("left_x", "left_y", "right_x", "right_y")]
                    for row in part
                ]
                out.append(
                    Clip(path.stem, np.array([float(row["t_s"]) for row in part]), np.array(eyes))
                )
    return out


def shown(clip: Clip, one: EyeFilter, display: bool, loop_s: float = 0.0) -> tuple[Float, Float]:
    """When the light of pictures appeared, and the eyes (n, 4) that they were made for."""
    times: list[float] = []
    used: list[Float] = []
    due_s = clip.t_s[0] + 0.003
    i = 0
    if not display:
        return clip.t_s + AGE_S + loop_s, np.array(
            [
                one.update(round(t * 1e9), eyes.reshape(2, 2))[0].ravel()
                for t, eyes in zip(clip.t_s, clip.eyes, strict=True)
            ]
        )
    while due_s < clip.t_s[-1]:
        while i < len(clip.t_s) and clip.t_s[i] + AGE_S <= due_s:
            one.update(round(clip.t_s[i] * 1e9), clip.eyes[i].reshape(2, 2))
            i += 1
        if i:
            times.append(due_s + loop_s)
            used.append(one.predict(round((due_s + REFRESH_S / 2 + loop_s) * 1e9)).ravel())
        due_s += REFRESH_S
    return np.array(times), np.array(used)


def figures(clip: Clip, times: Float, used: Float) -> list[float]:
    """moving, still, step, overshoot, all; NaN where the clip has none of it."""
    k = np.clip(np.searchsorted(times, clip.fine_s, side="right") - 1, 0, None)
    off = used[k] - clip.truth
    square = np.square(off).sum(axis=1) / 2

    def rms(values: Float) -> float:
        return 100 * math.sqrt(values.mean()) / clip.apart_px if len(values) > 40 else math.nan

    seen = np.unique(k[clip.still])
    seen = seen[seen > 0]
    steps = np.square(used[seen] - used[seen - 1]).sum(axis=1) / 2
    step = 100 * math.sqrt(steps.mean()) / clip.apart_px if len(steps) > 5 else math.nan
    ahead = [
        float((off[i : i + int(0.2 / FINE_S)] @ way).max()) / math.sqrt(2)
        for i, way in clip.stops()
    ]
    over = 100 * float(np.median(ahead)) / clip.apart_px if ahead else math.nan
    return [rms(square[clip.speed > 0.5]), rms(square[clip.still]), step, over, rms(square)]


def table(
    found: list[Clip], ways: list[tuple[str, Callable[[], EyeFilter], bool]], loop_s: float
) -> dict[str, Float]:
    """figures (stretches, 5) of every filter: (name, its maker, whether it predicts on the
    display's clock).
    """
    return {
        name: np.array([figures(clip, *shown(clip, make(), display, loop_s)) for clip in found])
        for name, make, display in ways
    }


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=existing)
    parser.add_argument("--loop-ms", type=float, default=0.0)
    parser.add_argument("--camera-hz", type=float, default=0.0)
    given = parser.parse_args()
    loop_s = given.loop_ms / 1000
    found = clips(given.folder)
    if given.camera_hz:
        found = [clip.measured(given.camera_hz) for clip in found]
    ways: list[tuple[str, Callable[[], EyeFilter], bool]] = [
        ("paper, mean 5", lambda: Mean(5), False),
        ("none", lambda: Mean(1), True),
        ("one-euro", lambda: make_filter(Track(filter="one-euro")), True),
        ("kalman", lambda: make_filter(Track(filter="kalman")), True),
        ("predictive", lambda: make_filter(Track(), loop_s), True),
    ]
    every = table(found, ways, loop_s)
    print(f"| filter | moving | still | step | overshoot | all |\n|---|{'---:|' * 5}")
    for name, rows in every.items():
        print(
            f"| {name} | "
            + " | ".join(f"{value:.2f}" for value in np.nanmedian(rows, axis=0))
            + " |"
        )
    print(
        f"\n| all time | {' | '.join(clip.name for clip in found)} |\n|---|{'---:|' * len(found)}"
    )
    for name in ("paper, mean 5", "none", "predictive"):
        print(f"| {name} | {' | '.join(f'{value:.2f}' for value in every[name][:, 4])} |")


if __name__ == "__main__":
    start(main)
