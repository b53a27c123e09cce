"""Subject: work that a scene does not need, its saving, and the measured error of omitting it."""

import math
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.anaglyph import view_bgr
from lfpipe.bench.holdout import viewpoint_walk
from lfpipe.bench.inputs import Inputs
from lfpipe.bench.model import Cell, Skipped, State, Subject, Table
from lfpipe.bench.timing import median_ms
from lfpipe.config import Config, load, updated
from lfpipe.render.anaglyph import MATRICES, encode, recipe
from lfpipe.render.compositor import Compositor
from lfpipe.render.plan import LeftOut, Plan, make_plan
from lfpipe.render.scoring import METHODS, WORTH_DB, left_out, score
from lfpipe.render.viewpoint import ViewSolver
from lfpipe.scene.lightfield import LightField

VIEWS, PICTURES = 7, 12


def without_warp(field: LightField, plan: Plan) -> Cell:
    """Loss in dB on held-out views, compared with the best method that warps."""
    if field.disparity is None:
        return Cell("unknown: there is no disparity to warp by")
    views = left_out(field, VIEWS) if min(field.rows, field.cols) >= 3 else []
    if not views:
        return Cell("unknown: the grid has no view to leave out")
    best = max(score(field, method, views) for method in METHODS if method.startswith("warp"))
    lost = best - score(field, plan.method, views)
    state: State = "ok" if lost < WORTH_DB else "degraded"
    return Cell(f"{lost:.2f} dB on left-out views" if lost > 0 else f"0 ({-lost:.2f} dB better on left-out views)", state)


def without_planes(field: LightField, config: Config) -> Cell:
    """Largest difference between a picture at stored views and one encoded from both complete views."""
    if config.render.anaglyph not in MATRICES:
        return Cell("unknown for this mode")
    render, row = config.render, field.rows // 2
    compositor, how = Compositor(field, render), recipe(render.anaglyph, render.light, render.ghost_compensation)
    pairs = []
    for left, right in (((0, 0), (field.rows - 1, field.cols - 1)), ((row, 0), (row, field.cols - 1))):
        picture = compositor.compose((float(left[0]), float(left[1])), (float(right[0]), float(right[1]))).copy()
        pairs.append((encode(view_bgr(field, *left), view_bgr(field, *right), how), picture))
    return _difference(pairs)


def without_rows(field: LightField, config: Config) -> Cell:
    """Largest difference between pictures for eyes at any height."""
    solver = ViewSolver(field.rows, field.cols, config.render, 30.0, (320.0, 240.0))
    compositor = Compositor(field, config.render)
    first, *others = [compositor.compose(*solver.views([[350.0, v], [290.0, v]])).copy() for v in (240.0, 0.0, 479.0, -1e6)]
    return _difference((first, other) for other in others)


def without_tracking(field: LightField, config: Config, plan: Plan) -> Cell:
    """Largest difference between pictures for eyes anywhere."""
    compositor = Compositor(field, updated(config, {"render.method": plan.method}).render)
    solver = ViewSolver(field.rows, field.cols, config.render, 30.0, (320.0, 240.0))
    eyes = ([[320.0 + x, 240.0], [260.0 + x, 240.0]] for x in (0.0, -300.0, 300.0))
    first, *others = [compositor.compose(*solver.views(pair)).copy() for pair in eyes]
    return _difference((first, other) for other in others)


def without_views(field: LightField, config: Config, plan: Plan) -> Cell:
    """Number of viewpoints outside the kept views, for eyes anywhere in the camera's picture."""
    if isinstance(config.render.alpha_px, str):
        return Cell("unknown: alpha is measured while a session runs")
    width, height = config.camera.width_px, config.camera.height_px
    solver = ViewSolver(field.rows, field.cols, config.render, config.render.alpha_px, (width / 2, height / 2))
    first_row, last_row, first_col, last_col = plan.reach
    outside = 0
    corners = [(u, v) for u in np.linspace(0, width, 9) for v in np.linspace(0, height, 9)]
    for u, v in corners:
        for row, col in solver.views([[u, v], [u, v]]):
            near = math.floor(row + 0.5), math.floor(col + 0.5)
            near_row, near_col = min(max(near[0], 0), field.rows - 1), min(max(near[1], 0), field.cols - 1)
            outside += not (first_row <= near_row <= last_row and first_col <= near_col <= last_col)
    return Cell(f"{outside} of {2 * len(corners)} viewpoints outside", "failed" if outside else "ok")


def without_colour(field: LightField) -> Cell:
    """A grey scene: difference between a picture of three equal planes and one of a single plane."""
    how = recipe("dubois")
    view = view_bgr(field, field.rows // 2, field.cols // 2)
    return _difference([(view, encode(view, view, how))])


def _difference(pairs: Iterable[tuple[NDArray[np.uint8], NDArray[np.uint8]]]) -> Cell:
    """Largest difference in levels between two pictures of a pair."""
    worst = max(int(np.abs(a.astype(np.int16) - b).max()) for a, b in pairs)
    return Cell("0" if worst == 0 else f"{worst} levels at most", "ok" if worst <= 1 else "failed")


def error_of(item: LeftOut, field: LightField, config: Config, plan: Plan) -> Cell:
    """The measured error of omitting one item."""
    what = item.what
    if what in ("warping", "disparity maps"):
        return without_warp(field, plan)
    if what == "row coordinate":
        return without_rows(field, config)
    if what == "capture and tracking":
        return without_tracking(field, config, plan)
    if what == "two of three colour planes":
        return without_colour(field)
    if what.endswith("planes per picture"):
        return without_planes(field, config)
    if what.endswith("views"):
        return without_views(field, config, plan)
    return Cell("none: the configuration sets the result", "ok")


def tables(inputs: Inputs) -> Iterator[Table | Skipped]:
    """One table per scene, with the default configuration and the paper's."""
    for path, field in inputs.fields:
        rows = []
        for named, config in (("default", Config()), ("paper", load("paper"))):
            plan = make_plan(field, config, measure=True)
            for item in plan.left_out:
                cell = error_of(item, field, config, plan)
                rows.append((Cell(named), Cell(item.what), Cell(item.why), Cell(item.saves), cell))
            cost = f"{_picture_ms(field, config):.2f} ms a picture"
            rows.append((Cell(named), Cell("the rest"), Cell(f"method {plan.method}"), Cell(cost), Cell("")))
        head = ("configuration", "left out", "because", "saves", "error of leaving it out")
        title = f"{field.name or path.name}: {field.rows}x{field.cols} views of {field.width_px}x{field.height_px}"
        yield Table(title, "The last line of each configuration is the cost of a picture without these items.", head, tuple(rows))


def _picture_ms(field: LightField, config: Config) -> float:
    compositor, step = Compositor(field, config.render), viewpoint_walk(field)
    compositor.compose(*step())
    return median_ms(lambda: compositor.compose(*step()), PICTURES)


SUBJECT = Subject(
    "plan",
    "What the scene does not need",
    "What the plan leaves out for each scene, why, what it saves, and the measured error.",
    tables=tables,
)
