"""Subject: stiff and extreme cases of eyes over time: the filters and the viewer. Values are ok, degraded or failed.

References are exact or wider than what they judge: rationals for the covariance, the undisturbed run for filters and the viewer;
those of the picture are in `extremes.py`.
"""

import itertools
import math
from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.extremes import colour_table, judged_error, mapping_table, synthesis_table
from lfpipe.bench.inputs import Inputs
from lfpipe.bench.results import State, Table, Value, judged_table
from lfpipe.bench.runner import Offer
from lfpipe.config import Config, Track
from lfpipe.eyes import EYES as RECORD
from lfpipe.eyes import EyesRecord
from lfpipe.render.viewer import Viewer
from lfpipe.scene.lightfield import LightField
from lfpipe.track.filters import Motion, Predictive, Tuning, make_filter

FILTERS = (Track().filter, *(name for name in ("mean", "one-euro", "kalman") if name != Track().filter))
RATES_HZ = (15, 30, 60, 120, 240)
EYES = np.array([[350.0, 240.0], [290.0, 242.0]])
APART_PX = 60.0
AHEAD_MS = 100  # a usual time from exposure to light
VIEWER_HZ, VIEWER_STEP_NS = 60, 16_666_667
Float = NDArray[np.float64]


def covariance_error(q: float, first: float, dt_ns: int, rounds: int) -> float:
    """Largest relative error of a, b and c of one model of the default filter against rationals; infinite if indefinite.

    q: acceleration in squared eye distances per s^3. first: constant noise in eye distances.
    """
    filter_ = Predictive(Tuning(motions=(Motion(q, 1.0),), stay_s=1e300, rate_common=0.0, first=first, least=first))
    d, worst = Fraction(dt_ns / 1e9), 0.0
    filter_.update(0, EYES)
    a, b, c = (Fraction(value) for value in (filter_._models[1].a, filter_._models[1].b, filter_._models[1].c))
    noise, density = Fraction(filter_._noise * filter_._tuning.common**2), Fraction(q * math.dist(*EYES.tolist()) ** 2)
    for k in range(1, rounds + 1):
        filter_.update(k * dt_ns, EYES)
        a, b, c = a + 2 * b * d + c * d * d + density * d**3 / 3, b + c * d + density * d * d / 2, c + density * d
        s = a + noise
        a, b, c = a - a * a / s, b - a * b / s, c - b * b / s
        one = filter_._models[1]
        if not (one.a > 0 and one.c >= 0 and one.b**2 <= one.a * one.c * (1 + 1e-9)):
            return math.inf
        worst = max(worst, *(abs(float(Fraction(v) / t - 1)) for v, t in ((one.a, a), (one.b, b), (one.c, c))))
    return worst


def covariance_table(rounds: int) -> Table:
    """The default filter's own models, over and far beyond their settings."""
    steps_ns, noises = (200_000, 4_166_667, 33_333_333, 400_000_000), (1e-6, 1e-3, 1.0)
    rows = [
        (f"q {q:.0e}, noise {r:.0e}", [judged_error(partial(covariance_error, q, r, d, rounds), 1e-9, 1e-3) for d in steps_ns])
        for q, r in itertools.product((1e-6, 1.0, 1200.0, 1e9), noises)
    ]
    note = "Worst relative error of an entry against rational arithmetic; failed if a matrix is no longer semi-definite."
    head = ("acceleration and noise", *(f"step {d / 1e6:g} ms" for d in steps_ns))
    return judged_table(f"Covariance of the default filter ({Track().filter})", note, head, rows)


def stamps_ns(rate_hz: float, count: int, seed: int, jittered: bool) -> list[int]:
    """Rising stamps of frames; jittered: by a tenth of the period, every ninth a duplicate of its predecessor."""
    random, period_ns = np.random.default_rng(seed), 1e9 / rate_hz
    stamps = [round(10**12 + k * period_ns + (random.uniform(-0.1, 0.1) * period_ns if jittered else 0)) for k in range(count)]
    return [stamps[k - 1] if jittered and k % 9 == 8 else t_ns for k, t_ns in enumerate(stamps)]


def aftermath(runs: list[Float], since: int, limit: float, rate_hz: float) -> tuple[float, float]:
    """(peak, duration) of what a disturbance at sample `since` does. runs: without it and with it, (n, 2, 2) each.

    The largest distance between the runs, and the seconds until it stays below limit; infinite if any output is not finite.
    """
    off = np.abs(runs[1] - runs[0]).max(axis=(1, 2))[since:]
    if not np.isfinite(off).all():
        return math.inf, math.inf
    above = np.flatnonzero(off > limit)
    return float(off.max()), float((above[-1] + 1) / rate_hz if len(above) else 0.0)


# Name -> what becomes of the stamp (ns) and the eyes of one frame. What the tracker's gate refuses anyway (not finite, out of all
# proportion) is no face.
DISTURBANCES: dict[str, Callable[[int, Float], tuple[int, Float]]] = {
    "wrong by half an eye distance": lambda t_ns, eyes: (t_ns, eyes + np.array((APART_PX / 2, 0.0))),
    "one eye wrong by an eye distance": lambda t_ns, eyes: (t_ns, eyes + np.array(((APART_PX, 0.0), (0.0, 0.0)))),
    "another face, 200 px away": lambda t_ns, eyes: (t_ns, eyes + 200.0),
    "no number": lambda t_ns, eyes: (t_ns, eyes * math.nan),
    "infinite": lambda t_ns, eyes: (t_ns, eyes * math.inf),
    "spike of 1e18 px": lambda t_ns, eyes: (t_ns, eyes + 1e18),
    "stamp 1/30 s early": lambda t_ns, eyes: (t_ns - 33_333_333, eyes),
    "stamp of 292 years": lambda t_ns, eyes: (2**63 - 1, eyes),
}


def disturbed(name: str, what: str, rate_hz: int, moving: bool, frames: int = 1) -> tuple[float, float]:
    """(peak, duration) of a disturbance of so many frames in a row, in eye distances AHEAD_MS ahead, until it stays below 2 %.

    The head rests, or sways by 100 px at half a hertz, then with jittered stamps.
    """
    stamps, at, runs = stamps_ns(rate_hz, 4 * rate_hz, 1, jittered=moving), 2 * rate_hz, []
    for wrong in ((), range(at, at + frames)):
        filter_, noise, outputs = make_filter(Track(filter=name)), np.random.default_rng(2), []  # type: ignore[arg-type]
        for k, t_ns in enumerate(stamps):
            t_s = (t_ns - stamps[0]) / 1e9
            sway = np.array((100 * math.sin(math.pi * t_s), 20 * math.sin(1.7 * math.pi * t_s))) if moving else 0.0
            eyes = EYES + sway + noise.normal(0.0, 0.3, (2, 2))
            filter_.update(*(DISTURBANCES[what](t_ns, eyes) if k in wrong else (t_ns, eyes)))
            outputs.append(filter_.predict(t_ns + AHEAD_MS * 1_000_000) / APART_PX)
        runs.append(np.array(outputs))
    return aftermath(runs, at, 0.02, rate_hz)


def filter_tables(rates_hz: tuple[int, ...]) -> Iterator[Table]:
    """Every filter with every disturbance of one frame and of two, at rest and moving."""
    note = (
        f"Largest distance from the run without it in eye distances, {AHEAD_MS} ms ahead, and how long it stays above 2 %."
        " ok: at most 1.5 and 0.7 s; failed: longer than 1.5 s, or not finite."
    )

    def value(name: str, peak: float, lasts_s: float) -> Value:
        state: State = "ok" if peak <= 1.5 and lasts_s <= 0.7 else "degraded" if lasts_s <= 1.5 else "failed"
        return Value(words=f"{peak:.2f}, {lasts_s:.2f} s", state=state, only="" if name == FILTERS[0] else f"track.filter={name}")

    for moving, frames in itertools.product((False, True), (1, 2)):
        rows = [
            (f"{what}, {rate} Hz", [value(name, *disturbed(name, what, rate, moving, frames)) for name in FILTERS])
            for what, rate in itertools.product(DISTURBANCES, rates_hz)
        ]
        title = f"Filters after {('one bad frame', 'two bad frames')[frames - 1]}, "
        title += "a moving head, jittered and duplicate stamps" if moving else "a head at rest"
        yield judged_table(title, note, ("wrong", *FILTERS), rows)


def viewer_run(field: LightField, rate_hz: int, jittered: bool, bad: dict[str, object], frames: range) -> Float:
    """Viewpoints (n, 2, 2) of a viewer before a field, at VIEWER_HZ, over 8 s. bad: what stands in the records of some frames."""
    viewer, record = Viewer(field, Config()), np.zeros((), RECORD)
    stamps = stamps_ns(rate_hz, 8 * rate_hz, 3, jittered)
    views, k = [], 0
    for presented_ns in range(stamps[0], stamps[-1], VIEWER_STEP_NS):
        while k + 1 < len(stamps) and stamps[k + 1] <= presented_ns:
            k += 1
        usual = {"filtered_px": EYES, "raw_px": EYES, "velocity_px_s": 0.0, "apart_px": APART_PX, "confidence": 1.0,
                 "width_px": 640, "height_px": 480, "face": 1, "generation": 1}  # fmt: skip
        for name, value in (usual | (bad if k in frames else {})).items():
            record[name] = value
        viewpoints = viewer.viewpoints(EyesRecord.of(record), stamps[k], presented_ns + 50_000_000)
        views.append((viewpoints.left, viewpoints.right))
    return np.array(views)


CASES: dict[str, tuple[dict[str, object], int]] = {  # what stands in the record, for how many frames
    "no face for a frame": ({"face": 0}, 1),
    "no face for ten frames": ({"face": 0}, 10),
    "eyes that are no number": ({"filtered_px": math.nan}, 1),
    "eyes at 1e300 px": ({"filtered_px": 1e300}, 1),
    "speed that is infinite": ({"velocity_px_s": math.inf}, 1),
    "distance that is no number": ({"apart_px": math.nan}, 1),
    "infinite distance": ({"apart_px": math.inf}, 1),
    "distance of 1e300 px": ({"apart_px": 1e300}, 1),
    "eyes 30 px aside": ({"filtered_px": EYES + 30.0}, 1),
    "another face": ({"generation": 2}, 1),
}


def viewer_table(field: LightField, rates_hz: tuple[int, ...]) -> Table:
    """Viewer, easing, presence and parallax: what one frame, or ten without a face, do to the viewpoints."""

    def value(bad: dict[str, object], frames: int, rate_hz: int, jittered: bool) -> Value:
        at = 3 * rate_hz
        try:
            runs = [viewer_run(field, rate_hz, jittered, bad, range(at, at + count)) for count in (0, frames)]
        except Exception as error:  # the exception is the result
            return Value(words=f"{type(error).__name__}: {error}"[:80], state="failed")
        peak, lasts_s = aftermath(runs, 3 * VIEWER_HZ, 0.05, VIEWER_HZ)
        state: State = "ok" if lasts_s <= 2 else "degraded" if lasts_s < 4.5 else "failed"
        return Value(words=f"{peak:.2f}, {lasts_s:.2f} s", state=state)

    columns = list(itertools.product(rates_hz, (False, True)))
    rows = [(what, [value(*case, *column) for column in columns]) for what, case in CASES.items()]
    head = ("in the record", *(f"{rate_hz} Hz{', jittered' * jittered}" for rate_hz, jittered in columns))
    note = "Distance of the viewpoints from a run without it, in views, and how long it stays above 0.05. failed: it never ends."
    return judged_table("The viewer before the screen", note, head, rows)


def measure(inputs: Inputs) -> Iterator[Offer]:
    """All tables."""
    rates_hz = (30, 240) if inputs.quick else RATES_HZ
    yield covariance_table(7 if inputs.quick else 9)  # the rationals' digits double every round
    yield from filter_tables(rates_hz)
    yield viewer_table(inputs.field, rates_hz)
    yield mapping_table()
    yield colour_table(inputs.field)
    yield synthesis_table(inputs)
