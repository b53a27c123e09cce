"""Levels of quality: the work that a session leaves out, step by step, when the machine is too
slow.

Level 0 is the configuration unchanged. Each further level reduces one thing: first the method and
the size of pictures, then the rate of the display (every second refresh), then tracking (every
second frame; the filter predicts across the gap). Methods and sizes are chosen by measurement: the
packer measures their errors in the scene, the render stage their time on this machine, and the
levels are the lower hull of error against time. The current level is part of the session's options.
The configuration itself never changes.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import attrs

from lfpipe.config import Config, QualityLevel, SessionOptions

METHODS = ("warp2", "warp", "blend", "nearest")  # in order of falling cost
WARPS = ("warp", "warp2")
SIZES = (1.0, 0.7, 0.5)  # widths of pictures, as shares of that on the screen
SMALLEST_PX = 300  # of a side of pictures of a lower size: fewer save nothing
SAVING = 0.8  # cost of a level by that of the one before, at most: less relief is not felt
FITS = 0.7  # share of the display's period that a picture may take to begin with
THREAD_PX = (
    1 << 20
)  # of a picture, for each further thread: drawing as many takes most of a refresh
MIN_HZ = 25.0  # at lower rates the picture flickers whenever the head moves


def method_in_use(setting: str, scene_method: str, has_disparity: bool) -> str:
    """The method used for render.method = setting in a scene: `auto` is the scene's own; without
    disparity, nothing is warped.
    """
    method = scene_method if setting == "auto" else setting
    return "nearest" if method in WARPS and not has_disparity else method


def thread_count(picture_px: float, cores: int) -> int:
    """The threads that draw a picture of this many pixels."""
    return max(1, min(cores, 1 + int(picture_px) // THREAD_PX))


@attrs.frozen
class DrawingLevel:
    """A method and a size of pictures."""

    method: str
    size: float
    error: float
    """In grey levels, see `scene.lightfield.MethodScores`."""
    ns_per_px: float
    """CPU time for each pixel of the picture on the screen."""

    def beats(self, other: "DrawingLevel") -> bool:
        """Whether it is cheaper and no worse than another, or better and no costlier."""
        mine, its = (self.ns_per_px, self.error), (other.ns_per_px, other.error)
        return mine[0] <= its[0] and mine[1] <= its[1] and mine != its


def drawing_levels(
    method: str, errors: Mapping[str, Sequence[float]], costs: Mapping[str, float]
) -> tuple[DrawingLevel, ...]:
    """The levels from a method at full size down to the cheapest drawing: the lower hull of error
    against cost.

    errors: by method, in grey levels at each of SIZES; without the method's, its sizes alone are
    levels. costs: CPU time for each drawn pixel by method, ns.
    """
    by_method = errors if method in errors else {method: [1 - size for size in SIZES]}
    points = [
        DrawingLevel(name, size, error, costs[name] * size**2)
        for name, sized in by_method.items()
        for size, error in zip(SIZES, sized, strict=True)
        if name in costs
    ]
    levels = [point for point in points if (point.method, point.size) == (method, 1.0)]
    best = [point for point in points if not any(other.beats(point) for other in points)]
    while levels:
        last = levels[-1]
        cheaper = [point for point in best if point.ns_per_px <= SAVING * last.ns_per_px]
        if not cheaper:
            break
        levels.append(
            min(
                cheaper,
                key=lambda point: (point.error - last.error) / (last.ns_per_px - point.ns_per_px),
            )
        )
    return tuple(levels)


def quality_levels(config: Config, options: SessionOptions) -> tuple[QualityLevel, ...]:
    """The levels of a session, from full quality down; only full quality if nothing is shown.

    With render.clock = "camera" there is one picture per frame: only its drawing can be reduced.
    """
    scene = options.scene
    if scene is None or (scene.frames == 1 and not scene.needs_eyes):  # drawn once
        return (QualityLevel(method=config.render.method, rate_hz=config.render.nominal_hz),)
    method = method_in_use(config.render.method, scene.method, scene.has_disparity)
    costs = options.costs.ns_per_px if options.costs else {}
    steps: list[tuple[str, dict[str, Any]]] = (
        [("pictures", {"disparity": 1}), ("pictures", {"disparity": 2})] if options.live else []
    )
    least = min(1.0, SMALLEST_PX / min(scene.width_px, scene.height_px))
    steps += [
        ("pictures", {"method": level.method, "size": max(level.size, least)})
        for level in drawing_levels(method, scene.errors, costs)[1:]
    ]
    if config.render.clock == "display" or not options.viewer.tracked:
        rate_hz = config.render.nominal_hz / 2
        while rate_hz >= MIN_HZ:
            steps.append(("pictures", {"rate_hz": rate_hz}))
            rate_hz /= 2
        if options.viewer.tracked:
            steps.append(("eyes", {"every": 2}))
    levels = [QualityLevel(method=method, rate_hz=config.render.nominal_hz)]
    for work, changes in steps:
        levels.append(attrs.evolve(levels[-1], number=len(levels), work=work, **changes))
    return tuple(attrs.evolve(level, words=_words(level, levels[0])) for level in levels)


def first_level(config: Config, options: SessionOptions, levels: Sequence[QualityLevel]) -> int:
    """The number of the best level whose pictures fit the display's period."""
    costs = options.costs
    if costs is None:
        return 0
    on_camera = config.render.clock == "camera" and options.viewer.tracked
    for level in levels:
        picture_px = costs.picture_px * level.size**2
        cost_ns = costs.ns_per_px.get(level.method, 0.0) * picture_px
        rate_hz = options.viewer.rate_hz if on_camera else level.rate_hz
        if cost_ns * rate_hz <= FITS * 1e9 * thread_count(picture_px, costs.cores):
            return level.number
    return levels[-1].number


def _words(level: QualityLevel, full: QualityLevel) -> str:
    changes = [
        f"{level.method} views" if level.method != full.method else "",
        f"{level.size:.0%} of the width" if level.size != full.size else "",
        f"{level.rate_hz:g} pictures/s" if level.rate_hz != full.rate_hz else "",
        ("", "disparity of every 2nd frame", "coarse disparity of every 2nd frame")[
            level.disparity
        ],
        f"every {level.every}nd frame tracked" if level.every != full.every else "",
    ]
    return ", ".join(filter(None, changes)) or "full"


def lowered(config: Config, options: SessionOptions) -> Config:
    """The configuration that render uses at the current level."""
    level = options.level
    if level is None:
        return config
    # at full rate "auto" stays: the screen's own may be above the nominal one
    rate_hz = config.render.rate_hz if level.rate_hz == config.render.nominal_hz else level.rate_hz
    lower: dict[str, Any] = {"method": level.method, "rate_hz": rate_hz}
    return attrs.evolve(config, render=attrs.evolve(config.render, **lower))


def level_number(options: SessionOptions) -> int:
    """The current level, 0 for full quality."""
    return options.level.number if options.level else 0


def tracked_every(options: SessionOptions) -> int:
    """n, if one frame in n is tracked."""
    return options.level.every if options.level else 1
