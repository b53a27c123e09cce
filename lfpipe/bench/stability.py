"""Subject: stiff and extreme cases as tables of cells: ok, degraded or failed, with the worst error.

References are exact or in long double: rationals for the covariance, np.longdouble for mapping and mixing, the last good
measurement for filters that receive nonsense, the stored views for pictures.
"""

import itertools
import math
from collections.abc import Callable, Iterator
from functools import partial

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.covariance import FORMS, NOISES, STEPS_S, stiff_cases
from lfpipe.bench.holdout import ViewRenderer
from lfpipe.bench.inputs import Inputs
from lfpipe.bench.model import Cell, Skipped, State, Subject, Table
from lfpipe.config import Render, Track
from lfpipe.render.anaglyph import MATRICES, Mixer, recipe
from lfpipe.render.compositor import Compositor
from lfpipe.render.viewpoint import ViewSolver
from lfpipe.scene.lightfield import Geometry, LightField
from lfpipe.track.filters import make_filter

FILTERS = ("mean", "one-euro", "kalman", "predictive")
METHODS = ("nearest", "blend", "warp", "warp2", "best")
LIGHTS = ("linear", "gamma")
FRAME_NS = 33_333_333
EYES = np.array([[350.0, 240.0], [290.0, 242.0]])
wide = np.longdouble


def judged(worst: float, ok: float, degraded: float) -> Cell:
    """ok up to `ok`, degraded up to `degraded`, failed above and for NaN."""
    state: State = "ok" if worst <= ok else "degraded" if worst <= degraded else "failed"
    return Cell(f"{worst:.1e}" if worst else "0", state)


def _cell(work: Callable[[], float], ok: float, degraded: float) -> Cell:
    """The worst error that work returns, judged; an exception is a failure with its name."""
    try:
        return judged(work(), ok, degraded)
    except Exception as error:  # the exception is the result
        return Cell(f"{type(error).__name__}: {error}"[:80], "failed")


def covariance_tables(exact_rounds: int) -> Iterator[Table]:
    """The 125 stiff settings, one table per form of the update."""
    cases = list(stiff_cases(exact_rounds=exact_rounds))
    for form in FORMS:
        rows = []
        for q, r in itertools.product(NOISES, NOISES):
            row = [case for case in cases if (case.form, case.q, case.r) == (form, q, r)]
            cells = [
                judged(case.worst, 1e-12, 1e-3) if case.definite else Cell(f"{case.worst:.1e}, not semi-definite", "failed")
                for case in row
            ]
            rows.append((Cell(f"q {q:.0e}, r {r:.0e}"), *cells))
        used = " (in use)" if form == FORMS[0] else " (for comparison)"
        note = "Worst relative error of an entry against rational arithmetic; failed if the matrix is no longer semi-definite."
        yield Table(f"Covariance, {form}{used}", note, ("noise", *(f"step {d:.1e} s" for d in STEPS_S)), tuple(rows))


def disturbances() -> dict[str, list[tuple[int, NDArray[np.float64]]]]:
    """Name -> input between two runs of good frames, as (step in ns since the last frame, measurement)."""

    def eyes(value: float) -> NDArray[np.float64]:
        return np.full((2, 2), value)

    return {
        "dt = 0": [(0, EYES)] * 5,
        "dt = -1/30 s": [(-FRAME_NS, EYES)] * 3,
        "dt = 1 ns": [(1, EYES + 0.3)] * 5,
        "dt = 1e6 s": [(10**15, EYES)],
        "1 NaN": [(FRAME_NS, eyes(math.nan))],
        "30 NaN": [(FRAME_NS, eyes(math.nan))] * 30,
        "infinity": [(FRAME_NS, eyes(math.inf))],
        "spike of 1e18": [(FRAME_NS, eyes(1e18))],
        "spike of 1e5 px": [(FRAME_NS, EYES + 1e5)],
        "denormals": [(FRAME_NS, eyes(5e-324))],
        "largest float": [(FRAME_NS, eyes(float(np.finfo(np.float64).max)))],
        "clock of 292 years": [(2**62, EYES)],
    }


def error_after(name: str, disturbance: list[tuple[int, NDArray[np.float64]]]) -> float:
    """Largest distance in px from a still viewer's eyes, starting a second after the disturbance; infinite if any output is not
    finite."""
    filter_ = make_filter(Track(filter=name))  # type: ignore[arg-type]
    t_ns, worst = 10**12, 0.0
    good = [(FRAME_NS, EYES)]
    steps = [*good * 40, *disturbance, *good * 60]
    for k, (step_ns, eyes) in enumerate(steps):
        t_ns += step_ns
        position, velocity = filter_.update(t_ns, eyes)
        ahead = filter_.predict(t_ns + 40_000_000) if k >= len(steps) - 60 else position
        if not (np.isfinite(position).all() and np.isfinite(velocity).all() and np.isfinite(ahead).all()):
            return math.inf
        if k >= len(steps) - 30:
            worst = max(worst, float(np.abs(ahead - EYES).max()))
    return worst


def filter_table() -> Table:
    """Every filter with every disturbance."""
    rows = [
        (Cell(what), *(_cell(partial(error_after, name, disturbance), 0.1, 2.0) for name in FILTERS))
        for what, disturbance in disturbances().items()
    ]
    note = "A still viewer, the disturbance, good frames: largest error in px from a second later on, predicted 40 ms ahead."
    return Table("Filters that receive nonsense", note, ("between good frames", *FILTERS), tuple(rows))


def mapping_error(alpha_px: float, u: float, count: int = 9, reach: float = 2.0) -> float:
    """Distance in views between the mapping and the same in long double, clamps included; infinite if it is not finite."""
    solver = ViewSolver(count, count, Render(extrapolate_views=reach), alpha_px, (320.0, 240.0))
    found = solver.views([[u, 240.0], [u - 60.0, 240.0]])[0][1]
    if not math.isfinite(found):
        return math.inf
    middle, edge = wide(count - 1) / 2, wide(count - 1)
    if math.isnan(u):
        return float(abs(wide(found) - middle))
    value = middle + np.clip((wide(320.0) - wide(u)) / wide(alpha_px), -wide(1e4), wide(1e4))
    inside = np.clip(value, 0, edge)
    return float(abs(wide(found) - (inside + wide(reach) * np.tanh((value - inside) / wide(reach)))))


def mapping_table() -> Table:
    """Eyes and alpha over the whole range of floats."""
    eyes = (320.0, 0.0, -1e3, 1e6, 1e18, 1e308, 5e-324, math.inf, -math.inf, math.nan)
    alphas = (1e-9, 1e-3, 1.0, 12.0, 1e3, 1e9)
    rows = tuple((Cell(f"u = {u:g} px"), *(_cell(partial(mapping_error, a, u), 1e-9, 1e-3) for a in alphas)) for u in eyes)
    note = "Error in views against long double, with 9 views and 2 views of extrapolation."
    return Table("Eyes to viewpoints", note, ("left eye", *(f"alpha {a:g} px" for a in alphas)), rows)


def mixing_error(name: str, light: str, pairs: list[tuple[NDArray[np.uint8], NDArray[np.uint8]]]) -> float:
    """Largest difference in levels between the mixer and the same in long double, over (left, right) planes of 16x16."""
    how, worst = recipe(name, light), 0.0
    for pair in pairs:
        out = np.empty((16, 16, 3), np.uint8)
        Mixer(how, 16, 16).mix([pair[plane.eye] for plane in how.planes], out)
        sides = [_light(plane.astype(wide) / 255, how.linear) for plane in pair]
        for c, channel in enumerate(how.channels):
            value = channel.own_gain * sides[how.planes[channel.own].eye]
            if channel.cross is not None:
                value = value + channel.cross_gain * sides[how.planes[channel.cross].eye]
            wanted = 255 * _code(np.clip(value, 0, 1), how.linear)
            worst = max(worst, float(np.abs(out[..., 2 - c] - wanted).max()))
    return worst


def mixing_table() -> Table:
    """Flat pictures and a grey ramp through every encoding, in both lights."""
    ramp = np.arange(256, dtype=np.uint8).reshape(16, 16)
    black, white = np.zeros_like(ramp), np.full_like(ramp, 255)
    cases = {
        "black": [(black, black)],
        "white": [(white, white)],
        "every grey": [(ramp, ramp)],
        "one eye white, the other black": [(white, black), (black, white)],
    }
    rows = tuple(
        (
            Cell(name),
            *(_cell(partial(mixing_error, name, light, pairs), 0.501, 1.5) for pairs in cases.values() for light in LIGHTS),
        )
        for name in MATRICES
    )
    head = ("encoding", *(f"{what}, {light}" for what in cases for light in LIGHTS))
    return Table("Mixing of two eyes", "Largest error in levels against long double; half a level is rounding.", head, rows)


def _light(code: NDArray[np.longdouble], linear: bool) -> NDArray[np.longdouble]:
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** wide(2.4)) if linear else code


def _code(light: NDArray[np.longdouble], linear: bool) -> NDArray[np.longdouble]:
    return np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / wide(2.4)) - 0.055) if linear else light


def extreme_field(rows: int, cols: int, height: int, width: int, disparity_px: float) -> LightField:
    """Noise with disparities up to disparity_px, of both signs."""
    rng = np.random.default_rng(1)
    low = ((height + 1) // 2, (width + 1) // 2)
    return LightField(
        views=rng.integers(0, 256, (1, rows, cols, 3, height, width), np.uint8),
        disparity=rng.integers(-127, 128, (1, rows, cols, *low), np.int8), disparity_scale_px=disparity_px / 127,
        disparity_min_px=-disparity_px, disparity_max_px=disparity_px, disparity_source="truth",
        offsets=np.zeros((rows, cols, 2), np.float32), present=np.ones((rows, cols), bool), geometry=Geometry(),
        frame_rate_hz=0.0, name="extreme", method="warp2", manifest={},
    )  # fmt: skip


def error_at_stored_views(field: LightField, method: str) -> float:
    """Largest difference between a stored view and the method's view at its position; 0 is required."""
    renderer, views = ViewRenderer(field, method), np.asarray(field.views)[0]
    stored = {(0, 0), (field.rows - 1, field.cols - 1), (field.rows // 2, field.cols // 2)}
    return max(float(np.abs(renderer.at((float(r), float(c))) - views[r, c]).max()) for r, c in stored)


def error_at_extremes(field: LightField, method: str) -> float:
    """Composes at impossible viewpoints (NaN, infinities, far outside, tiny fractions). Returns the largest difference between
    pictures with equal keys, which must be equal."""
    compositor = Compositor(field, Render(method=method))  # type: ignore[arg-type]
    values = (math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 0.5, field.cols - 1 + 1e-12)
    pictures: dict[object, NDArray[np.uint8]] = {}
    worst = 0.0
    for value in values:
        for left, right in (((value, value), (0.0, value)), ((0.0, 0.0), (value, value))):
            picture = compositor.compose(left, right).copy()
            before = pictures.setdefault(compositor.key(left, right), picture)
            worst = max(worst, float(np.abs(before.astype(np.int16) - picture).max()))
    return worst


def synthesis_table(inputs: Inputs) -> Table:
    """The scene, and generated light fields of extreme sizes and disparities."""
    fields = {
        inputs.field.name or "scene": attrs.evolve(inputs.field, views=inputs.field.views[:1]),
        "3x3 of 1x1 px": extreme_field(3, 3, 1, 1, 1.0),
        "2x2 of 2x3 px": extreme_field(2, 2, 2, 3, 1.0),
        "1x1 view": extreme_field(1, 1, 32, 32, 1.0),
        "1x9 views": extreme_field(1, 9, 32, 32, 2.0),
        "5x1 views": extreme_field(5, 1, 32, 32, 2.0),
        "disparity 0": extreme_field(3, 3, 32, 32, 0.0),
        "disparity 1e-6 px": extreme_field(3, 3, 32, 32, 1e-6),
        "disparity 200 px of 32": extreme_field(3, 3, 32, 32, 200.0),
        "disparity 1e6 px": extreme_field(3, 3, 32, 32, 1e6),
    }

    def cell(check: Callable[[LightField, str], float], field: LightField, method: str) -> Cell:
        usable = field.disparity is not None or not method.startswith("warp")
        return _cell(partial(check, field, method), 0.0, 1.0) if usable else Cell("not applicable")

    checks = (error_at_stored_views, error_at_extremes)
    rows = tuple((Cell(what), *(cell(c, field, m) for m in METHODS for c in checks)) for what, field in fields.items())
    head = ("light field", *(f"{m}: {what}" for m in METHODS for what in ("stored views", "extremes")))
    note = (
        "Stored views: largest difference in levels from the stored view. Extremes: viewpoints of NaN, infinities,"
        " 1e308, 5e-324; pictures with equal keys must be equal, and nothing may raise."
    )
    return Table("Views at the ends of the range", note, head, rows)


def tables(inputs: Inputs) -> Iterator[Table | Skipped]:
    """All tables."""
    yield from covariance_tables(8 if inputs.quick else 12)
    yield filter_table()
    yield mapping_table()
    yield mixing_table()
    if inputs.field.disparity is None:
        yield Skipped("warping of the scene at its extremes", "the scene has no disparity; generated light fields are tested")
    yield synthesis_table(inputs)


SUBJECT = Subject(
    "stability",
    "Stiff and extreme cases",
    "Does anything lose precision, raise an exception or show a wrong picture? Each cell holds the worst error.",
    tables=tables,
)
