"""Levels of quality: the work that a session leaves out, step by step, when the machine is too
slow.

Level 0 is the configuration unchanged. Each further level reduces one thing: first the method of
making views, then the rate of the display (every second refresh), then tracking (every second
frame; the filter predicts across the gap). The current level is part of the session's options. The
configuration itself never changes.
"""

import math
from collections.abc import Mapping
from typing import Any

import attrs

from lfpipe.config import Config, QualityLevel, SessionOptions

METHODS = ("warp2", "warp", "blend", "nearest")  # in order of falling cost
WARPS = ("warp", "warp2")
# between the farthest and the nearest:
# beyond, with the screen between them, a cross-fade shows everything twice
FADED_PX = 8.0
MIN_HZ = 25.0  # at lower rates the picture flickers whenever the head moves


def method_in_use(
    setting: str, scene_method: str, has_disparity: bool, scores: Mapping[str, float]
) -> str:
    """The method used for render.method = setting in a scene: `auto` is the scene's own; without
    disparity, nothing is warped.

    scores: PSNR in dB of each method on held-out views. For noisy views with little depth, a
    cross-fade scores best, because it averages the noise. A warp that scores worse is never used,
    even on request.
    """
    method = scene_method if setting == "auto" else setting
    if method not in WARPS:
        return method
    if not has_disparity:
        return "nearest"
    worse = scene_method not in WARPS and scores.get(scene_method, -math.inf) > scores.get(
        method, math.inf
    )
    return scene_method if worse else method


def may_fade(low_px: float, high_px: float) -> bool:
    """Whether neighbouring views, of disparities low_px to high_px, are alike enough for a
    cross-fade.
    """
    return high_px - low_px <= FADED_PX


def ladder(config: Config, options: SessionOptions) -> tuple[QualityLevel, ...]:
    """The levels of a session, from full quality down; only full quality if nothing is shown.

    With render.clock = "camera" there is one picture per frame, and only the method can be lowered.
    """
    scene = options.scene
    if scene is None or (scene.frames == 1 and not scene.needs_eyes):  # drawn once
        return (QualityLevel(method=config.render.method, rate_hz=config.render.nominal_hz),)
    method = method_in_use(config.render.method, scene.method, scene.has_disparity, scene.scores)
    fades = may_fade(scene.disparity_min_px, scene.disparity_max_px)
    cheaper = [name for name in METHODS[METHODS.index(method) + 1 :] if fades or name != "blend"]
    steps: list[tuple[str, str, Any]] = [("pictures", "method", name) for name in cheaper]
    if config.render.clock == "display" or not options.viewer.tracked:
        rate_hz = config.render.nominal_hz / 2
        while rate_hz >= MIN_HZ:
            steps.append(("pictures", "rate_hz", rate_hz))
            rate_hz /= 2
        if options.viewer.tracked:
            steps.append(("eyes", "every", 2))
    levels = [QualityLevel(method=method, rate_hz=config.render.nominal_hz)]
    for work, what, value in steps:
        levels.append(attrs.evolve(levels[-1], number=len(levels), work=work, **{what: value}))
    return tuple(attrs.evolve(level, words=_words(level, levels[0])) for level in levels)


def _words(level: QualityLevel, full: QualityLevel) -> str:
    changes = [
        f"{level.method} views" if level.method != full.method else "",
        f"{level.rate_hz:g} pictures/s" if level.rate_hz != full.rate_hz else "",
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
