"""The work that rendering a scene under a configuration needs: scores and costs of the methods, and
the work that is skipped.

For scores, every second view is held out, predicted from the others, and compared. `scene.analysis`
interprets the scores, `config.quality` the errors. The plan is only a report: stages do not read
it. Each entry comes from the function that the stage itself uses to decide.
"""

import itertools
import math
import time
from collections.abc import Callable, Iterator, Mapping
from typing import cast

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Config, Render
from lfpipe.config.camera_pose import CameraPose
from lfpipe.config.quality import METHODS, SIZES, WARPS, DrawingLevel, drawing_levels
from lfpipe.config.tree import Method
from lfpipe.files.codecs import fit_area
from lfpipe.host.worker import add
from lfpipe.render.synthesis.compositor import (
    Compositor,
    Painters,
    method_for,
    planes_of_eyes,
    settings_for_scene,
)
from lfpipe.render.synthesis.engine import Synthesiser
from lfpipe.render.synthesis.scene_views import SceneViews, reduced, stored_channels
from lfpipe.render.synthesis.viewpoint import Position
from lfpipe.scene.analysis import CONFIRMED
from lfpipe.scene.lightfield import LightField, MethodScores

SCREEN_PX = (1920, 1080)  # (width, height) that scores are for: larger views are reduced to it
BETWEEN = (0.25, 0.5, 0.75)  # viewpoints on a line of two views, none of which can be held out
PATH_STEPS = 8  # of a viewpoint from one stored view to the next


def psnr_db(mean_square: float) -> float:
    """Peak signal-to-noise ratio of 8-bit pictures; 100 dB means no difference."""
    return min(100.0, 10 * math.log10(255.0**2 / max(mean_square, 1e-10)))


def thinned(field: LightField) -> LightField:
    """Every second view along either axis as a light field: disparities grow with the spacing.
    Copies nothing.
    """
    every = np.s_[::2, ::2]
    return attrs.evolve(
        field,
        views=field.views[:, *every],
        disparity=None if field.disparity is None else field.disparity[:, *every],
        offsets=field.offsets[every] / np.float32(2),
        present=field.present[every],
        disparity_scale_px=field.disparity_scale_px * 2,
        disparity_min_px=field.disparity_min_px * 2,
        disparity_max_px=field.disparity_max_px * 2,
    )


def left_out(field: LightField, count: int) -> list[tuple[int, int]]:
    """Up to count (row, col) of present views that `thinned` omits, evenly distributed between
    those that it keeps; of two rows or columns, the first.
    """
    inside = [
        (r, c)
        for r in range((field.rows - 1) // 2 * 2 + 1)
        for c in range((field.cols - 1) // 2 * 2 + 1)
        if (r % 2 or c % 2) and field.present[r, c]
    ]
    # a stride coprime to the pattern of the grid selects views
    # between two and between four others equally often
    chosen = np.linspace(0, len(inside) - 1, min(count, len(inside))).round().astype(int)
    return [inside[int(k)] for k in np.unique(chosen)]


Draw = Callable[[Position], NDArray[np.float32]]  # the green plane at a viewpoint


def scores(field: LightField, count: int = 7) -> MethodScores:
    """The scores of the methods on about count held-out views, and their errors at each of SIZES.

    The error is in grey levels: of the picture against the held-out view, at the size on a screen,
    combined with the largest step of a moving viewpoint beyond the usual one, because a jump
    disturbs more than a soft picture. Where no view can be held out, the costliest method at full
    size counts as exact.
    """
    held_out = left_out(field, count)
    thin = thinned(field) if held_out else field
    own_px = field.width_px, field.height_px
    width, height = min(own_px, fit_area(own_px, SCREEN_PX)[2:])
    methods = [
        name for name in reversed(METHODS) if field.disparity is not None or name not in WARPS
    ]

    def drawn(method: str, size: float = 1.0) -> Draw:
        return _drawing(thin, method, (width, height), size)

    if held_out:
        green = field.views[0, :, :, min(1, field.channels - 1)]
        truth = {
            (row / 2, col / 2): reduced(np.asarray(green[row, col]), (width, height)).astype(
                np.float32
            )
            for row, col in held_out
        }
    else:
        # between the first two views; on them if there is one
        last_row, last_col = min(field.rows - 1, 1), min(field.cols - 1, 1)
        places = [(t * last_row, t * last_col) for t in BETWEEN]
        truth = dict(zip(places, map(drawn(methods[-1]), places), strict=True))
    squares = {
        (method, size): [
            float(np.mean((draw(place) - exact) ** 2)) for place, exact in truth.items()
        ]
        for method, size in itertools.product(methods, SIZES)
        for draw in [drawn(method, size)]
    }
    jumps = {method: _jump(drawn(method), _path(thin, next(iter(truth)))) for method in methods}
    return MethodScores(
        psnr_db={method: add(map(psnr_db, squares[method, 1.0])) / len(truth) for method in methods}
        if held_out
        else {},
        errors={
            method: [
                math.sqrt(add(squares[method, size]) / len(truth) + jumps[method] ** 2)
                for size in SIZES
            ]
            for method in methods
        },
    )


def _drawing(field: LightField, method: str, screen_px: tuple[int, int], size: float) -> Draw:
    """Draws views of field at `size` of screen_px (width, height), and scales them up to it."""
    width, height = (max(1, round(n * size)) for n in screen_px)
    views = SceneViews(field, (width, height))
    synthesiser = Synthesiser(views, method)
    channel = min(1, field.channels - 1)
    out = [np.empty((height, width), np.uint8)]

    def draw(at: Position) -> NDArray[np.float32]:
        (plane,) = synthesiser.render(at, 0, 0.0, [views.channel(channel)], out)
        whole = plane if size == 1 else cv2.resize(plane, screen_px, interpolation=cv2.INTER_CUBIC)
        return whole.astype(np.float32)

    return draw


def _path(field: LightField, place: Position) -> list[Position]:
    """Viewpoints from one stored view to the next, sideways if there are columns."""
    row, col = (
        min(math.floor(at), max(n - 2, 0))
        for at, n in zip(place, (field.rows, field.cols), strict=True)
    )
    down, right = (0, 1) if field.cols > 1 else (1, 0)
    return [
        (row + k / PATH_STEPS * down, col + k / PATH_STEPS * right) for k in range(PATH_STEPS + 1)
    ]


def _jump(draw: Draw, path: list[Position]) -> float:
    """The largest step between neighbouring pictures on a path beyond the median one, in grey
    levels.
    """
    steps = [
        math.sqrt(float(np.mean((after - before) ** 2)))
        for before, after in itertools.pairwise(map(draw, path))
    ]
    return max(steps) - float(np.median(steps))


# CPU time of drawing by each method, measured on a scene's own views.

# (width, height) of the measured pictures, at most: a few ms each; time grows with the pixels
MEASURED_PX = (480, 480)
# columns of both eyes in views; the first two pictures build what all need
COLUMNS = ((0.1, 0.9), (0.4, 0.6), (0.2, 0.7), (0.3, 0.8), (0.1, 0.6))
BUILT = 2


def measure_costs(
    field: LightField, render: Render, gpu: Painters | None = None
) -> Mapping[str, float]:
    """CPU time of the calling thread for each drawn pixel by method, ns: the least of a few
    pictures between the middle views. What a GPU draws takes it little time.
    """
    own_px = field.width_px, field.height_px
    size_px = min(own_px, fit_area(own_px, MEASURED_PX)[2:])
    row, col = (field.rows - 1) / 2, float(max(field.cols // 2 - 1, 0))
    costs = {}
    for method in METHODS:
        if method in WARPS and field.disparity is None:
            continue
        compositor = Compositor(
            field, attrs.evolve(render, method=cast(Method, method)), size_px=size_px, gpu=gpu
        )
        spent_ns = []
        for left, right in COLUMNS:
            start_ns = time.thread_time_ns()
            compositor.compose((row, col + left), (row, col + right))
            spent_ns.append(time.thread_time_ns() - start_ns)
        costs[method] = min(spent_ns[BUILT:]) / math.prod(size_px)
    return costs


@attrs.frozen
class LeftOut:
    """Work that is skipped, or data that is not read or stored."""

    what: str
    why: str
    saves: str  # an amount with its unit


@attrs.frozen(kw_only=True)
class Plan:
    """What rendering a scene needs."""

    needs_tracking: bool  # the picture depends on the eyes; otherwise capture and track do not run
    needs_rows: bool  # the picture depends on the height of the eyes
    needs_warp: bool  # views are warped, so disparity is read
    needs_depth: bool  # the picture depends on the viewer's distance
    # stored channels read for the left eye and for the right eye:
    # 0 red, 1 green, 2 blue; 0 of a grey scene
    planes: tuple[tuple[int, ...], tuple[int, ...]]
    method: str  # never "auto"
    left_out: tuple[LeftOut, ...] = ()


def make_plan(field: LightField, config: Config) -> Plan:
    """The plan for a scene under a configuration."""
    render = config.render
    tracking = field.needs_eyes
    method = method_for(field, render.method)
    render = settings_for_scene(field, method, render)
    posed = CameraPose.of(config, config.camera.frame_px) is not None
    left, right = (
        sorted({k for plane in eye for k in stored_channels(field, plane)})
        for eye in planes_of_eyes(render)
    )
    plan = Plan(
        needs_tracking=tracking,
        needs_rows=tracking and field.rows > 1,
        needs_warp=tracking and method in WARPS,
        needs_depth=tracking and (isinstance(render.alpha_px, str) or posed),
        planes=(tuple(left), tuple(right)),
        method=method,
    )
    return attrs.evolve(plan, left_out=tuple(_left_out(plan, field, config)))


def planned_levels(
    field: LightField, config: Config, method: str
) -> tuple[tuple[int, int], tuple[DrawingLevel, ...]]:
    """(width, height) of the picture on a screen of SCREEN_PX, and the levels of quality from
    method down, measured on this machine; none if the picture does not depend on the eyes.
    """
    own_px = field.width_px, field.height_px
    picture_px = min(own_px, fit_area(own_px, SCREEN_PX)[2:])
    if not field.needs_eyes or not field.folder:  # only a pack has views and errors
        return picture_px, ()
    return picture_px, drawing_levels(
        method, field.manifest.errors, measure_costs(field, config.render)
    )


def _left_out(plan: Plan, field: LightField, config: Config) -> Iterator[LeftOut]:
    plane_bytes = field.height_px * field.width_px
    render = settings_for_scene(field, plan.method, config.render)
    if not plan.needs_tracking:
        yield LeftOut(
            "capture and tracking",
            "a single view does not depend on the eyes"
            if field.rows * field.cols == 1
            else "all views are equal",
            f"2 processes, {_size(math.prod(config.camera.frame_px) * 3)} per frame",
        )
    # nearest takes one view, whatever the row
    elif not plan.needs_rows and plan.method != "nearest":
        saves = (
            f"{_size(8 * plane_bytes)} of maps per view"
            if plan.needs_warp
            else "2 of 4 views blended per eye"
        )
        yield LeftOut("row coordinate", "the scene has one row of views", saves)
    if plan.needs_tracking and not plan.needs_warp:
        yield LeftOut(
            "warping",
            _why_no_warp(plan, field, render),
            f"{sum(map(len, planes_of_eyes(render)))} warped planes per picture",
        )
        if field.disparity is not None:
            yield LeftOut(
                "disparity maps", "no view is warped", f"{_size(field.disparity.nbytes)} not read"
            )
    unread = 2 * field.channels - len(plan.planes[0]) - len(plan.planes[1])
    if field.channels == 1:
        saved = _size(2 * field.frames * field.rows * field.cols * plane_bytes)
        yield LeftOut(
            "two of three colour planes", "the scene is grey", f"{saved} of pack and memory"
        )
    elif unread:
        left, right = (
            ", ".join(("red", "green", "blue")[k] for k in eye) or "nothing" for eye in plan.planes
        )
        why = f"{render.anaglyph} uses {left} of the left view and {right} of the right view"
        yield LeftOut(
            f"{unread} of 6 planes per picture", why, f"{_size(unread * plane_bytes)} per picture"
        )
    if plan.needs_tracking and not plan.needs_depth:
        yield LeftOut(
            "the viewer's distance",
            "render.alpha_px is given",
            f"alpha stays {render.alpha_px:g} px per view",
        )


def _why_no_warp(plan: Plan, field: LightField, render: Render) -> str:
    if render.method == plan.method:
        return f"render.method is {plan.method}"
    if field.disparity is None:
        return "the scene has no disparity"
    if (confirmed := field.manifest.disparity.confirmed) < CONFIRMED:
        return (
            f"only {confirmed:.0%} of the disparity of the two pictures is confirmed by both: they"
            " are shown as stored, shifted"
        )
    scores = ", ".join(f"{name} {value:.1f} dB" for name, value in field.manifest.scores.items())
    return (
        f"{plan.method} predicts held-out views as well ({scores})"
        if scores
        else f"the scene's own method is {plan.method}"
    )


def _size(count: float) -> str:
    return f"{count / 1e6:.3g} MB"
