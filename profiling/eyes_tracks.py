"""Filters on the eyes of real people: what is shown beside where the eyes were.

    python -m profiling.eyes_tracks FOLDER [--half even] [--tables bad]

FOLDER holds tracks, one CSV a clip: t_s, face, left_x, left_y, right_x, right_y, in px, as measured
in every frame. Each stretch of more than 60 frames with a face runs offline as the pipeline runs
it: measurements 10 ms old, a refresh every 1/60 s, eyes predicted to its middle; the paper's way,
the mean of five, changes with the camera's frames instead. Truth is the track smoothed
without causality: at each frame the parabola through its neighbours, weighted by a Gaussian of 50
ms. The picture is seen 0, 40, 80 or 120 ms later, and the eyes are predicted to that time. Cameras
of 60 and 120 Hz measure the truth, with the residuals of the real frames in random order as noise.
--half takes every second stretch, from the first (even) or second (odd) one on.

Figures are medians over the stretches, in % of the distance between the eyes, RMS over both eyes
and every 2 ms: moving (over 0.5 distances/s), still (under 0.1 for 0.2 s), step from picture to
picture while still, how far ahead of a head that has just stopped the eyes are shown (after it fell
from 1.0 to 0.25 distances/s, for 0.2 s), and all. Then, by stretch, the error over all time. One
row of the clips as recorded is a bound, not a filter, chosen with each clip's own truth: the best
linear predictor from the last 8 steps.

The table of bad frames: every 2 s landmarks are wrong, in eye distances. How far that
moves the point between the eyes at most, in views (4 between the eyes), median stretch and worst.
"""

import copy
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.simulator.scripts import read_table
from lfpipe.config import FILTER_MODULES, Track
from lfpipe.track.filters.base import EyeFilter, make_filter
from lfpipe.track.filters.mean import Mean
from profiling.arguments import existing, parser_of, start

REFRESH_S = 1 / 60
AGE_S = 0.010
SMOOTH_S = 0.05
FINE_S = 0.002
MIN_FRAMES = 60
DEVICE_LATENCIES_S = (0.0, 0.04, 0.08, 0.12)
CAMERAS_HZ = (0, 60, 120)  # 0: as recorded, 25 or 30 Hz
LAGS = 8
FAULT_S = 2.0
VIEWS = 4.0
# added to the left and to the right eye, and in how many frames
FAULTS = {
    "one frame off by .12": (0.12, 0.12, 1),
    "one eye off by .3": (0.3, 0.0, 1),
    "one frame off by .58": (0.58, 0.58, 1),
    "two frames off by .58": (0.58, 0.58, 2),
}
Float = NDArray[np.float64]
# name, its maker for a delay in s, whether it predicts on the display's clock
Way = tuple[str, Callable[[float], EyeFilter], bool]


class Clip:
    """One stretch: t_s (n,), eyes (n, 4) px; and the truth at fine times."""

    def __init__(self, name: str, t_s: Float, eyes: Float) -> None:
        self.name = name
        self.t_s = t_s - t_s[0]
        self.eyes = eyes
        self.eye_distance_px = float(
            np.median(np.hypot(eyes[:, 0] - eyes[:, 2], eyes[:, 1] - eyes[:, 3]))
        )
        smooth, slope = self._smoothed()
        self.fine_s = np.arange(0.6, self.t_s[-1] - 0.05, FINE_S)
        k = np.clip(np.searchsorted(self.t_s, self.fine_s, side="right") - 1, 0, len(t_s) - 2)
        h = (self.t_s[k + 1] - self.t_s[k])[:, None]
        u = (self.fine_s - self.t_s[k])[:, None] / h
        ends = (1 + 2 * u) * (1 - u) ** 2 * smooth[k] + u * u * (3 - 2 * u) * smooth[k + 1]
        self.truth = ends + u * (1 - u) ** 2 * h * slope[k] + u * u * (u - 1) * h * slope[k + 1]
        self.velocity = np.gradient(self.truth, FINE_S, axis=0)
        self.speed = np.sqrt(np.square(self.velocity).sum(axis=1) / 2) / self.eye_distance_px
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
        t_s, face, eyes = read_table(path)
        edges = np.flatnonzero(np.diff(face, prepend=False, append=False))
        for begin, end in edges.reshape(-1, 2).tolist():
            if end - begin > MIN_FRAMES:
                out.append(Clip(path.stem, t_s[begin:end], eyes[begin:end]))
    return out


def shown(
    clip: Clip, one: EyeFilter, display: bool, device_latency_s: float = 0.0
) -> tuple[Float, Float]:
    """Display times of pictures, and the eyes (n, 4) that they were made for."""
    times: list[float] = []
    used: list[Float] = []
    due_s = clip.t_s[0] + 0.003
    i = 0
    if not display:
        return clip.t_s + AGE_S + device_latency_s, np.array(
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
            times.append(due_s + device_latency_s)
            used.append(
                one.predict(round((due_s + REFRESH_S / 2 + device_latency_s) * 1e9)).ravel()
            )
        due_s += REFRESH_S
    return np.array(times), np.array(used)


def fitted(clip: Clip, device_latency_s: float) -> tuple[Float, Float]:
    """As shown, by the best linear predictor: least squares of where the truth will be on the last
    LAGS steps of the point between the eyes, on the clip itself. It knows the answers: a bound.
    """
    due_s = np.arange(clip.t_s[0] + 0.003, clip.t_s[-1], REFRESH_S)
    k = np.searchsorted(clip.t_s, due_s - AGE_S, side="right") - 1
    due_s, k = due_s[k > LAGS], k[k > LAGS]
    light_s = due_s + REFRESH_S / 2 + device_latency_s
    middle = (clip.eyes[:, :2] + clip.eyes[:, 2:]) / 2
    dt_s = np.diff(clip.t_s)
    velocity = np.diff(middle, axis=0) / dt_s[:, None]
    lags = np.stack([velocity[k - 1 - j] for j in range(LAGS)], axis=2)  # (n, 2, LAGS)
    ahead_s = (light_s - clip.t_s[k])[:, None, None]
    inputs = np.concatenate([lags * dt_s.mean(), lags * ahead_s], axis=2)
    right = np.stack([np.interp(light_s, clip.fine_s, clip.truth[:, j]) for j in range(4)], axis=1)
    targets = (right[:, :2] + right[:, 2:]) / 2 - middle[k]
    known = (light_s >= clip.fine_s[0]) & (light_s <= clip.fine_s[-1])
    x, y = inputs[known].reshape(-1, 2 * LAGS), targets[known].reshape(-1)
    factors = np.linalg.lstsq(x, y, rcond=None)[0]
    return due_s + device_latency_s, clip.eyes[k] + np.tile(inputs @ factors, (1, 2))


def metrics(clip: Clip, times: Float, used: Float) -> list[float]:
    """moving, still, step, overshoot, all; NaN where the clip has none of it."""
    k = np.clip(np.searchsorted(times, clip.fine_s, side="right") - 1, 0, None)
    off = used[k] - clip.truth
    square = np.square(off).sum(axis=1) / 2

    def rms(values: Float) -> float:
        return (
            100 * math.sqrt(values.mean()) / clip.eye_distance_px if len(values) > 40 else math.nan
        )

    seen = np.unique(k[clip.still])
    seen = seen[seen > 0]
    steps = np.square(used[seen] - used[seen - 1]).sum(axis=1) / 2
    step = 100 * math.sqrt(steps.mean()) / clip.eye_distance_px if len(steps) > 5 else math.nan
    ahead = [
        float((off[i : i + int(0.2 / FINE_S)] @ way).max()) / math.sqrt(2)
        for i, way in clip.stops()
    ]
    over = 100 * float(np.median(ahead)) / clip.eye_distance_px if ahead else math.nan
    return [rms(square[clip.speed > 0.5]), rms(square[clip.still]), step, over, rms(square)]


def table(found: list[Clip], ways: list[Way], device_latency_s: float) -> dict[str, Float]:
    """Metrics (stretches, 5) of every filter."""
    return {
        name: np.array(
            [
                metrics(clip, *shown(clip, make(device_latency_s), display, device_latency_s))
                for clip in found
            ]
        )
        for name, make, display in ways
    }


def bad_frames(
    found: list[Clip], ways: list[Way], device_latencies_s: Sequence[float]
) -> Iterator[str]:
    """Rows of the table: by fault and filter, what the fault adds at each delay."""
    for fault, (left, right, frames) in FAULTS.items():
        for name, make, display in ways:
            cells = []
            for device_latency_s in device_latencies_s:
                peaks = [
                    added(
                        clip,
                        make(device_latency_s),
                        make(device_latency_s),
                        display,
                        device_latency_s,
                        (left, right, frames),
                    )
                    for clip in found
                ]
                cells.append(f"{np.median(peaks):.2f} ({max(peaks):.2f})")
            yield f"| {fault} | {name} | {' | '.join(cells)} |"


def added(
    clip: Clip,
    one: EyeFilter,
    other: EyeFilter,
    display: bool,
    device_latency_s: float,
    fault: tuple[float, float, int],
) -> float:
    """How far a fault (of left and right eye, frames) moves the point between the eyes, views."""
    left, right, frames = fault
    wrong = copy.copy(clip)
    wrong.eyes = clip.eyes.copy()
    for at_s in np.arange(FAULT_S, clip.t_s[-1], FAULT_S):
        k = int(np.searchsorted(clip.t_s, at_s))
        wrong.eyes[k : k + frames, 0] += left * clip.eye_distance_px
        wrong.eyes[k : k + frames, 2] += right * clip.eye_distance_px
    off = (
        shown(wrong, one, display, device_latency_s)[1]
        - shown(clip, other, display, device_latency_s)[1]
    )
    middle = (off[:, :2] + off[:, 2:]) / 2
    return VIEWS * float(np.hypot(*middle.T).max()) / clip.eye_distance_px


def _filter(name: str, device_latency_s: float) -> EyeFilter:
    return make_filter(Track(filter=name), device_latency_s)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=existing)
    parser.add_argument("--half", choices=("even", "odd"))
    parser.add_argument("--tables", choices=("all", "filters", "bad"), default="all")
    given = parser.parse_args()
    recorded = clips(given.folder)
    if given.half:
        recorded = recorded[given.half == "odd" :: 2]
    ways: list[Way] = [
        ("paper, mean 5", lambda device_latency_s: Mean(5), False),
        ("none", lambda device_latency_s: Mean(1), True),
        *((name, partial(_filter, name), True) for name in reversed(FILTER_MODULES)),
    ]
    if given.tables != "bad":
        print(
            "| camera | latency | filter | moving | still | step | overshoot | all |\n"
            f"|---|---:|---|{'---:|' * 5}"
        )
        by_clip = []
        for camera_hz in CAMERAS_HZ:
            found = [clip.measured(camera_hz) for clip in recorded] if camera_hz else recorded
            camera = f"{camera_hz} Hz" if camera_hz else "as recorded"
            for device_latency_s in DEVICE_LATENCIES_S:
                delay = f"{device_latency_s * 1000:.0f}"
                every = table(found, ways, device_latency_s)
                if not camera_hz:
                    every["linear, fitted to each clip"] = np.array(
                        [metrics(clip, *fitted(clip, device_latency_s)) for clip in found]
                    )
                for name, rows in every.items():
                    medians = " | ".join(f"{value:.2f}" for value in np.nanmedian(rows, axis=0))
                    print(f"| {camera} | {delay} | {name} | {medians} |", flush=True)
                    errors = " | ".join(f"{value:.2f}" for value in rows[:, 4])
                    by_clip.append(f"| {camera} | {delay} | {name} | {errors} |")
        names = " | ".join(clip.name for clip in recorded)
        print(
            f"\n| all time | latency | filter | {names} |\n|---|---:|---|{'---:|' * len(recorded)}"
        )
        print("\n".join(by_clip))
    if given.tables != "filters":
        delays = " | ".join(
            f"{device_latency_s * 1000:.0f} ms" for device_latency_s in DEVICE_LATENCIES_S
        )
        print(f"\n| bad frames | filter | {delays} |\n|---|---|{'---:|' * len(DEVICE_LATENCIES_S)}")
        for row in bad_frames(recorded, ways[1:], DEVICE_LATENCIES_S):
            print(row, flush=True)


if __name__ == "__main__":
    start(main)
