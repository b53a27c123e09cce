"""Subject: filters of eye positions on a known motion. Error at the moment of display, still jitter, time per update."""

import itertools
from collections.abc import Callable, Iterator
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.inputs import Inputs
from lfpipe.bench.motion import duration_s, position_at, viewer_path
from lfpipe.bench.results import Candidate, Chart, Choice, Figure, Prepared, Profile, Samples, Skipped, Subject
from lfpipe.bench.stats import time_figures, times_ms
from lfpipe.config import Track
from lfpipe.track.filters import Predictive, Tuning, make_filter
from lfpipe.track.smoothing import EyeFilter, Kalman, Mean, OneEuro

HORIZONS_MS = (0, 20, 40, 60, 80, 100, 120)
RATES_HZ = (30, 60, 120)
SHOWN_MS = 40  # horizon of the diagrams: age of a picture at 30 Hz and 60 Hz refresh
NOISE_PX = 0.3  # of the landmarks of live faces: 0.22 to 0.34 px were measured at 640x480
FOCAL_PX, HOME_MM, EYES_MM, CENTRE_PX = 600.0, 600.0, 63.0, (319.5, 239.5)
SETTLED_S, MIN_REST = 0.4, 6

Float = NDArray[np.float64]


@lru_cache(maxsize=1)
def known_motion() -> tuple[Float, NDArray[np.bool_], NDArray[np.bool_]]:
    """The path of a viewer before a pinhole camera of 640x480, in steps of 1 ms.

    Returns eyes (n, 2, 2) px, whether both are in the picture, and whether the head has rested for SETTLED_S.
    """
    path = viewer_path(HOME_MM, 320 * HOME_MM / FOCAL_PX)
    count = int(duration_s(path) * 1000)
    positions, phases = zip(*(position_at(path, k / 1000) for k in range(count)), strict=True)
    x, y, z = np.array(positions).T
    u = CENTRE_PX[0] + FOCAL_PX * (x[:, None] + np.array([EYES_MM / 2, -EYES_MM / 2])) / z[:, None]
    v = np.repeat((CENTRE_PX[1] + FOCAL_PX * y / z)[:, None], 2, axis=1)
    visible = ((u >= 0) & (u < 640)).all(axis=1)
    moving = np.array(phases) != "still"
    since_ms = np.arange(count) - np.maximum.accumulate(np.where(moving, np.arange(count), -1))
    return np.stack([u, v], axis=2), visible, (since_ms > SETTLED_S * 1000) & visible


def follow(filter_: EyeFilter, rate_hz: int, horizons_ms: tuple[int, ...] = HORIZONS_MS) -> Samples:
    """Samples of a filter at a camera rate: RMS error in px of each second, at every horizon, and still jitter SHOWN_MS ahead."""
    eyes, visible, still = known_motion()
    rng = np.random.default_rng(rate_hz)
    per_second: dict[int, dict[int, list[float]]] = {h: {} for h in horizons_ms}
    rests: list[list[Float]] = [[]]
    for k in range(int(len(eyes) * rate_hz / 1000)):
        t_ns = round(k * 1e9 / rate_hz)
        ms = min(t_ns // 1_000_000, len(eyes) - 1)
        if not visible[ms]:
            continue
        filter_.update(t_ns, eyes[ms] + rng.normal(0.0, NOISE_PX, (2, 2)))
        for horizon in horizons_ms:
            if ms + horizon < len(eyes) and visible[ms + horizon]:
                error = filter_.predict(t_ns + horizon * 1_000_000) - eyes[ms + horizon]
                per_second[horizon].setdefault(ms // 1000, []).append(float(np.square(error).sum() / 2))
        if still[ms]:
            rests[-1].append(filter_.predict(t_ns + SHOWN_MS * 1_000_000))
        elif rests[-1]:
            rests.append([])
    samples = {
        f"error_{h}ms_{rate_hz}hz": [float(np.sqrt(np.mean(part))) for part in per_second[h].values()] for h in horizons_ms
    }
    jitter = [float(np.sqrt(2 * np.var(rest, axis=0).mean())) for rest in rests if len(rest) >= MIN_REST]
    return samples | {f"jitter_{rate_hz}hz": jitter}


def sweeps() -> dict[str, list[tuple[str, Callable[[], EyeFilter]]]]:
    """Curve -> (knob, filter), ordered by knob. "default" has the parameters of the configuration."""
    ones = [(f"beta {beta:g}", partial(OneEuro, 1.0, beta, 4.0)) for beta in (0.3, 1.0, 5.0, 20.0)]
    motions = [(f"agility {a:.0e}", partial(Kalman, a)) for a in (1e1, 1e2, 1e3, 1e5, 1e6)]
    cautions = [(f"caution {c:g}", partial(_predictive, c)) for c in (0.05, 0.1, 0.2, 0.6, 1.0)]
    return {
        "mean": [(f"k = {k}", partial(Mean, k)) for k in (1, 2, 3, 5, 8, 12)],
        "one-euro": [*ones[:2], ("default", partial(make_filter, Track(filter="one-euro"))), *ones[2:]],
        "kalman": [*motions[:3], ("default", partial(make_filter, Track(filter="kalman"))), *motions[3:]],
        "predictive": [*cautions[:3], ("default", partial(make_filter, Track(filter="predictive"))), *cautions[3:]],
    }


def _predictive(caution: float) -> EyeFilter:
    return Predictive(Tuning(caution=caution))


def candidates(inputs: Inputs) -> Iterator[Candidate | Skipped]:
    """The mean, One-Euro, Kalman and predictive filters over a range of their parameters."""
    if inputs.quick:
        yield Skipped("other parameters at 60 and 120 Hz", "--quick varies them at 30 Hz only; the defaults run at all rates")
    for curve, knobs in sweeps().items():
        for knob, make in knobs:
            paper = (curve, knob) == ("mean", "k = 5")
            drawn = paper or knob == "default"  # as a line over the horizon
            rates = RATES_HZ if drawn or not inputs.quick else RATES_HZ[:1]
            horizons = HORIZONS_MS if drawn else (SHOWN_MS,)
            yield Candidate(
                curve, knob, partial(_prepare, make, rates, horizons), paper, (curve, knob) == (Track().filter, "default")
            )


def _prepare(make: Callable[[], EyeFilter], rates_hz: tuple[int, ...], horizons_ms: tuple[int, ...]) -> Prepared:
    def errors() -> Samples:
        return {key: values for rate_hz in rates_hz for key, values in follow(make(), rate_hz, horizons_ms).items()}

    filter_, eyes, frames = make(), known_motion()[0], itertools.count(1)

    def step() -> None:
        k = next(frames)
        filter_.update(k * 33_333_333, eyes[k * 33 % len(eyes)])

    return Prepared(errors, lambda: time_figures(times_ms(step, 200), "us", 1e3))


_ERRORS = tuple(
    Figure(f"error_{h}ms_{rate}hz", f"error {h} ms ahead at {rate} Hz, RMS", "px", "rms")
    for rate in RATES_HZ
    for h in HORIZONS_MS
)
_PROFILES = tuple(
    Profile(
        f"filters-horizon-{rate}hz",
        f"Error at the moment of display, camera at {rate} Hz",
        "from frame to display, ms",
        "error, RMS, px",
        tuple((float(h), f"error_{h}ms_{rate}hz") for h in HORIZONS_MS),
        ("default", "k = 5"),
    )
    for rate in RATES_HZ
)

SUBJECT = Subject(
    "filters",
    "Filtering and predicting",
    "A known motion (reaches up to 450 mm/s, sway, sudden stops, approach, leaving the picture), landmarks with"
    f" {NOISE_PX} px of noise. How far are the eyes that a picture is made for from the viewer's eyes when it is shown?",
    (
        *_ERRORS,
        *(Figure(f"jitter_{rate}hz", f"still jitter at {rate} Hz, RMS", "px", "rms") for rate in RATES_HZ),
        Figure("time_us", "time per update, p50", "µs"),
        Figure("time_p95_us", "time per update, p95", "µs"),
    ),
    (
        Chart("filters", f"Error {SHOWN_MS} ms ahead against time", "time_us", f"error_{SHOWN_MS}ms_30hz"),
        Chart("filters-jitter", f"Error {SHOWN_MS} ms ahead against still jitter", "jitter_30hz", f"error_{SHOWN_MS}ms_30hz"),
        *_PROFILES,
    ),
    candidates,
    paper="mean of k = 5, without prediction",
    choice=Choice("track.filter", "time_us", f"error_{SHOWN_MS}ms_30hz", 1000.0, "a thirtieth of a frame at 30 Hz"),
    budget_s=(3.0, 30.0),
)
