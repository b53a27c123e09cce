"""The work that rendering a scene under a configuration needs, and the work it skips.

Only a report: stages do not read it. Each entry comes from the function that the stage itself uses
to decide.
"""

import math
from collections.abc import Iterator

import attrs

from lfpipe.config import Config, Render
from lfpipe.config.camera_pose import CameraPose
from lfpipe.config.quality import WARPS, DrawingLevel, drawing_levels
from lfpipe.files.codecs import fit_area
from lfpipe.render.synthesis.compositor import (
    method_for,
    planes_of_eyes,
    settings_for_scene,
)
from lfpipe.render.synthesis.scene_views import stored_channels
from lfpipe.render.synthesis.scoring import SCREEN_PX, measure_costs
from lfpipe.render.viewer.geometry import alpha_is_automatic
from lfpipe.scene.analysis import CONFIRMED
from lfpipe.scene.lightfield import LightField


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
        needs_depth=tracking and (alpha_is_automatic(config) or posed),
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
