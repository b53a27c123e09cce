"""Levels of quality: which drawings are worth their time, and what a session lowers."""

from typing import Any

import attrs
import pytest

from lfpipe.config import Config, DrawingCosts, Render, SessionOptions
from lfpipe.config.quality import (
    METHODS,
    SIZES,
    drawing_levels,
    first_level,
    method_in_use,
    quality_levels,
)
from lfpipe.config.session_options import NoViewer
from tests.supervisor.states import SCENE

# of a scene of 512x512 px, and of the machine that the figures are from
ERRORS = {
    "warp2": (0.9, 2.0, 2.9),
    "warp": (1.2, 2.1, 2.7),
    "blend": (4.1, 4.2, 4.3),
    "nearest": (12.0, 12.1, 12.2),
}
COSTS = {"warp2": 10.0, "warp": 7.0, "blend": 2.0, "nearest": 1.5}


def options(
    method: str = "warp2", costs: dict[str, float] = COSTS, side_px: int = 512, **more: Any
) -> SessionOptions:
    """Of a scene with errors, in a window of side_px squared."""
    scene = attrs.evolve(
        SCENE, rows=5, cols=5, method=method, scores={}, errors=ERRORS, **more.pop("scene", {})
    )
    known = DrawingCosts(ns_per_px=costs, picture_px=side_px**2, cores=2)
    return SessionOptions(scene=scene, costs=known, **more)


def test_drawing_levels_are_the_hull_of_error_against_time() -> None:
    drawn = [(level.method, level.size) for level in drawing_levels("warp2", ERRORS, COSTS)]
    assert drawn == [
        ("warp2", 1.0),
        ("warp", 1.0),
        ("warp", 0.7),
        ("warp", 0.5),
        ("blend", 0.5),
        ("nearest", 0.5),
    ]
    assert {level.method for level in drawing_levels("blend", ERRORS, COSTS)} == {
        "blend",
        "nearest",
    }
    assert drawing_levels("warp2", ERRORS, {}) == ()
    alone = [(level.method, level.size) for level in drawing_levels("nearest", {}, COSTS)]
    assert alone == [("nearest", 1.0), ("nearest", 0.7), ("nearest", 0.5)]


@pytest.mark.parametrize(
    ("asked", "scene", "wanted"),
    [
        ("auto", "warp2", ["warp2", "warp", "blend", "nearest"]),
        ("blend", "warp2", ["blend", "nearest"]),
        ("nearest", "warp2", ["nearest", "blend"]),  # which is better at half the size
    ],
)
def test_quality_levels_begin_at_what_is_asked_for(
    asked: str, scene: str, wanted: list[str]
) -> None:
    config = Config(render=Render(method=asked))  # type: ignore[arg-type]
    levels = quality_levels(config, options(scene))
    assert [level.number for level in levels] == list(range(len(levels)))
    assert list(dict.fromkeys(level.method for level in levels)) == wanted
    assert [(level.rate_hz, level.every) for level in levels[-2:]] == [(30.0, 1), (30.0, 2)]
    assert len({level.words for level in levels}) == len(levels) and levels[0].words == "full"
    assert wanted[0] == method_in_use(asked, scene, True) and wanted[0] in METHODS


def test_quality_levels_hold_only_what_helps() -> None:
    paper = Config(render=Render(clock="camera", method="nearest"))
    sizes = {level.size for level in quality_levels(paper, options())}
    assert sizes == set(SIZES), "one picture per frame: only its drawing is reduced"
    unmeasured = attrs.evolve(options(), costs=None)
    assert {(level.method, level.size) for level in quality_levels(Config(), unmeasured)} == {
        ("warp2", 1.0)
    }
    assert len(quality_levels(Config(), SessionOptions(show=False, viewer=NoViewer()))) == 1
    assert {level.every for level in quality_levels(Config(), options(viewer=NoViewer()))} == {1}, (
        "nothing is tracked"
    )
    fast = Config(render=Render(method="nearest", rate_hz=120))
    rates = [level.rate_hz for level in quality_levels(fast, options())]
    assert list(dict.fromkeys(rates)) == [120, 60, 30]


@pytest.mark.parametrize(
    ("side_px", "rate_hz", "first"),
    [
        (512, 60, ("warp2", 1.0)),  # 2.6 of 16.7 ms
        (1080, 60, ("warp2", 1.0)),  # 11.7 ms, by two threads
        (1600, 60, ("warp", 1.0)),  # 12.8 by two threads, and 9.0
        (1080, 144, ("warp", 1.0)),
        (9000, 60, ("nearest", 0.5)),  # none fits: the cheapest drawing of a lower rate
    ],
)
def test_first_level_fits_the_refresh(side_px: int, rate_hz: int, first: tuple[str, float]) -> None:
    config = Config(render=Render(rate_hz=rate_hz))
    session = options(side_px=side_px)
    levels = quality_levels(config, session)
    level = levels[first_level(config, session, levels)]
    assert (level.method, level.size) == first
