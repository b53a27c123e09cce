"""Subject: stiff and extreme cases, as tables of cells: ok, degraded or failed, with the worst error.

References are exact or in long double: rationals for the covariance, np.longdouble for the mapping and the mixing, the last good
measurement for filters that are fed nonsense, the stored views for pictures.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.inputs import Inputs
from lfpipe.bench.kept import made
from lfpipe.bench.model import Cell, Skipped, State, Subject, Table
from lfpipe.bench.stiff import FORMS, NOISES, STEPS_S, cells
from lfpipe.config import Render, Track
from lfpipe.render.anaglyph import MATRICES, Mixer, recipe
from lfpipe.render.compositor import Compositor
from lfpipe.render.synthesis import Synthesiser
from lfpipe.render.viewpoint import Mapper
from lfpipe.scene.lightfield import Geometry, LightField
from lfpipe.track.filters import make_filter

FILTERS = ("mean", "one-euro", "kalman", "predictive")
FRAME_NS = 33_333_333
EYES = np.array([[350.0, 240.0], [290.0, 242.0]])


def judged(worst: float, fine: float, bearable: float) -> Cell:
    """ok up to fine, degraded up to bearable, failed beyond and where worst is not a number."""
    state: State = "ok" if worst <= fine else "degraded" if worst <= bearable else "failed"
    return Cell(f"{worst:.1e}" if worst else "0", state)


def _guarded(work: Callable[[], float], fine: float, bearable: float) -> Cell:
    """The worst error that work returns, judged; an exception is a failure with its name."""
    try:
        return judged(work(), fine, bearable)
    except Exception as error:  # whatever it throws is the result here
        return Cell(f"{type(error).__name__}: {error}"[:80], "failed")


def covariance_tables(exact_rounds: int) -> Iterator[Table]:
    """The 125 stiff settings, one table per form of the update."""
    found = list(cells(exact_rounds=exact_rounds))
    for form in FORMS:
        rows = []
        for q in NOISES:
            for r in NOISES:
                part = [cell for cell in found if (cell.form, cell.q, cell.r) == (form, q, r)]
                marks = [judged(c.worst if c.definite else math.inf, 1e-12, 1e-3) for c in part]
                marks = [
                    mark if c.definite else Cell(f"{c.worst:.1e}, not semi-definite", "failed")
                    for c, mark in zip(part, marks, strict=True)
                ]
                rows.append((Cell(f"q {q:.0e}, r {r:.0e}"), *marks))
        used = " (the one used)" if form == FORMS[0] else " (for comparison)"
        note = "Worst relative error of an entry against rational arithmetic; failed where the matrix loses its definiteness."
        yield Table(f"Covariance, {form}{used}", note, ("noise", *(f"step {d:.1e} s" for d in STEPS_S)), tuple(rows))


def disturbances() -> dict[str, list[tuple[int, NDArray[np.float64]]]]:
    """Name -> what comes between two runs of good frames, as (step in ns since the last frame, measurement)."""
    nan, spike, huge = np.full((2, 2), np.nan), EYES + 1e5, np.full((2, 2), 1e18)
    return {
        "dt = 0": [(0, EYES)] * 5,
        "dt = -1/30 s": [(-FRAME_NS, EYES)] * 3,
        "dt = 1 ns": [(1, EYES + 0.3)] * 5,
        "dt = 1e6 s": [(10**15, EYES)],
        "1 NaN": [(FRAME_NS, nan)],
        "30 NaN": [(FRAME_NS, nan)] * 30,
        "infinity": [(FRAME_NS, np.full((2, 2), np.inf))],
        "spike of 1e18": [(FRAME_NS, huge)],
        "spike of 1e5 px": [(FRAME_NS, spike)],
        "denormals": [(FRAME_NS, np.full((2, 2), 5e-324))],
        "largest float": [(FRAME_NS, np.full((2, 2), np.finfo(np.float64).max))],
        "clock of 292 years": [(2**62, EYES)],
    }


def after(name: str, between: list[tuple[int, NDArray[np.float64]]]) -> float:
    """Largest distance in px from a still viewer's eyes, from a second after the disturbance on; infinite where any output of the
    whole run was not finite."""
    one = make_filter(Track(filter=name))  # type: ignore[arg-type]
    t_ns = 10**12
    for _ in range(40):
        t_ns += FRAME_NS
        one.update(t_ns, EYES)
    for step_ns, eyes in between:
        t_ns += step_ns
        position, velocity = one.update(t_ns, eyes)
        if not (np.isfinite(position).all() and np.isfinite(velocity).all()):
            return math.inf
    worst = 0.0
    for k in range(60):
        t_ns += FRAME_NS
        one.update(t_ns, EYES)
        ahead = one.predict(t_ns + 40_000_000)
        if not np.isfinite(ahead).all():
            return math.inf
        if k >= 30:
            worst = max(worst, float(np.abs(ahead - EYES).max()))
    return worst


def filter_table() -> Table:
    """Every filter against every disturbance."""
    rows = []
    for what, between in disturbances().items():
        marks = [_guarded(lambda n=name, b=between: after(n, b), 0.1, 2.0) for name in FILTERS]  # type: ignore[misc]
        rows.append((Cell(what), *marks))
    note = "A still viewer, the disturbance, good frames: largest error in px from a second later on, predicted 40 ms ahead."
    return Table("Filters fed with nonsense", note, ("between good frames", *FILTERS), tuple(rows))


def mapped(alpha_px: float, u: float, count: int = 9, reach: float = 2.0) -> float:
    """Distance in views of the mapping from the same in long double, clamps included; infinite where it is not finite."""
    mapper = Mapper(count, count, Render(extrapolate_views=reach), alpha_px, (320.0, 240.0))
    found = mapper.views([[u, 240.0], [u - 60.0, 240.0]])[0][1]
    if not math.isfinite(found):
        return math.inf
    wide = np.longdouble
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
    rows = tuple(
        (Cell(f"u = {u:g} px"), *(_guarded(lambda a=a, u=u: mapped(a, u), 1e-9, 1e-3) for a in alphas))  # type: ignore[misc]
        for u in eyes
    )
    note = "Error in views against long double, with 9 views and 2 views of extrapolation."
    return Table("Eyes to viewpoints", note, ("left eye", *(f"alpha {a:g} px" for a in alphas)), rows)


def mixing_table() -> Table:
    """Flat pictures of every kind through every encoding, both lights, against long double."""
    ramp = np.arange(256, dtype=np.uint8).reshape(16, 16)
    cases = {
        "black": ramp * 0,
        "white": ramp * 0 + 255,
        "every grey": ramp,
        "own white, other black": None,
        "own black, other white": None,
    }
    wide = np.longdouble
    rows = []
    for name in MATRICES:
        marks = []
        for what, grey in cases.items():
            for light in ("linear", "gamma"):

                def worst(name: str = name, what: str = what, grey: NDArray[np.uint8] | None = grey, light: str = light) -> float:
                    how = recipe(name, light)
                    away = 0.0
                    for eye in (0, 1) if grey is None else (2,):
                        values = [
                            grey if grey is not None else ramp * 0 + (255 if (k == eye) == what.startswith("own white") else 0)
                            for k in (0, 1)
                        ]
                        out = np.empty((16, 16, 3), np.uint8)
                        Mixer(how, 16, 16).mix([values[plane.eye] for plane in how.planes], out)
                        sides = [_light(v.astype(wide) / 255, how.linear) for v in values]
                        for c, channel in enumerate(how.channels):
                            value = channel.own_gain * sides[how.planes[channel.own].eye]
                            if channel.cross is not None:
                                value = value + channel.cross_gain * sides[how.planes[channel.cross].eye]
                            wanted = 255 * _code(np.clip(value, 0, 1), how.linear)
                            away = max(away, float(np.abs(out[..., 2 - c] - wanted).max()))
                    return away

                marks.append(_guarded(worst, 0.501, 1.5))
        rows.append((Cell(name), *marks))
    head = ("encoding", *(f"{what}, {light}" for what in cases for light in ("linear", "gamma")))
    return Table(
        "Mixing of two eyes", "Largest error in levels against long double; half a level is rounding.", head, tuple(rows)
    )


def _light(code: NDArray[np.longdouble], linear: bool) -> NDArray[np.longdouble]:
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** np.longdouble(2.4)) if linear else code


def _code(light: NDArray[np.longdouble], linear: bool) -> NDArray[np.longdouble]:
    if not linear:
        return light
    return np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / np.longdouble(2.4)) - 0.055)


def extreme_field(rows: int, cols: int, height: int, width: int, disparity_px: float) -> LightField:
    """Noise with disparities of that size and both signs."""
    rng = np.random.default_rng(1)
    low = ((height + 1) // 2, (width + 1) // 2)
    return LightField(
        views=rng.integers(0, 256, (1, rows, cols, 3, height, width), np.uint8),
        disparity=rng.integers(-127, 128, (1, rows, cols, *low), np.int8),
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
        manifest={},
    )


def at_stored(field: LightField, method: str) -> float:
    """Largest difference of any stored view from what the method makes at its place: 0, as whole numbers are the views."""
    outs = [np.empty((field.height_px, field.width_px), np.uint8) for _ in range(field.channels)]
    synthesiser, whole = Synthesiser(field, method), np.asarray(field.views)[0]
    places = {(0, 0), (field.rows - 1, field.cols - 1), (field.rows // 2, field.cols // 2)}
    return max(float(np.abs(made(field, synthesiser, (float(r), float(c)), outs) - whole[r, c]).max()) for r, c in places)


def at_extremes(field: LightField, method: str) -> float:
    """Composes where no viewer can be (NaN, infinities, far outside, tiny fractions); the largest difference between pictures of
    one key, which must be equal."""
    compositor = Compositor(field, Render(method=method))  # type: ignore[arg-type]
    values = (math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 0.5, field.cols - 1 + 1e-12)
    drawn: dict[object, NDArray[np.uint8]] = {}
    worst = 0.0
    for value in values:
        for left, right in (((value, value), (0.0, value)), ((0.0, 0.0), (value, value))):
            picture = compositor.compose(left, right).copy()
            before = drawn.setdefault(compositor.key(left, right), picture)
            worst = max(worst, float(np.abs(before.astype(np.int16) - picture).max()))
    return worst


def synthesis_table(inputs: Inputs) -> Table:
    """The scene, and made light fields of extreme sizes and disparities."""
    thin = attrs.evolve(inputs.field, views=inputs.field.views[:1])
    fields = {
        inputs.field.name or "scene": thin,
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
    methods = ("nearest", "blend", "warp", "warp2")
    rows = []
    for what, field in fields.items():
        usable = [m for m in methods if field.disparity is not None or not m.startswith("warp")]
        stored = {m: _guarded(lambda f=field, m=m: at_stored(f, m), 0.0, 1.0) for m in usable}  # type: ignore[misc]
        extreme = {m: _guarded(lambda f=field, m=m: at_extremes(f, m), 0.0, 1.0) for m in usable}  # type: ignore[misc]
        blank = Cell("left out")
        rows.append((Cell(what), *(t.get(m, blank) for m in methods for t in (stored, extreme))))
    head = ("light field", *(f"{m}: {what}" for m in methods for what in ("stored places", "extremes")))
    note = (
        "Stored places: largest difference in levels from the stored view. Extremes: viewpoints of NaN, infinities,"
        " 1e308, 5e-324; pictures of one key must be equal, and nothing may throw."
    )
    return Table("Views at the ends of the range", note, head, tuple(rows))


def tables(inputs: Inputs) -> Iterator[Table | Skipped]:
    """All tables."""
    yield from covariance_tables(8 if inputs.quick else 12)
    yield filter_table()
    yield mapping_table()
    yield mixing_table()
    if inputs.field.disparity is None:
        yield Skipped("warping of the scene at its extremes", "the scene has no disparity; made light fields are tried")
    yield synthesis_table(inputs)


SUBJECT = Subject(
    "stability",
    "Stiff and extreme cases",
    "Where numbers are extreme: does anything lose its digits, throw, or show something else? Each cell holds the worst error.",
    tables=tables,
)
