"""What a scene and a config need, and what can therefore be left out. Every stage obeys the plan."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable
from typing import Any

import attrs
import cv2
import numpy as np

from lfpipe.config import Config
from lfpipe.config.quality import drawn_with
from lfpipe.scene.lightfield import LightField

FLAT_PX = 0.5  # px per view: less is not worth a warp
RED, GREEN, BLUE = 0, 1, 2
_ALL = frozenset((RED, GREEN, BLUE))
# Stored planes that each eye's share of the picture is made of (left, right); what is not named here reads all of both.
_READ: dict[str, tuple[frozenset[int], frozenset[int]]] = {
    "colour": (frozenset((RED,)), frozenset((GREEN, BLUE))),
    "half-colour": (_ALL, frozenset((GREEN, BLUE))),
    "wimmer": (frozenset((GREEN, BLUE)), frozenset((GREEN, BLUE))),
    "mono": (_ALL, frozenset()),
}


@attrs.frozen
class LeftOut:
    """One thing that is not done or not kept. saves: how much, with its unit; "measured" where it was timed here."""

    what: str
    why: str
    saves: str


@attrs.frozen
class Plan:
    """needs_tracking: eyes move the picture (else no capture and no track process). needs_rows: the row coordinate counts.
    needs_warp: views are warped by disparity, which is then read. needs_depth: the viewer's distance is worked out.
    planes: stored planes (0 red, 1 green, 2 blue; 0 of a grey scene) of the left eye's views and of the right eye's.
    reach: (first row, last row, first column, last column) of views that the viewer can come to. method: how views between
    the stored ones are made, never "auto"."""

    needs_tracking: bool
    needs_rows: bool
    needs_warp: bool
    needs_depth: bool
    planes: tuple[tuple[int, ...], tuple[int, ...]]
    reach: tuple[int, int, int, int]
    method: str
    left_out: tuple[LeftOut, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain values, as JSON carries them."""
        return attrs.asdict(self)


def _size(count: float) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= size:
            return f"{count / size:.1f} {unit}"
    return f"{count:.0f} B"


def _median_ms(work: Callable[[], object]) -> float:
    """Median time of a few runs after one to warm up."""
    work()
    times = []
    for _ in range(7):
        started = time.perf_counter_ns()
        work()
        times.append((time.perf_counter_ns() - started) / 1e6)
    return statistics.median(times)


def _warp_ms(field: LightField, planes: int) -> float:
    """Time to warp that many planes of this scene's size once, maps of both axes included."""
    size = field.height_px, field.width_px
    plane = np.zeros(size, np.uint8)
    yy, xx = np.mgrid[: size[0], : size[1]].astype(np.float32)
    shift = np.full(size, 0.3, np.float32)

    def once() -> None:
        mx, my = cv2.scaleAdd(shift, 0.5, xx), cv2.scaleAdd(shift, 0.5, yy)
        for _ in range(planes):
            cv2.remap(plane, mx, my, cv2.INTER_LINEAR)

    return _median_ms(once)


def _row_ms(field: LightField) -> float:
    """Time to make the map of one axis of this scene's size."""
    yy = np.zeros((field.height_px, field.width_px), np.float32)
    return _median_ms(lambda: cv2.scaleAdd(yy, 0.5, yy))


def _reach(field: LightField, config: Config) -> tuple[int, int, int, int]:
    """Views that eyes within the camera's picture, re-centred anywhere in it, can come to; all where alpha is found out."""
    rows, cols = field.rows, field.cols
    if not isinstance(config.render.alpha_px, int | float):
        return 0, rows - 1, 0, cols - 1
    width_px, height_px = config.camera.frame_px
    spans = height_px / config.render.alpha_px, width_px / config.render.alpha_px
    ends: list[int] = []
    for count, span in zip((rows, cols), spans, strict=True):
        middle = (count - 1) / 2
        ends += [max(0, math.floor(middle - span) - 1), min(count - 1, math.ceil(middle + span) + 1)]
    return ends[0], ends[1], ends[2], ends[3]


def make_plan(field: LightField, config: Config, measure: bool = False) -> Plan:
    """The plan for a scene under a config.

    measure: time on this machine what is saved (a few ms); otherwise only bytes are counted.
    """
    views = field.rows * field.cols
    left: list[LeftOut] = []
    plane_bytes = field.height_px * field.width_px
    tracking = views > 1
    needs_rows = field.rows > 1

    extent = max(abs(field.disparity_min_px), abs(field.disparity_max_px))
    asked = config.render.method
    scores = {k: v for k, v in field.manifest.get("scores", {}).items() if isinstance(v, int | float)}
    method = drawn_with(asked, field.method, True, scores)
    why = ""
    if views == 1:
        method, why = "nearest", "there is one view"
    elif method in ("warp", "warp2") and field.disparity is None:
        method, why = "nearest", "the scene has no disparity"
    elif asked == "auto" and method in ("warp", "warp2") and extent < FLAT_PX:
        method, why = "nearest", f"the scene is flat: at most {extent:.2f} px per view"
    elif method not in ("warp", "warp2"):
        told = ", ".join(f"{name} {value:.1f} dB" for name, value in scores.items())
        why = "render.method" if asked == method else f"left-out views are met as well without ({told})" if told else "flat scene"
    needs_warp = method in ("warp", "warp2")

    planes: tuple[tuple[int, ...], tuple[int, ...]] = ((0,), (0,))
    if field.channels == 3:
        sets = _READ.get(config.render.anaglyph, (_ALL, _ALL))
        planes = tuple(sorted(sets[0])), tuple(sorted(sets[1]))
    elif config.render.anaglyph == "mono":
        planes = ((0,), ())

    if not tracking:
        frame = _size(config.camera.width_px * config.camera.height_px * 3)
        left.append(LeftOut("capture and tracking", "one view: nothing moves with the eyes", f"two processes, {frame} a frame"))
    if tracking and not needs_rows:
        saves = f"{_row_ms(field):.2f} ms a picture and eye (measured)" if measure else f"{_size(8 * plane_bytes)} of maps"
        left.append(LeftOut("row coordinate", "one row of views", saves))
    if tracking and not needs_warp:
        count = max(1, len(planes[0]) + len(planes[1]))
        saves = f"{_warp_ms(field, count):.2f} ms a picture (measured)" if measure else f"{count} warped planes a picture"
        left.append(LeftOut("warping", why, saves))
        if field.disparity is not None:
            left.append(LeftOut("disparity maps", "nothing is warped", f"{_size(field.disparity.nbytes)} never read"))
    if field.channels == 1:
        saved = 2 * field.frames * views * plane_bytes
        left.append(LeftOut("two of three colour planes", "a grey scene", f"{_size(saved)} of pack and memory"))
    unread = 2 * field.channels - len(planes[0]) - len(planes[1])
    if field.channels == 3 and unread:
        names = [", ".join(("red", "green", "blue")[k] for k in eye) or "nothing" for eye in planes]
        what = f"{unread} of 6 planes a picture"
        why = f"{config.render.anaglyph} reads {names[0]} of the left view and {names[1]} of the right"
        left.append(LeftOut(what, why, f"{_size(unread * plane_bytes)} a picture"))
    reach = _reach(field, config)
    kept = (reach[1] - reach[0] + 1) * (reach[3] - reach[2] + 1)
    if kept < views:
        why, unseen = "out of reach of eyes in the camera's picture", (views - kept) * field.frames * field.channels * plane_bytes
        left.append(LeftOut(f"{views - kept} of {views} views", why, f"{_size(unseen)} never read"))
    needs_depth = tracking and config.screen.distance_mm == "auto" and isinstance(config.render.alpha_px, str)
    if tracking and not needs_depth:
        reason = "screen.distance_mm is given" if config.screen.distance_mm != "auto" else "render.alpha_px is given"
        left.append(LeftOut("the viewer's distance", reason, "one estimate a camera frame"))
    return Plan(tracking, needs_rows, needs_warp, needs_depth, planes, reach, method, tuple(left))
