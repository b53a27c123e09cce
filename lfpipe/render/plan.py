"""The work that rendering a scene under a configuration needs, and the work it leaves out.

Only a report: stages do not read it. Each entry comes from the function that the stage itself uses to decide.
"""

from collections.abc import Iterator

import attrs

from lfpipe.config import Config, Render
from lfpipe.config.camera_pose import EYES_MM, CameraPose
from lfpipe.config.quality import WARPS
from lfpipe.config.session_options import needs_tracking
from lfpipe.render.compositor import method_for, mixed_as, planes_of_eyes, stored_channels
from lfpipe.render.geometry import alpha_is_automatic
from lfpipe.render.viewpoint import ViewSolver, ViewWeight, view_weights
from lfpipe.scene.lightfield import LightField


@attrs.frozen
class LeftOut:
    """Work not done, or data not read or stored. saves: an amount with its unit."""

    what: str
    why: str
    saves: str


@attrs.frozen
class Plan:
    """needs_tracking: the picture depends on the eyes; otherwise capture and track do not run. needs_rows: it depends on the
    eyes' height. needs_warp: views are warped, so disparity is read. needs_depth: it depends on the viewer's distance. planes:
    stored channels read for the left eye and for the right eye (0 red, 1 green, 2 blue; 0 of a grey scene). reach: (first row,
    last row, first column, last column) of the views that can appear while the eyes are within a camera picture of the configured
    size. method: never "auto".
    """

    needs_tracking: bool
    needs_rows: bool
    needs_warp: bool
    needs_depth: bool
    planes: tuple[tuple[int, ...], tuple[int, ...]]
    reach: tuple[int, int, int, int]
    method: str
    left_out: tuple[LeftOut, ...] = ()


def make_plan(field: LightField, config: Config) -> Plan:
    """The plan for a scene under a configuration."""
    render = config.render
    tracking = needs_tracking(field.rows, field.cols)
    method = method_for(field, render.method)
    render = mixed_as(field, method, render)
    posed = CameraPose.of(config, config.camera.frame_px, EYES_MM) is not None
    left, right = (sorted({k for plane in eye for k in stored_channels(field, plane)}) for eye in planes_of_eyes(render))
    plan = Plan(
        needs_tracking=tracking,
        needs_rows=tracking and field.rows > 1,
        needs_warp=tracking and method in WARPS,
        needs_depth=tracking and (alpha_is_automatic(config) or posed),
        planes=(tuple(left), tuple(right)),
        reach=_reach(field, config, posed),
        method=method,
    )
    return attrs.evolve(plan, left_out=tuple(_left_out(plan, field, config)))


def _reach(field: LightField, config: Config, posed: bool) -> tuple[int, int, int, int]:
    """All views if alpha or the camera's pose depends on the viewer's distance; otherwise those between the extremes: eyes in one
    corner of the camera picture, neutral position in the opposite one. Blending uses a superset of the views that the other
    methods use, so the reach also holds at lowered quality.
    """
    if not isinstance(config.render.alpha_px, int | float) or posed:
        return 0, field.rows - 1, 0, field.cols - 1
    near, far = (0.0, 0.0), (float(config.camera.width_px), float(config.camera.height_px))
    views: list[ViewWeight] = []
    for centre, eye in ((near, far), (far, near)):
        solver = ViewSolver(field.rows, field.cols, config.render, config.render.alpha_px, centre)
        views += view_weights("blend", solver.views((*eye, *eye))[0], field.rows, field.cols)
    rows, cols = [view.row for view in views], [view.col for view in views]
    return min(rows), max(rows), min(cols), max(cols)


def _left_out(plan: Plan, field: LightField, config: Config) -> Iterator[LeftOut]:
    views, plane_bytes = field.rows * field.cols, field.height_px * field.width_px
    render = mixed_as(field, plan.method, config.render)
    if not plan.needs_tracking:
        frame = _size(config.camera.width_px * config.camera.height_px * 3)
        yield LeftOut("capture and tracking", "a single view does not depend on the eyes", f"2 processes, {frame} per frame")
    elif not plan.needs_rows and plan.method != "nearest":  # nearest takes one view, whatever the row
        saves = f"{_size(8 * plane_bytes)} of maps per view" if plan.needs_warp else "2 of 4 views blended per eye"
        yield LeftOut("row coordinate", "the scene has one row of views", saves)
    if plan.needs_tracking and not plan.needs_warp:
        count = sum(map(len, planes_of_eyes(render)))
        yield LeftOut("warping", _why_no_warp(plan, field, render), f"{count} warped planes per picture")
        if field.disparity is not None:
            yield LeftOut("disparity maps", "no view is warped", f"{_size(field.disparity.nbytes)} not read")
    unread = 2 * field.channels - len(plan.planes[0]) - len(plan.planes[1])
    if field.channels == 1:
        saved = _size(2 * field.frames * views * plane_bytes)
        yield LeftOut("two of three colour planes", "the scene is grey", f"{saved} of pack and memory")
    elif unread:
        left, right = (", ".join(("red", "green", "blue")[k] for k in eye) or "nothing" for eye in plan.planes)
        why = f"{render.anaglyph} uses {left} of the left view and {right} of the right view"
        yield LeftOut(f"{unread} of 6 planes per picture", why, f"{_size(unread * plane_bytes)} per picture")
    first_row, last_row, first_col, last_col = plan.reach
    unseen = views - (last_row - first_row + 1) * (last_col - first_col + 1)
    if unseen:
        saves = f"{_size(unseen * field.frames * field.channels * plane_bytes)} not read"
        yield LeftOut(f"{unseen} of {views} views", "eyes within the camera picture cannot reach them", saves)
    if plan.needs_tracking and not plan.needs_depth:
        yield LeftOut("the viewer's distance", "render.alpha_px is given", f"alpha stays {render.alpha_px:g} px per view")


def _why_no_warp(plan: Plan, field: LightField, render: Render) -> str:
    if render.method == plan.method:
        return f"render.method is {plan.method}"
    if field.disparity is None:
        return "the scene has no disparity"
    scores = ", ".join(f"{name} {value:.1f} dB" for name, value in field.manifest.get("scores", {}).items())
    return f"{plan.method} predicts held-out views as well ({scores})" if scores else f"the scene's own method is {plan.method}"


def _size(count: float) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= size:
            return f"{count / size:.1f} {unit}"
    return f"{count:.0f} B"
