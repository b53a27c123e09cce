"""Benchmark: stiff and extreme numerical cases: the filters against their undisturbed run, eyes to
viewpoints, and views at the ends of the range. Values are ok, degraded or failed.
"""

import itertools
import math
from collections.abc import Iterator

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.inputs import Inputs
from lfpipe.bench.results import State, Table, judged_error, judged_table
from lfpipe.bench.runner import Offer
from lfpipe.bench.simulator.scripts import EYE_DISTANCE_PX
from lfpipe.bench.synthesis import view_at
from lfpipe.config import FILTER_MODULES, Render, Track
from lfpipe.config.quality import METHODS, WARPS
from lfpipe.files.safe_files import MAX_INTEGER
from lfpipe.render.synthesis.compositor import Compositor, ViewRenderer
from lfpipe.render.synthesis.viewpoint import ViewSolver, pair_clamped
from lfpipe.scene.lightfield import UNKNOWN, LightField
from lfpipe.scene.source import Geometry
from lfpipe.track.filters.base import make_filter
from lfpipe.transport.ring import MS_NS

FILTERS = tuple(FILTER_MODULES)  # the default one first
RATES_HZ = (15, 30, 60, 120, 240)  # of webcams in the dark to high-speed cameras
EYES = np.array([[350.0, 240.0], [290.0, 242.0]])  # px, near the middle of 640x480
AHEAD_MS = 100  # typical time from exposure to display
Float = NDArray[np.float64]
# Name -> offsets of the stamp (ns) and of the eyes (px) of a frame. The tracker's gate would reject
# NaN, infinite and absurdly large values: they count as no face.
DISTURBANCES: dict[str, tuple[int, Float | float]] = {
    "wrong by half an eye distance": (0, np.array((EYE_DISTANCE_PX / 2, 0.0))),
    "one eye wrong by an eye distance": (0, np.array(((EYE_DISTANCE_PX, 0.0), (0.0, 0.0)))),
    "another face, 200 px away": (0, 200.0),
    "no number": (0, math.nan),
    "infinite": (0, math.inf),
    "spike of 1e18 px": (0, 1e18),
    "stamp 1/30 s early": (-33_333_333, 0.0),
    "stamp of 292 years": (MAX_INTEGER, 0.0),
}


def disturbed(
    name: str, what: str, rate_hz: int, moving: bool, frames: int = 1
) -> tuple[float, float]:
    """The effect of a disturbance of `frames` successive frames on a filter: the largest distance
    from its undisturbed run, in eye distances, predicted AHEAD_MS ahead, and the seconds until the
    distance stays below 2 %; infinity if any output is not finite.

    The head rests, or sways by 100 px at half a hertz; then stamps jitter by a tenth of the period,
    and every ninth is a duplicate of its predecessor.
    """
    at = 2 * rate_hz
    k = np.arange(2 * at)
    jitter = np.random.default_rng(1).uniform(-0.1, 0.1, len(k)) * moving
    stamps_ns = np.rint(10**12 + (k + jitter) * 1e9 / rate_hz).astype(np.int64)
    stamps_ns = stamps_ns[np.where(moving & (k % 9 == 8), k - 1, k)]
    t_s = (stamps_ns - stamps_ns[0]) / 1e9
    sway = np.stack([100 * np.sin(np.pi * t_s), 20 * np.sin(1.7 * np.pi * t_s)], axis=1) * moving
    noise = np.random.default_rng(2).normal(0.0, 0.3, (len(k), 2, 2))
    measured = EYES + sway[:, None] + noise
    late_ns, off_px = DISTURBANCES[what]
    runs = []
    for wrong in ((), range(at, at + frames)):
        filter_ = make_filter(Track(filter=name))
        outputs = []
        for frame, (t_ns, eyes) in enumerate(zip(stamps_ns.tolist(), measured, strict=True)):
            if frame in wrong:
                filter_.update(min(t_ns + late_ns, MAX_INTEGER), eyes + off_px)
            else:
                filter_.update(t_ns, eyes)
            outputs.append(filter_.predict(t_ns + AHEAD_MS * MS_NS) / EYE_DISTANCE_PX)
        runs.append(np.array(outputs))
    off = np.abs(runs[1] - runs[0]).max(axis=(1, 2))[at:]
    if not np.isfinite(off).all():
        return math.inf, math.inf
    above = np.flatnonzero(off > 0.02)
    return float(off.max()), float((above[-1] + 1) / rate_hz) if len(above) else 0.0


def filter_table(rates_hz: tuple[int, ...], moving: bool, frames: int) -> Table:
    """Every filter with every disturbance of this many frames."""

    def judge(case: tuple[str, int], name: str) -> tuple[str, State]:
        peak, lasts_s = disturbed(name, *case, moving, frames)
        state: State = "degraded" if lasts_s <= 1.5 else "failed"
        return f"{peak:.2f}, {lasts_s:.2f} s", "ok" if peak <= 1.5 and lasts_s <= 0.7 else state

    title = f"Filters after {'one bad frame' if frames == 1 else 'two bad frames'}, "
    title += "a moving head, jittered and duplicate stamps" if moving else "a head at rest"
    note = (
        f"Largest distance from the undisturbed run in eye distances, {AHEAD_MS} ms ahead, and the"
        " time that it stays above 2 %. ok: at most 1.5 and 0.7 s; failed: longer than 1.5 s, or"
        " not finite."
    )
    cases = {
        f"{what}, {rate} Hz": (what, rate)
        for what, rate in itertools.product(DISTURBANCES, rates_hz)
    }
    filters = {name: name for name in FILTERS}
    return judged_table(
        title,
        note,
        "wrong",
        cases,
        filters,
        judge,
        lambda _case, name: "" if name == FILTERS[0] else f"track.filter={name}",
    )


def mapping_error(alpha_px: float, u: float, count: int = 9, reach: float = 2.0) -> float:
    """Distance in views between the mapping and the same in long double, before clamping; infinity
    if it is not finite, leaves the zone, or is clamped wrongly.
    """
    solver = ViewSolver(count, count, Render(extrapolate_views=reach), alpha_px, (320.0, 240.0))
    views = np.array([col for _, col in solver.views((u, 240.0, u - 60.0, 240.0))])
    if not (np.abs(views - (count - 1) / 2) <= (count - 1) / 2 + reach).all():
        return math.inf
    if not math.isfinite(u):
        return 0.0
    steps = (np.longdouble(320.0) - np.array((u, u - 60.0), np.longdouble)) / np.longdouble(
        alpha_px
    )
    left, right = np.clip((count - 1) / 2 + steps, -1e12, 1e12).astype(float).tolist()
    return float(np.abs(views - pair_clamped(left, right, count, reach)).max())


def mapping_table() -> Table:
    """Results for eyes and alpha over the whole range of floats."""
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
    without a zero plane. Returns the largest difference between pictures with equal keys, which
    must be equal.
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
    """Results for the scene, and for generated light fields of extreme sizes and disparities."""
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
        " NaN, infinities, 1e308, 5e-324, a zero plane of 900 px; pictures with equal keys must be"
        " equal, without any exception."
    )
    columns = {
        f"{method}: {check}": (method, check)
        for method, check in itertools.product(METHODS[::-1], checks)
    }
    return judged_table(
        "Views at the ends of the range", note, "light field", fields, columns, judge, only
    )


def measure(inputs: Inputs) -> Iterator[Offer]:
    """All tables."""
    rates_hz = (30, 240) if inputs.quick else RATES_HZ
    for moving, frames in itertools.product((False, True), (1, 2)):
        yield filter_table(rates_hz, moving, frames)
    yield mapping_table()
    yield synthesis_table(inputs)
