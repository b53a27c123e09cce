"""Filters side by side: error on the screen against still jitter, and the numerical stability of the Kalman covariance.

    uv run python profiling/eyes_filters.py SEQUENCE.avi [--extra-noise PX]

SEQUENCE.avi with its SEQUENCE.csv is made by tools/make_sequence.py. The landmark network measures every frame once; each
filter then runs on the measurements, offline, as the live pipeline would run it: frames 4 ms old when tracked, refreshes at 60 Hz
composed 2 ms ahead, eyes predicted to the refresh. First row: the paper's way, the mean of five shown once per camera frame.
Error and jitter as in eyes_displayed.py. --extra-noise adds white noise to the measurements, for a worse camera.

The second table runs the covariance over 125 cells of process and measurement noise (1e-12 .. 1e12) and step (1e-9 .. 1e6 s),
60 steps each, in three forms; relative error against rational arithmetic over the first 12. The third shows why no filter here
uses explicit Euler.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from arguments import parser_of
from numpy.typing import NDArray

from lfpipe.bench.stiff import FORMS, cells
from lfpipe.bench.truth import Truth
from lfpipe.config import Track
from lfpipe.track.filters import make_filter
from lfpipe.track.litert_engine import LitertEngine
from lfpipe.track.smoothing import EyeFilter, Mean, weight

TRACKED_NS, COMPOSE_NS, REFRESH_NS, STEP_NS = 4_000_000, 2_000_000, 16_666_667, 1_000_000


def measurements(video: Path) -> list[NDArray[np.float64] | None]:
    engine, source, out = LitertEngine(), cv2.VideoCapture(str(video)), []
    while (frame := source.read()[1]) is not None:
        face = engine.detect(np.asarray(frame, np.uint8))
        out.append(None if face is None else face.eyes_px)
    return out


def on_screen(truth: Truth, measured: list[NDArray[np.float64] | None], one: EyeFilter, display: bool) -> tuple[float, float]:
    """Error and jitter in px, as eyes_displayed.py defines them; no jitter (NaN) where the head is never known to rest."""
    shown_ns, used, due_ns = [], [], 3_000_000
    for i, eyes in enumerate(measured):
        t_ns = int(truth.t_ns[i])
        if eyes is None:
            continue
        position, _ = one.update(t_ns, eyes)
        if not display:
            shown_ns.append(t_ns + TRACKED_NS + COMPOSE_NS)
            used.append(position)
            continue
        following = next((int(truth.t_ns[j]) for j in range(i + 1, len(measured)) if measured[j] is not None), t_ns)
        due_ns += max(0, math.ceil((t_ns + TRACKED_NS + COMPOSE_NS - due_ns) / REFRESH_NS)) * REFRESH_NS
        while due_ns < following + TRACKED_NS + COMPOSE_NS:
            shown_ns.append(due_ns)
            used.append(one.predict(due_ns))
            due_ns += REFRESH_NS
    t = np.arange(1_000_000_000, int(truth.t_ns[-1]), STEP_NS)
    now = np.searchsorted(shown_ns, t, side="right") - 1
    row = np.searchsorted(truth.t_ns, t, side="right") - 1
    seen = truth.visible_ns[row] >= 0
    still = (truth.still_ns[row] >= 0) & (t - truth.still_ns[row] > 400_000_000)
    eyes_used = np.array(used)[now]
    error = np.square(eyes_used - truth.at(t))[seen]
    off_px = float(np.sqrt(error.sum(axis=(1, 2)).mean() / 2))
    if not still.any():
        return off_px, math.nan
    shaken = [eyes_used[still & (truth.still_ns[row] == start)] for start in np.unique(truth.still_ns[row][still])]
    spread = np.concatenate([part - part.mean(axis=0) for part in shaken])
    return off_px, float(np.sqrt(np.square(spread).sum(axis=(1, 2)).mean() / 2))


def update_us(one: EyeFilter) -> float:
    eyes, best = np.array([[350.0, 240.0], [290.0, 242.0]]), math.inf
    for turn in range(5):
        start = time.perf_counter()
        for i in range(500):
            one.update((turn * 500 + i) * 33_333_333, eyes)
        best = min(best, (time.perf_counter() - start) / 500)
    return best * 1e6


def filters_table(video: Path, extra_px: float) -> None:
    truth, measured = Truth.read(video.with_suffix(".csv")), measurements(video)
    rng = np.random.default_rng(1)
    measured = [None if eyes is None else eyes + rng.normal(0, 1, (2, 2)) * extra_px for eyes in measured]
    base = on_screen(truth, measured, Mean(5), display=False)
    print(f"{'filter':24}{'error px':>10}{'ratio':>8}{'jitter px':>11}{'ratio':>8}{'us/update':>11}")
    print(f"{'mean 5, camera clock':24}{base[0]:10.3f}{1:8.3f}{base[1]:11.3f}{1:8.3f}{update_us(Mean(5)):11.1f}")
    rows: list[tuple[str, Callable[[], EyeFilter]]] = [
        (name, lambda name=name: make_filter(Track(filter=name))) for name in ("mean", "one-euro", "kalman", "predictive")
    ]
    for name, make in [("none", lambda: Mean(1)), *rows]:
        error, jitter = on_screen(truth, measured, make(), display=True)
        print(f"{name:24}{error:10.3f}{error / base[0]:8.3f}{jitter:11.3f}{jitter / base[1]:8.3f}{update_us(make()):11.1f}")


def stability_table() -> None:
    found = list(cells())
    print(f"\n{'covariance, 125 cells':24}{'worst relative error':>22}{'cells not semi-definite':>26}")
    for form in FORMS:
        part = [cell for cell in found if cell.form == form]
        print(f"{form:24}{max(cell.worst for cell in part):22.1e}{sum(not cell.definite for cell in part):26d}")


def euler_table() -> None:
    print(f"\n{'low-pass, 1 after 100 steps of cutoff x dt':44}{'explicit':>12}{'backward':>12}")
    for ratio in (0.01, 0.1, 0.5, 1.0, 100.0):
        explicit = backward = 1.0
        for _ in range(100):
            explicit -= 2 * math.pi * ratio * explicit
            backward -= weight(ratio, 1.0) * backward
        print(f"{ratio:44g}{explicit:12.1e}{backward:12.1e}")


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("sequence", type=Path)
    parser.add_argument("--extra-noise", type=float, default=0.0, metavar="PX")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    filters_table(given.sequence, given.extra_noise)
    stability_table()
    euler_table()


if __name__ == "__main__":
    main()
