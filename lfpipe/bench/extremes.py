"""Stiff and extreme cases of the picture: eyes to viewpoints, colours of two eyes, views at the ends of the range."""

import itertools
import math

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.anaglyph import view_bgr
from lfpipe.bench.inputs import Inputs
from lfpipe.bench.results import State, Table, judged_error, judged_table
from lfpipe.bench.synthesis import ViewRenderer
from lfpipe.config import Render
from lfpipe.config.quality import METHODS
from lfpipe.render.anaglyph import MATRICES, decoded, encode, encoded, recipe
from lfpipe.render.compositor import Compositor
from lfpipe.render.viewpoint import ViewSolver, pair_clamped
from lfpipe.scene.lightfield import UNKNOWN, Geometry, LightField

wide = np.longdouble


def mapping_error(alpha_px: float, u: float, count: int = 9, reach: float = 2.0) -> float:
    """Distance in views between the mapping and the same in long double, before the clamp; infinite if it is not finite, leaves
    the zone, or is wrong in its clamp."""
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
    eyes, alphas = (
        (320.0, 0.0, -1e3, 1e6, 1e18, 1e308, 5e-324, math.inf, -math.inf, math.nan),
        (1e-9, 1e-3, 1.0, 12.0, 1e3, 1e9),
    )
    note = "Error in views against long double, with 9 views and 2 views of extrapolation."
    rows, columns = (
        {f"u = {u:g} px": u for u in eyes},
        {f"alpha {alpha:g} px": alpha for alpha in alphas},
    )

    def judge(u: float, alpha_px: float) -> tuple[str, State]:
        return judged_error(mapping_error(alpha_px, u), 1e-9, 1e-3)

    return judged_table("Eyes to viewpoints", note, "left eye", rows, columns, judge)


def colour_error(name: str, light: str, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> float:
    """Largest difference in levels between the picture of two views, uint8 (h, w, 3) BGR, and the published matrix in float64."""
    linear = light == "linear" and name.startswith("dubois")
    views = [
        decoded(view[..., ::-1] / 255) if linear else view[..., ::-1] / 255
        for view in (left, right)
    ]
    mixed = np.clip(sum(views[eye] @ np.array(MATRICES[name])[:, eye].T for eye in (0, 1)), 0, 1)
    exact = (encoded(mixed) if linear else mixed)[..., ::-1] * 255
    return float(np.abs(encode(left, right, recipe(name, light)) - exact).max())


def colour_table(field: LightField) -> Table:
    """Every encoding in both lights, from grey to random colours, and the scene's own outer views."""
    grey = np.repeat(np.arange(256, dtype=np.uint8).reshape(16, 16, 1), 3, axis=2)
    random = np.random.default_rng(1).integers(0, 256, (2, 128, 128, 3), np.uint8)
    scene = [view_bgr(field, field.rows // 2, col) for col in (0, field.cols - 1)]
    pairs = {"greys": (grey, grey), "one eye black": (grey, np.zeros_like(grey)), "the scene": (scene[0], scene[1]),
             "random colours": (random[0], random[1])}  # fmt: skip
    note = (
        "Largest error in levels against the published matrix in float64. Half a level is rounding; more is the price of three"
        " planes instead of six, largest for saturated colours (docs/glasses.md). failed: more than 16 levels."
    )
    encodings = {
        f"{name}, {light}": (name, light)
        for name, light in itertools.product(MATRICES, ("linear", "gamma"))
    }

    def judge(
        encoding: tuple[str, str], pair: tuple[NDArray[np.uint8], NDArray[np.uint8]]
    ) -> tuple[str, State]:
        return judged_error(colour_error(*encoding, *pair), 1.0, 16.0)

    def only(encoding: tuple[str, str], _pair: object) -> str:
        in_use = encoding == (Render().anaglyph, Render().light)
        return "" if in_use else "render.anaglyph={}, render.light={}".format(*encoding)

    return judged_table("Colours of two eyes", note, "encoding", encodings, pairs, judge, only)


def extreme_field(
    rows: int, cols: int, height: int, width: int, disparity_px: float, unknown: float = 0.0
) -> LightField:
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
    return max(
        float(np.abs(renderer.at((float(r), float(c))) - views[r, c]).max()) for r, c in stored
    )


def error_at_extremes(field: LightField, method: str) -> float:
    """Composes at impossible viewpoints (NaN, infinities, far outside, tiny fractions) with and without a plane of the screen in
    depth. Returns the largest difference between pictures with equal keys, which must be equal."""
    values, worst = (
        (math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 0.5, field.cols - 1 + 1e-12),
        0.0,
    )
    for zero_plane_px in (0.0, 900.0):
        compositor = Compositor(
            field, attrs.evolve(Render(method=method), zero_plane_px=zero_plane_px)
        )  # type: ignore[arg-type]
        pictures: dict[object, NDArray[np.uint8]] = {}
        for value in values:
            for left, right in (((value, value), (0.0, value)), ((0.0, 0.0), (value, value))):
                picture = compositor.compose(left, right).copy()
                before = pictures.setdefault(compositor.key(left, right), picture)
                worst = max(worst, float(np.abs(before.astype(np.int16) - picture).max()))
    return worst


def mirror_error(field: LightField, method: str) -> float:
    """Mean difference between a view of the mirrored field and the mirrored view, in levels: no side is special."""
    disparity = (
        None if field.disparity is None else np.asarray(field.disparity)[:, :, ::-1, :, ::-1]
    )
    offsets = field.offsets[:, ::-1] * np.array([-1, 1], np.float32)
    views = np.asarray(field.views)[:, :, ::-1, :, :, ::-1]
    turned = attrs.evolve(
        field, views=views, offsets=offsets, present=field.present[:, ::-1], disparity=disparity
    )
    row, col = (field.rows - 1) / 2, (field.cols - 1) * 0.37
    view, other = (
        ViewRenderer(one, method).at((row, at))
        for one, at in ((field, col), (turned, field.cols - 1 - col))
    )
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
    checks = {
        "stored views": error_at_stored_views,
        "extremes": error_at_extremes,
        "mirrored": mirror_error,
    }

    def judge(field: LightField, column: tuple[str, str]) -> tuple[str, State]:
        method, check = column
        if (field.disparity is None and method not in ("nearest", "blend")) or (
            check == "mirrored" and field is not scene
        ):
            return "-", ""  # noise tells nothing of interpolation
        return judged_error(
            checks[check](field, method), *((1.0, 3.0) if check == "mirrored" else (0.0, 1.0))
        )

    def only(_field: LightField, column: tuple[str, str]) -> str:
        return "" if column[0] == inputs.field.method else f"render.method={column[0]}"

    note = (
        "Stored views: largest difference in levels from the stored view. Extremes: viewpoints of NaN, infinities, 1e308, 5e-324,"
        " a plane of the screen of 900 px; pictures with equal keys must be equal, and nothing may raise. Mirrored: mean"
        " difference in levels between a view of the mirrored scene and the mirrored view."
    )
    columns = {
        f"{method}: {check}": (method, check)
        for method, check in itertools.product(METHODS[::-1], checks)
    }
    return judged_table(
        "Views at the ends of the range", note, "light field", fields, columns, judge, only
    )
