"""Subject: filters of eye positions on a known motion. Error at the moment of display, still jitter, time per update."""

import itertools
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.inputs import Inputs
from lfpipe.bench.motion import known_motion
from lfpipe.bench.results import Figures, rms
from lfpipe.bench.runner import Candidate, Offer, Turn, time_ms
from lfpipe.bench.subjects import AHEAD_MS, FILTER_RATES_HZ, NOISE_PX
from lfpipe.config import Track
from lfpipe.track.filters import Predictive, Tuning, make_filter
from lfpipe.track.smoothing import EyeFilter, Kalman, Mean, OneEuro

MIN_REST = 6  # frames of a rest whose jitter counts


def follow(filter_: EyeFilter, rate_hz: int, ahead_ms: int = AHEAD_MS) -> Figures:
    """Of a filter at a camera rate, ahead_ms after each frame: RMS error in px over seconds, and jitter over rests."""
    motion = known_motion()
    eyes, visible, still = motion.eyes, motion.visible, motion.still
    rng = np.random.default_rng(rate_hz)
    per_second: dict[int, list[float]] = {}
    rests: list[list[NDArray[np.float64]]] = [[]]
    for k in range(int(len(eyes) * rate_hz / 1000)):
        t_ns = round(k * 1e9 / rate_hz)
        ms = min(t_ns // 1_000_000, len(eyes) - 1)
        if not visible[ms]:
            continue
        filter_.update(t_ns, eyes[ms] + rng.normal(0.0, NOISE_PX, (2, 2)))
        predicted = filter_.predict(t_ns + ahead_ms * 1_000_000)
        if ms + ahead_ms < len(eyes) and visible[ms + ahead_ms]:
            per_second.setdefault(ms // 1000, []).append(
                float(np.square(predicted - eyes[ms + ahead_ms]).sum() / 2)
            )
        if still[ms]:
            rests[-1].append(predicted)
        elif rests[-1]:
            rests.append([])
    error = rms([np.sqrt(np.mean(squares)) for squares in per_second.values()])
    jitter = rms(
        [np.sqrt(2 * np.var(rest, axis=0).mean()) for rest in rests if len(rest) >= MIN_REST]
    )
    return {f"error_{rate_hz}hz": error, f"jitter_{rate_hz}hz": jitter}


def sweeps() -> dict[str, list[tuple[str, Callable[[], EyeFilter]]]]:
    """Curve -> (knob, filter), ordered by knob. "default" has the parameters of the configuration."""
    ones = [(f"beta {beta:g}", partial(OneEuro, 1.0, beta, 4.0)) for beta in (0.3, 1.0, 5.0, 20.0)]
    motions = [(f"agility {a:.0e}", partial(Kalman, a)) for a in (1e1, 1e2, 1e3, 1e5, 1e6)]
    cautions = [
        (f"caution {c:g}", lambda c=c: Predictive(Tuning(caution=c)))
        for c in (0.05, 0.1, 0.2, 0.6, 1.0)
    ]
    return {
        "mean": [(f"k = {k}", partial(Mean, k)) for k in (1, 2, 3, 5, 8, 12)],
        "one-euro": [
            *ones[:2],
            ("default", partial(make_filter, Track(filter="one-euro"))),
            *ones[2:],
        ],
        "kalman": [
            *motions[:3],
            ("default", partial(make_filter, Track(filter="kalman"))),
            *motions[3:],
        ],
        "predictive": [
            *cautions[:3],
            ("default", partial(make_filter, Track(filter="predictive"))),
            *cautions[3:],
        ],
    }


def measure(inputs: Inputs) -> Iterator[Offer]:
    """The mean, One-Euro, Kalman and predictive filters over a range of their parameters."""
    for curve, knobs in sweeps().items():
        for knob, make in knobs:
            paper, used = (
                (curve, knob) == ("mean", "k = 5"),
                (curve, knob) == (Track().filter, "default"),
            )
            rates_hz = FILTER_RATES_HZ if paper or knob == "default" else FILTER_RATES_HZ[:1]
            yield Candidate(curve, knob, partial(_prepare, make, rates_hz), paper, used)


def _prepare(make: Callable[[], EyeFilter], rates_hz: tuple[int, ...]) -> tuple[Figures, Turn]:
    figures = {key: value for rate_hz in rates_hz for key, value in follow(make(), rate_hz).items()}
    filter_, eyes, frames = make(), known_motion().eyes, itertools.count(1)

    def step() -> None:
        k = next(frames)
        filter_.update(k * 33_333_333, eyes[k * 33 % len(eyes)])

    return figures, lambda: {"time_us": 1e3 * time_ms(step, 200)}
