"""Subject: stiff and extreme cases of numerics: the filters, compared with their undisturbed run;
eyes to viewpoints, views at the ends of the range, and recordings that hold no delay. Values are
ok, degraded or failed.
"""

import itertools
import math
from collections.abc import Callable, Iterator

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.inputs import Inputs
from lfpipe.bench.results import State, Table, judged_error, judged_table
from lfpipe.bench.runner import Offer
from lfpipe.bench.synthesis import view_at
from lfpipe.config import Render, Track
from lfpipe.config.quality import METHODS, WARPS
from lfpipe.errors import UserError
from lfpipe.observe.loop_delay import Recording, estimate
from lfpipe.render.compositor import Compositor, ViewRenderer
from lfpipe.render.viewpoint import ViewSolver, pair_clamped
from lfpipe.scene.lightfield import UNKNOWN, LightField
from lfpipe.scene.source import Geometry
from lfpipe.track.filters import make_filter

FILTERS = (
    Track().filter,
    *(name for name in ("mean", "one-euro", "kalman") if name != Track().filter),
)
RATES_HZ = (15, 30, 60, 120, 240)  # of webcams in the dark to high-speed cameras
EYES = np.array([[350.0, 240.0], [290.0, 242.0]])  # px, of somebody before the middle of 640x480
APART_PX = 60.0  # of EYES
AHEAD_MS = 100  # a usual time from exposure to light
Float = NDArray[np.float64]
wide = np.longdouble


def stamps_ns(rate_hz: float, count: int, seed: int, jittered: bool) -> list[int]:
    """Rising stamps of frames; jittered: by a tenth of the period, every ninth a duplicate of its
    predecessor.
    """
    random = np.random.default_rng(seed)
    period_ns = 1e9 / rate_hz
    stamps = [
        round(10**12 + k * period_ns + (random.uniform(-0.1, 0.1) * period_ns if jittered else 0))
        for k in range(count)
    ]
    return [stamps[k - 1] if jittered and k % 9 == 8 else t_ns for k, t_ns in enumerate(stamps)]


def aftermath(runs: list[Float], since: int, limit: float, rate_hz: float) -> tuple[float, float]:
    """(peak, duration) of what a disturbance at sample `since` does. runs: without it and with it,
    (n, 2, 2) each.

    The largest distance between the runs, and the seconds until it stays below limit; infinite if
    any output is not finite.
    """
    off = np.abs(runs[1] - runs[0]).max(axis=(1, 2))[since:]
    if not np.isfinite(off).all():
        return math.inf, math.inf
    above = np.flatnonzero(off > limit)
    return float(off.max()), float((above[-1] + 1) / rate_hz if len(above) else 0.0)


# Name -> what becomes of the stamp (ns) and the eyes of one frame. What the tracker's gate refuses
# anyway (not finite, out of all proportion) is no face.
DISTURBANCES: dict[str, Callable[[int, Float], tuple[int, Float]]] = {
    "wrong by half an eye distance": lambda t_ns, eyes: (
        t_ns,
        eyes + np.array((APART_PX / 2, 0.0)),
    ),
    "one eye wrong by an eye distance": lambda t_ns, eyes: (
        t_ns,
        eyes + np.array(((APART_PX, 0.0), (0.0, 0.0))),
    ),
    "another face, 200 px away": lambda t_ns, eyes: (t_ns, eyes + 200.0),
    "no number": lambda t_ns, eyes: (t_ns, eyes * math.nan),
    "infinite": lambda t_ns, eyes: (t_ns, eyes * math.inf),
    "spike of 1e18 px": lambda t_ns, eyes: (t_ns, eyes + 1e18),
    "stamp 1/30 s early": lambda t_ns, eyes: (t_ns - 33_333_333, eyes),
    "stamp of 292 years": lambda t_ns, eyes: (2**63 - 1, eyes),
}


def disturbed(
    name: str, what: str, rate_hz: int, moving: bool, frames: int = 1
) -> tuple[float, float]:
    """(peak, duration) of a disturbance of so many frames in a row, in eye distances AHEAD_MS
    ahead, until it stays below 2 %.

    The head rests, or sways by 100 px at half a hertz, then with jittered stamps.
    """
    stamps = stamps_ns(rate_hz, 4 * rate_hz, 1, jittered=moving)
    at = 2 * rate_hz
    runs = []
    for wrong in ((), range(at, at + frames)):
        filter_ = make_filter(Track(filter=name))  # type: ignore[arg-type]
        noise = np.random.default_rng(2)
        outputs = []
        for k, t_ns in enumerate(stamps):
            t_s = (t_ns - stamps[0]) / 1e9
            sway = (
                np.array((100 * math.sin(math.pi * t_s), 20 * math.sin(1.7 * math.pi * t_s)))
                if moving
                else 0.0
            )
            eyes = EYES + sway + noise.normal(0.0, 0.3, (2, 2))
            filter_.update(*(DISTURBANCES[what](t_ns, eyes) if k in wrong else (t_ns, eyes)))
            outputs.append(filter_.predict(t_ns + AHEAD_MS * 1_000_000) / APART_PX)
        runs.append(np.array(outputs))
    return aftermath(runs, at, 0.02, rate_hz)


def filter_tables(rates_hz: tuple[int, ...]) -> Iterator[Table]:
    """Every filter with every disturbance of one frame and of two, at rest and moving."""
    note = (
        f"Largest distance from the run without it in eye distances, {AHEAD_MS} ms ahead, and how"
        " long it stays above 2 %. ok: at most 1.5 and 0.7 s; failed: longer than 1.5 s, or not"
        " finite."
    )
    cases = {
        f"{what}, {rate} Hz": (what, rate)
        for what, rate in itertools.product(DISTURBANCES, rates_hz)
    }
    for moving, frames in itertools.product((False, True), (1, 2)):

        def judge(
            case: tuple[str, int], name: str, moving: bool = moving, frames: int = frames
        ) -> tuple[str, State]:
            peak, lasts_s = disturbed(name, *case, moving, frames)
            state: State = "degraded" if lasts_s <= 1.5 else "failed"
            if peak <= 1.5 and lasts_s <= 0.7:
                state = "ok"
            return f"{peak:.2f}, {lasts_s:.2f} s", state

        title = f"Filters after {('one bad frame', 'two bad frames')[frames - 1]}, "
        title += "a moving head, jittered and duplicate stamps" if moving else "a head at rest"
        yield judged_table(
            title, note, "wrong", cases, {name: name for name in FILTERS}, judge, _only
        )


def _only(_case: object, name: str) -> str:
    return "" if name == FILTERS[0] else f"track.filter={name}"


def mapping_error(alpha_px: float, u: float, count: int = 9, reach: float = 2.0) -> float:
    """Distance in views between the mapping and the same in long double, before the clamp; infinite
    if it is not finite, leaves the zone, or is wrong in its clamp.
    """
    solver = ViewSolver(count, count, Render(extrapolate_views=reach), alpha_px, (320.0, 240.0))
    views = [view[1] for view in solver.views((u, 240.0, u - 60.0, 240.0))]
    if not all(math.isfinite(view) and -reach <= view <= count - 1 + reach for view in views):
        return math.inf
    if not math.isfinite(u):
        return 0.0
    exact = [wide(count - 1) / 2 + (wide(320.0) - wide(v)) / wide(alpha_px) for v in (u, u - 60.0)]
    left, right = (float(np.clip(v, -wide(1e12), wide(1e12))) for v in exact)
    return float(
        max(
            abs(wide(a) - wide(b))
            for a, b in zip(views, pair_clamped(left, right, count, reach), strict=True)
        )
    )


def mapping_table() -> Table:
    """Eyes and alpha over the whole range of floats."""
    eyes = (320.0, 0.0, -1e3, 1e6, 1e18, 1e308, 5e-324, math.inf, -math.inf, math.nan)
    alphas = (1e-9, 1e-3, 1.0, 12.0, 1e3, 1e9)
    note = "Error in views against long double, with 9 views and 2 views of extrapolation."
    rows = {f"u = {u:g} px": u for u in eyes}
    columns = {f"alpha {alpha:g} px": alpha for alpha in alphas}

    def judge(u: float, alpha_px: float) -> tuple[str, State]:
        return judged_error(mapping_error(alpha_px, u), 1e-9, 1e-3)

    return judged_table("Eyes to viewpoints", note, "left eye", rows, columns, judge)


def extreme_field(
    rows: int, cols: int, height: int, width: int, disparity_px: float, unknown: float = 0.0
) -> LightField:
    """Noise with disparities up to disparity_px, of both signs.

    unknown: share of unknown disparities.
    """
    rng = np.random.default_rng(1)
    low = ((height + 1) // 2, (width + 1) // 2)
    disparity = rng.integers(-127, 128, (1, rows, cols, *low), np.int8)
    disparity[rng.random(disparity.shape) < unknown] = UNKNOWN
    return LightField(
        views=rng.integers(0, 256, (1, rows, cols, 3, height, width), np.uint8),
        disparity=disparity,
        disparity_scale_px=disparity_px / 127,
        disparity_min_px=-disparity_px,
        disparity_max_px=disparity_px,
        disparity_source="truth",
        offsets=np.zeros((rows, cols, 2), np.float32),
        present=np.ones((rows, cols), bool),
        geometry=Geometry(),
        frame_rate_hz=0.0,
        name="extreme",
        method="warp2",
    )


def error_at_stored_views(field: LightField, method: str) -> float:
    """Largest difference between a stored view and the method's view at its position; 0 is
    required.
    """
    renderer = ViewRenderer(field, method)
    views = np.asarray(field.views)[0]
    stored = {(0, 0), (field.rows - 1, field.cols - 1), (field.rows // 2, field.cols // 2)}
    return max(
        float(np.abs(view_at(renderer, (float(r), float(c))) - views[r, c]).max())
        for r, c in stored
    )


def error_at_extremes(field: LightField, method: str) -> float:
    """Composes at impossible viewpoints (NaN, infinities, far outside, tiny fractions) with and
    without a plane of the screen in depth. Returns the largest difference between pictures with
    equal keys, which must be equal.
    """
    values = (math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 0.5, field.cols - 1 + 1e-12)
    worst = 0.0
    for zero_plane_px in (0.0, 900.0):
        compositor = Compositor(
            field,
            Render(method=method, zero_plane_px=zero_plane_px),  # type: ignore[arg-type]
        )
        pictures: dict[object, NDArray[np.uint8]] = {}
        for value in values:
            for left, right in (((value, value), (0.0, value)), ((0.0, 0.0), (value, value))):
                picture = compositor.compose(left, right).copy()
                before = pictures.setdefault(compositor.key(left, right), picture)
                worst = max(worst, float(np.abs(before.astype(np.int16) - picture).max()))
    return worst


def synthesis_table(inputs: Inputs) -> Table:
    """The scene, and generated light fields of extreme sizes and disparities."""
    scene = attrs.evolve(inputs.field, views=inputs.field.views[:1])
    offset = extreme_field(3, 3, 32, 32, 2.0)
    offset.offsets[:] = np.random.default_rng(3).normal(0, 3, offset.offsets.shape)
    fields = {
        inputs.field.name or "scene": scene,
        "3x3 of 1x1 px": extreme_field(3, 3, 1, 1, 1.0),
        "2x2 of 2x3 px": extreme_field(2, 2, 2, 3, 1.0),
        "3x3 of 33x47 px": extreme_field(3, 3, 33, 47, 2.0),
        "1x1 view": extreme_field(1, 1, 32, 32, 1.0),
        "1x9 views": extreme_field(1, 9, 32, 32, 2.0),
        "5x1 views": extreme_field(5, 1, 32, 32, 2.0),
        "disparity 0": extreme_field(3, 3, 32, 32, 0.0),
        "disparity 1e-6 px": extreme_field(3, 3, 32, 32, 1e-6),
        "disparity 200 px of 32": extreme_field(3, 3, 32, 32, 200.0),
        "disparity 1e6 px": extreme_field(3, 3, 32, 32, 1e6),
        "a third unknown": extreme_field(3, 3, 32, 32, 2.0, 0.33),
        "all unknown": extreme_field(3, 3, 32, 32, 2.0, 1.1),
        "cameras out of place": offset,
    }
    checks = {
        "stored views": error_at_stored_views,
        "extremes": error_at_extremes,
    }

    def judge(field: LightField, column: tuple[str, str]) -> tuple[str, State]:
        method, check = column
        if field.disparity is None and method in WARPS:
            return "-", ""
        return judged_error(checks[check](field, method), 0.0, 1.0)

    def only(_field: LightField, column: tuple[str, str]) -> str:
        return "" if column[0] == inputs.field.method else f"render.method={column[0]}"

    note = (
        "Stored views: largest difference in levels from the stored view. Extremes: viewpoints of"
        " NaN, infinities, 1e308, 5e-324, a plane of the screen of 900 px; pictures with equal keys"
        " must be equal, and nothing may raise."
    )
    columns = {
        f"{method}: {check}": (method, check)
        for method, check in itertools.product(METHODS[::-1], checks)
    }
    return judged_table(
        "Views at the ends of the range", note, "light field", fields, columns, judge, only
    )


def calibration_table() -> Table:
    """Recordings of a camera that holds no delay: each must be refused in words."""
    rng = np.random.default_rng(1)
    t_frame_ns = np.arange(240) * 33_400_000
    recording = Recording(
        t_flip_ns=np.cumsum(rng.integers(3, 7, 120)) * 16_666_667,
        bright=np.arange(120) % 2 == 0,
        t_frame_ns=t_frame_ns,
        pictures=rng.integers(0, 256, (240, 12, 16), np.uint8),
        stamped=True,
        refresh_ms=1e3 / 60,
    )
    changes: dict[str, dict[str, NDArray[np.generic]]] = {
        "noise": {},
        "black": {"pictures": np.zeros_like(recording.pictures)},
        "one pixel": {"pictures": recording.pictures[:, :1, :1]},
        "one frame": {"pictures": recording.pictures[:1], "t_frame_ns": t_frame_ns[:1]},
        "no frame": {"pictures": recording.pictures[:0], "t_frame_ns": t_frame_ns[:0]},
        "no flip": {"t_flip_ns": recording.t_flip_ns[:0], "bright": recording.bright[:0]},
        "flips at one time": {"t_flip_ns": 0 * recording.t_flip_ns},
        "equal stamps": {"t_frame_ns": 0 * t_frame_ns + 3 * 10**9},
        "falling stamps": {"t_frame_ns": t_frame_ns[::-1].copy()},
        "stamps of 292 years": {"t_frame_ns": t_frame_ns * ((2**63 - 1) // int(t_frame_ns[-1]))},
    }

    def judge(change: dict[str, NDArray[np.generic]], _column: str) -> tuple[str, State]:
        try:
            found = estimate(attrs.evolve(recording, **change))  # type: ignore[arg-type]
        except UserError as error:
            return error.message, "ok"
        return f"{found.delay_ms:g} ms", "failed"

    note = "ok: refused with a reason; failed: a delay, or an exception."
    return judged_table("Calibration", note, "recording", changes, {"answer": "answer"}, judge)


def measure(inputs: Inputs) -> Iterator[Offer]:
    """All tables."""
    rates_hz = (30, 240) if inputs.quick else RATES_HZ
    yield from filter_tables(rates_hz)
    yield mapping_table()
    yield calibration_table()
    yield synthesis_table(inputs)
