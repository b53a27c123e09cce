"""Subject: stiff and extreme cases as tables of cells: ok, degraded or failed, with the worst error.

References are exact or wider than what they judge: rationals for the covariance, the undisturbed run for filters and the viewer,
np.longdouble for the mapping, the published matrices in float64 for colours, the stored views for pictures.
"""

import itertools
import math
from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import partial

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.holdout import ViewRenderer
from lfpipe.bench.inputs import Inputs
from lfpipe.bench.results import Cell, Skipped, State, Subject, Table
from lfpipe.config import Config, Render, Track
from lfpipe.eyes import EYES as RECORD
from lfpipe.render.anaglyph import MATRICES, decoded, encode, encoded, recipe
from lfpipe.render.compositor import Compositor
from lfpipe.render.viewer import Viewer
from lfpipe.render.viewpoint import ViewSolver, pair_clamped
from lfpipe.scene.lightfield import UNKNOWN, Geometry, LightField
from lfpipe.track.filters import make_filter
from lfpipe.track.motion_models import Motion, Predictive, Tuning

FILTERS = (Track().filter, *(name for name in ("mean", "one-euro", "kalman") if name != Track().filter))
METHODS = ("nearest", "blend", "warp", "warp2", "best")
RATES_HZ = (15, 30, 60, 120, 240)
EYES = np.array([[350.0, 240.0], [290.0, 242.0]])
APART_PX = 60.0
AHEAD_MS = 100  # a usual time from exposure to light
wide = np.longdouble
Float = NDArray[np.float64]


def judged(worst: float, ok: float, degraded: float, text: str = "", only: str = "") -> Cell:
    """ok up to `ok`, degraded up to `degraded`, failed above and for NaN."""
    state: State = "ok" if worst <= ok else "degraded" if worst <= degraded else "failed"
    return Cell(text or (f"{worst:.1e}" if worst else "0"), state, only)


def _cell(work: Callable[[], float], ok: float, degraded: float, only: str = "") -> Cell:
    """The worst error that work returns, judged; an exception is a failure with its name."""
    try:
        return judged(work(), ok, degraded, only=only)
    except Exception as error:  # the exception is the result
        return Cell(f"{type(error).__name__}: {error}"[:80], "failed", only)


def covariance_error(q: float, first: float, dt_ns: int, rounds: int) -> float:
    """Largest relative error of a, b and c of one model of the default filter against rationals; infinite if indefinite.

    q: acceleration in squared eye distances per s^3. first: constant noise in eye distances.
    """
    filter_ = Predictive(Tuning(motions=(Motion(q, 1.0),), stay_s=1e300, rate_common=0.0, first=first, least=first))
    d, worst = Fraction(dt_ns / 1e9), 0.0
    apart = math.dist(*EYES.tolist())
    filter_.update(0, EYES)
    a, b, c = (Fraction(value) for value in (filter_._models[1].a, filter_._models[1].b, filter_._models[1].c))
    noise, density = Fraction(filter_._noise * filter_._tuning.common**2), Fraction(q * apart**2)
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
    rows = tuple(
        (Cell(f"q {q:.0e}, noise {r:.0e}"), *(_cell(partial(covariance_error, q, r, d, rounds), 1e-9, 1e-3) for d in steps_ns))
        for q, r in itertools.product((1e-6, 1.0, 1200.0, 1e9), noises)
    )
    note = "Worst relative error of an entry against rational arithmetic; failed if a matrix is no longer semi-definite."
    head = ("acceleration and noise", *(f"step {d / 1e6:g} ms" for d in steps_ns))
    return Table(f"Covariance of the default filter ({Track().filter})", note, head, rows)


def head_path(t_s: float, moving: bool) -> Float:
    """The eyes at a time: at rest, or swaying by 100 px at half a hertz."""
    return np.asarray(EYES + (np.array((100 * math.sin(math.pi * t_s), 20 * math.sin(1.7 * math.pi * t_s))) if moving else 0.0))


def stamps_ns(rate_hz: float, count: int, seed: int, jittered: bool) -> list[int]:
    """Rising stamps of frames; jittered: by a tenth of the period, every ninth a duplicate of its predecessor."""
    random, period_ns = np.random.default_rng(seed), 1e9 / rate_hz
    stamps = [round(10**12 + k * period_ns + (random.uniform(-0.1, 0.1) * period_ns if jittered else 0)) for k in range(count)]
    return [stamps[k - 1] if jittered and k % 9 == 8 else t_ns for k, t_ns in enumerate(stamps)]


# Name -> what becomes of the stamp (ns) and the eyes of one frame; None for no face. What the tracker's gate refuses anyway
# (not finite, out of all proportion) is no face.
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
    """(peak, duration): largest distance from the undisturbed run, in eye distances, AHEAD_MS ahead, and the seconds until it
    stays below 2 % of an eye distance. Infinite if any output is not finite. A moving head has jittered stamps, too. frames:
    how many in a row are wrong.
    """
    stamps = stamps_ns(rate_hz, 4 * rate_hz, 1, jittered=moving)
    at = 2 * rate_hz
    runs: list[list[Float]] = []
    for bad in (False, True):
        filter_, noise, outputs = make_filter(Track(filter=name)), np.random.default_rng(2), []  # type: ignore[arg-type]
        for k, t_ns in enumerate(stamps):
            eyes = head_path((t_ns - stamps[0]) / 1e9, moving) + noise.normal(0.0, 0.3, (2, 2))
            filter_.update(*(DISTURBANCES[what](t_ns, eyes) if bad and at <= k < at + frames else (t_ns, eyes)))
            outputs.append(filter_.predict(t_ns + AHEAD_MS * 1_000_000))
        runs.append(outputs)
    off = np.abs(np.array(runs[0]) - np.array(runs[1])).max(axis=(1, 2))[at:] / APART_PX
    if not np.isfinite(off).all():
        return math.inf, math.inf
    after = np.flatnonzero(off > 0.02)
    return float(off.max()), float((after[-1] + 1) / rate_hz if len(after) else 0.0)


def filter_tables(rates_hz: tuple[int, ...]) -> Iterator[Table]:
    """Every filter with every disturbance of one frame and of two, at rest and moving."""
    for moving, frames in itertools.product((False, True), (1, 2)):
        rows = []
        for what, rate_hz in itertools.product(DISTURBANCES, rates_hz):
            cells = []
            for name in FILTERS:
                peak, lasts_s = disturbed(name, what, rate_hz, moving, frames)
                state: State = "ok" if peak <= 1.5 and lasts_s <= 0.7 else "degraded" if lasts_s <= 1.5 else "failed"
                cells.append(Cell(f"{peak:.2f}, {lasts_s:.2f} s", state, "" if name == FILTERS[0] else f"track.filter={name}"))
            rows.append((Cell(f"{what}, {rate_hz} Hz"), *cells))
        title = f"Filters after {('one bad frame', 'two bad frames')[frames - 1]}, "
        title += "a moving head, jittered and duplicate stamps" if moving else "a head at rest"
        note = (
            f"Largest distance from the run without it in eye distances, {AHEAD_MS} ms ahead, and how long it stays above 2 %."
            " ok: at most 1.5 and 0.7 s; failed: longer than 1.5 s, or not finite."
        )
        yield Table(title, note, ("wrong", *FILTERS), tuple(rows))


def viewer_run(field: LightField, rate_hz: int, jittered: bool, bad: Callable[[int, NDArray[np.void]], None]) -> Float:
    """Viewpoints (n, 2, 2) of a viewer before a field, at 60 Hz, over 8 s. bad: changes the record of frame k."""
    viewer, record = Viewer(field, Config()), np.zeros((), RECORD)
    stamps = stamps_ns(rate_hz, 8 * rate_hz, 3, jittered)
    views, k = [], 0
    for shown_ns in range(stamps[0], stamps[-1], 16_666_667):
        while k + 1 < len(stamps) and stamps[k + 1] <= shown_ns:
            k += 1
        record["filtered_px"] = record["raw_px"] = head_path(0.0, False)
        record["velocity_px_s"], record["apart_px"], record["confidence"] = 0.0, APART_PX, 1.0
        record["width_px"], record["height_px"], record["face"], record["generation"] = 640, 480, 1, 1
        bad(k, record)
        shown = viewer.viewpoints(record, stamps[k], shown_ns + 50_000_000)
        views.append((shown.left, shown.right))
    return np.array(views)


def viewer_table(field: LightField, rates_hz: tuple[int, ...]) -> Table:
    """Viewer, easing, presence and parallax: what one frame, or ten without a face, do to the viewpoints."""

    def wrong(name: str, value: object) -> Callable[[NDArray[np.void]], None]:
        return lambda record: record.__setitem__(name, value)

    cases: dict[str, tuple[Callable[[NDArray[np.void]], None], int]] = {
        "no face for a frame": (wrong("face", 0), 1),
        "no face for ten frames": (wrong("face", 0), 10),
        "eyes that are no number": (wrong("filtered_px", math.nan), 1),
        "eyes at 1e300 px": (wrong("filtered_px", 1e300), 1),
        "speed that is infinite": (wrong("velocity_px_s", math.inf), 1),
        "distance that is no number": (wrong("apart_px", math.nan), 1),
        "infinite distance": (wrong("apart_px", math.inf), 1),
        "distance of 1e300 px": (wrong("apart_px", 1e300), 1),
        "eyes 30 px aside": (wrong("filtered_px", EYES + 30.0), 1),
        "another face": (wrong("generation", 2), 1),
    }

    def cell(change: Callable[[NDArray[np.void]], None], frames: int, rate_hz: int, jittered: bool) -> Cell:
        at = 3 * rate_hz
        quiet = viewer_run(field, rate_hz, jittered, lambda k, record: None)
        views = viewer_run(field, rate_hz, jittered, lambda k, record: change(record) if at <= k < at + frames else None)
        off = np.abs(views - quiet).max(axis=(1, 2))
        if not np.isfinite(views).all():
            return Cell("not finite", "failed")
        after = np.flatnonzero(off > 0.05)
        lasts_s = (after[-1] - 3 * 60 + 1) / 60 if len(after) else 0.0
        state: State = "ok" if lasts_s <= 2 else "degraded" if lasts_s < 4.5 else "failed"
        return Cell(f"{off.max():.2f}, {lasts_s:.2f} s", state)

    columns = [(rate_hz, jittered) for rate_hz in rates_hz for jittered in (False, True)]
    rows = []
    for what, (change, frames) in cases.items():
        try:
            cells = [cell(change, frames, *column) for column in columns]
        except Exception as error:  # the exception is the result
            cells = [Cell(f"{type(error).__name__}: {error}"[:80], "failed")] * len(columns)
        rows.append((Cell(what), *cells))
    head = ("in the record", *(f"{rate_hz} Hz{', jittered' if jittered else ''}" for rate_hz, jittered in columns))
    note = "Distance of the viewpoints from a run without it, in views, and how long it stays above 0.05. failed: it never ends."
    return Table("The viewer before the screen", note, head, tuple(rows))


def mapping_error(alpha_px: float, u: float, count: int = 9, reach: float = 2.0) -> float:
    """Distance in views between the mapping and the same in long double, before the clamp; infinite if it is not finite, leaves
    the zone, or is wrong in its clamp."""
    solver = ViewSolver(count, count, Render(extrapolate_views=reach), alpha_px, (320.0, 240.0))
    left, right = (view[1] for view in solver.views([[u, 240.0], [u - 60.0, 240.0]]))
    if not (
        math.isfinite(left) and math.isfinite(right) and -reach <= min(left, right) and max(left, right) <= count - 1 + reach
    ):
        return math.inf
    if not math.isfinite(u):
        return 0.0
    exact = [wide(count - 1) / 2 + (wide(320.0) - wide(v)) / wide(alpha_px) for v in (u, u - 60.0)]
    near = [float(np.clip(v, -wide(1e12), wide(1e12))) for v in exact]
    wanted = pair_clamped(near[0], near[1], count, reach)
    return float(max(abs(wide(left) - wide(wanted[0])), abs(wide(right) - wide(wanted[1]))))


def mapping_table() -> Table:
    """Eyes and alpha over the whole range of floats."""
    eyes = (320.0, 0.0, -1e3, 1e6, 1e18, 1e308, 5e-324, math.inf, -math.inf, math.nan)
    alphas = (1e-9, 1e-3, 1.0, 12.0, 1e3, 1e9)
    rows = tuple((Cell(f"u = {u:g} px"), *(_cell(partial(mapping_error, a, u), 1e-9, 1e-3) for a in alphas)) for u in eyes)
    note = "Error in views against long double, with 9 views and 2 views of extrapolation."
    return Table("Eyes to viewpoints", note, ("left eye", *(f"alpha {a:g} px" for a in alphas)), rows)


def colour_error(name: str, light: str, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> float:
    """Largest difference in levels between the picture of two views, uint8 (h, w, 3) BGR, and the published matrix in float64."""
    linear = light == "linear" and name.startswith("dubois")
    views = [view[..., ::-1] / 255 for view in (left, right)]
    if linear:
        views = [decoded(view) for view in views]
    matrix = np.array(MATRICES[name])
    mixed = np.clip(sum(views[eye] @ matrix[:, eye].T for eye in (0, 1)), 0, 1)
    exact = (encoded(mixed) if linear else mixed)[..., ::-1] * 255
    return float(np.abs(encode(left, right, recipe(name, light)) - exact).max())


def colour_table(field: LightField) -> Table:
    """Every encoding in both lights, from grey to random colours, and the scene's own outer views."""
    grey = np.repeat(np.arange(256, dtype=np.uint8).reshape(16, 16, 1), 3, axis=2)
    black, random = np.zeros_like(grey), np.random.default_rng(1).integers(0, 256, (2, 128, 128, 3), np.uint8)
    scene = [np.broadcast_to(np.asarray(field.views[0, field.rows // 2, col])[::-1], (3, field.height_px, field.width_px))
             .transpose(1, 2, 0) for col in (0, field.cols - 1)]  # fmt: skip
    pairs = {"greys": (grey, grey), "one eye black": (grey, black), "the scene": (scene[0], scene[1]),
             "random colours": (random[0], random[1])}  # fmt: skip
    rows = []
    for name, light in itertools.product(MATRICES, ("linear", "gamma")):
        only = "" if (name, light) == (Render().anaglyph, Render().light) else f"render.anaglyph={name}, render.light={light}"
        cells = [_cell(partial(colour_error, name, light, *pair), 1.0, 16.0, only) for pair in pairs.values()]
        rows.append((Cell(f"{name}, {light}"), *cells))
    note = (
        "Largest error in levels against the published matrix in float64. Half a level is rounding; more is the price of three"
        " planes instead of six, largest for saturated colours (docs/glasses.md). failed: more than 16 levels."
    )
    return Table("Colours of two eyes", note, ("encoding", *pairs), tuple(rows))


def extreme_field(rows: int, cols: int, height: int, width: int, disparity_px: float, unknown: float = 0.0) -> LightField:
    """Noise with disparities up to disparity_px, of both signs. unknown: share of unknown disparities."""
    rng = np.random.default_rng(1)
    low = ((height + 1) // 2, (width + 1) // 2)
    disparity = rng.integers(-127, 128, (1, rows, cols, *low), np.int8)
    disparity[rng.random(disparity.shape) < unknown] = UNKNOWN
    return LightField(
        views=rng.integers(0, 256, (1, rows, cols, 3, height, width), np.uint8), disparity=disparity,
        disparity_scale_px=disparity_px / 127, disparity_min_px=-disparity_px, disparity_max_px=disparity_px,
        disparity_source="truth", offsets=np.zeros((rows, cols, 2), np.float32), present=np.ones((rows, cols), bool),
        geometry=Geometry(), frame_rate_hz=0.0, name="extreme", method="warp2", manifest={},
    )  # fmt: skip


def error_at_stored_views(field: LightField, method: str) -> float:
    """Largest difference between a stored view and the method's view at its position; 0 is required."""
    renderer, views = ViewRenderer(field, method), np.asarray(field.views)[0]
    stored = {(0, 0), (field.rows - 1, field.cols - 1), (field.rows // 2, field.cols // 2)}
    return max(float(np.abs(renderer.at((float(r), float(c))) - views[r, c]).max()) for r, c in stored)


def error_at_extremes(field: LightField, method: str) -> float:
    """Composes at impossible viewpoints (NaN, infinities, far outside, tiny fractions) with and without a plane of the screen in
    depth. Returns the largest difference between pictures with equal keys, which must be equal."""
    values = (math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 0.5, field.cols - 1 + 1e-12)
    worst = 0.0
    for zero_plane_px in (0.0, 900.0):
        compositor = Compositor(field, attrs.evolve(Render(method=method), zero_plane_px=zero_plane_px))  # type: ignore[arg-type]
        pictures: dict[object, NDArray[np.uint8]] = {}
        for value in values:
            for left, right in (((value, value), (0.0, value)), ((0.0, 0.0), (value, value))):
                picture = compositor.compose(left, right).copy()
                before = pictures.setdefault(compositor.key(left, right), picture)
                worst = max(worst, float(np.abs(before.astype(np.int16) - picture).max()))
    return worst


def mirror_error(field: LightField, method: str) -> float:
    """Mean difference between a view of the mirrored field and the mirrored view, in levels: no side is special."""
    disparity = None if field.disparity is None else np.asarray(field.disparity)[:, :, ::-1, :, ::-1]
    offsets = field.offsets[:, ::-1] * np.array([-1, 1], np.float32)
    views = np.asarray(field.views)[:, :, ::-1, :, :, ::-1]
    turned = attrs.evolve(field, views=views, offsets=offsets, present=field.present[:, ::-1], disparity=disparity)
    row, col = (field.rows - 1) / 2, (field.cols - 1) * 0.37
    view, other = (ViewRenderer(one, method).at((row, at)) for one, at in ((field, col), (turned, field.cols - 1 - col)))
    return float(np.abs(view - other[..., ::-1]).mean())


def synthesis_table(inputs: Inputs) -> Table:
    """The scene, and generated light fields of extreme sizes and disparities."""
    scene = attrs.evolve(inputs.field, views=inputs.field.views[:1])
    offset = extreme_field(3, 3, 32, 32, 2.0)
    offset.offsets[:] = np.random.default_rng(3).normal(0, 3, offset.offsets.shape)
    fields = {
        inputs.field.name or "scene": scene, "3x3 of 1x1 px": extreme_field(3, 3, 1, 1, 1.0),
        "2x2 of 2x3 px": extreme_field(2, 2, 2, 3, 1.0), "3x3 of 33x47 px": extreme_field(3, 3, 33, 47, 2.0),
        "1x1 view": extreme_field(1, 1, 32, 32, 1.0), "1x9 views": extreme_field(1, 9, 32, 32, 2.0),
        "5x1 views": extreme_field(5, 1, 32, 32, 2.0), "disparity 0": extreme_field(3, 3, 32, 32, 0.0),
        "disparity 1e-6 px": extreme_field(3, 3, 32, 32, 1e-6), "disparity 200 px of 32": extreme_field(3, 3, 32, 32, 200.0),
        "disparity 1e6 px": extreme_field(3, 3, 32, 32, 1e6), "a third unknown": extreme_field(3, 3, 32, 32, 2.0, 0.33),
        "all unknown": extreme_field(3, 3, 32, 32, 2.0, 1.1), "cameras out of place": offset,
    }  # fmt: skip
    checks = {"stored views": error_at_stored_views, "extremes": error_at_extremes, "mirrored": mirror_error}
    rows = []
    for what, field in fields.items():
        cells = []
        for method, (check, call) in itertools.product(METHODS, checks.items()):
            usable = field.disparity is not None or not method.startswith("warp")
            smooth = check != "mirrored" or what == (inputs.field.name or "scene")  # noise tells nothing of interpolation
            only = "" if method == inputs.field.method else f"render.method={method}"
            limits = (1.0, 3.0) if check == "mirrored" else (0.0, 1.0)
            cells.append(_cell(partial(call, field, method), *limits, only) if usable and smooth else Cell("-"))
        rows.append((Cell(what), *cells))
    head = ("light field", *(f"{method}: {check}" for method in METHODS for check in checks))
    note = (
        "Stored views: largest difference in levels from the stored view. Extremes: viewpoints of NaN, infinities, 1e308, 5e-324,"
        " a plane of the screen of 900 px; pictures with equal keys must be equal, and nothing may raise. Mirrored: mean"
        " difference in levels between a view of the mirrored scene and the mirrored view."
    )
    return Table("Views at the ends of the range", note, head, tuple(rows))


def tables(inputs: Inputs) -> Iterator[Table | Skipped]:
    """All tables."""
    rates_hz = (30, 240) if inputs.quick else RATES_HZ
    yield covariance_table(7 if inputs.quick else 9)  # the rationals' digits double every round
    yield from filter_tables(rates_hz)
    yield viewer_table(inputs.field, rates_hz)
    yield mapping_table()
    yield colour_table(inputs.field)
    yield synthesis_table(inputs)


SUBJECT = Subject(
    "stability",
    "Stiff and extreme cases",
    "Does anything lose precision, raise an exception or show a wrong picture, and for how long? Cells hold the worst error.",
    tables=tables,
    needs=("scene",),
)
