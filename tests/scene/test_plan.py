"""The plan leaves out what a scene and a config do not need, and says what that saves."""

from __future__ import annotations

import json

import attrs
import numpy as np
import pytest

from lfpipe.config import Config, updated
from lfpipe.render.anaglyph import MATRICES
from lfpipe.scene.lightfield import Geometry, LightField
from lfpipe.scene.plan import Plan, make_plan


def field(rows: int, cols: int, channels: int = 3, extent_px: float = 3.0, method: str = "warp") -> LightField:
    views = np.zeros((1, rows, cols, channels, 48, 64), np.uint8)
    disparity = np.zeros((1, rows, cols, 24, 32), np.int8) if rows * cols > 1 else None
    return LightField(
        views, disparity, 1 / 16, -extent_px, extent_px / 2, "estimated", np.zeros((rows, cols, 2), np.float32),
        np.ones((rows, cols), bool), Geometry(), 0.0, "test", method, {"scores": {"nearest": 30.0, "blend": 41.0}},
    )  # fmt: skip


def what(plan: Plan) -> list[str]:
    return [item.what for item in plan.left_out]


def with_keys(**keys: object) -> Config:
    return updated(Config(), {key.replace("__", "."): value for key, value in keys.items()})


def test_one_view_needs_no_eyes() -> None:
    plan = make_plan(field(1, 1), Config())
    assert (plan.needs_tracking, plan.needs_warp, plan.needs_depth, plan.method) == (False, False, False, "nearest")
    assert what(plan) == ["capture and tracking"]


def test_one_row_needs_no_row_coordinate() -> None:
    plan = make_plan(field(1, 9), Config())
    assert (plan.needs_tracking, plan.needs_rows, plan.needs_warp) == (True, False, True)
    assert "row coordinate" in what(plan)


def test_a_flat_scene_is_not_warped() -> None:
    plan = make_plan(field(5, 5, extent_px=0.4), Config())
    assert (plan.method, plan.needs_warp) == ("nearest", False)
    assert {"warping", "disparity maps"} <= set(what(plan))
    assert make_plan(field(5, 5, extent_px=0.4), with_keys(render__method="warp")).needs_warp


def test_the_score_of_the_scene_decides_auto_and_the_user_over_it() -> None:
    plan = make_plan(field(5, 5, method="blend"), Config())
    assert plan.method == "blend"
    assert "blend 41.0 dB" in next(item.why for item in plan.left_out if item.what == "warping")
    assert make_plan(field(5, 5, method="blend"), with_keys(render__method="warp2")).method == "warp2"
    bare = attrs.evolve(field(5, 5), disparity=None)
    assert make_plan(bare, with_keys(render__method="warp")).method == "nearest"


def test_only_planes_that_the_glasses_show() -> None:
    assert make_plan(field(3, 3), with_keys(render__anaglyph="colour")).planes == ((0,), (1, 2))
    assert make_plan(field(3, 3), with_keys(render__anaglyph="mono")).planes == ((0, 1, 2), ())
    assert make_plan(field(3, 3), with_keys(render__anaglyph="side-by-side")).planes == ((0, 1, 2), (0, 1, 2))
    assert make_plan(field(3, 3, channels=1), Config()).planes == ((0,), (0,))
    assert "two of three colour planes" in what(make_plan(field(3, 3, channels=1), Config()))


@pytest.mark.parametrize("anaglyph", MATRICES)
def test_planes_are_those_with_weight_in_the_matrix(anaglyph: str) -> None:
    rows = np.array(MATRICES[anaglyph])  # (output, eye, channel)
    used = tuple(tuple(int(k) for k in np.flatnonzero(np.abs(rows[:, eye]).sum(axis=0))) for eye in (0, 1))
    assert make_plan(field(3, 3), with_keys(render__anaglyph=anaglyph)).planes == used


def test_reach_ends_where_no_eye_comes() -> None:
    plan = make_plan(field(3, 101), with_keys(render__alpha_px=32.0))
    rows = plan.reach[:2]
    assert rows == (0, 2)
    assert plan.reach[2:] == (50 - 20 - 1, 50 + 20 + 1)
    assert make_plan(field(3, 101), Config()).reach == (0, 2, 0, 100)
    assert any("views" in item for item in what(plan))


def test_the_viewers_distance_counts_only_while_alpha_follows_it() -> None:
    assert make_plan(field(3, 3), Config()).needs_depth
    assert not make_plan(field(3, 3), with_keys(render__alpha_px=10.5)).needs_depth
    assert not make_plan(field(3, 3), with_keys(screen__distance_mm=600.0)).needs_depth


def saved(plan: Plan, part: str) -> str:
    return next(item.saves for item in plan.left_out if part in item.what)


def test_what_is_saved_is_counted_in_bytes_and_planes() -> None:
    """Views of 48 x 64 px, three planes each; frames of 640 x 480."""
    assert saved(make_plan(field(1, 1), Config()), "capture") == "two processes, 921.6 kB a frame"
    assert saved(make_plan(field(1, 9), Config()), "row") == "24.6 kB of maps"
    assert saved(make_plan(field(3, 3, channels=1), Config()), "colour planes") == "55.3 kB of pack and memory"
    film = attrs.evolve(field(3, 3, channels=1), views=np.zeros((4, 3, 3, 1, 48, 64), np.uint8))
    assert saved(make_plan(film, Config()), "colour planes") == "221.2 kB of pack and memory"
    colour = make_plan(field(3, 3), with_keys(render__anaglyph="colour", render__method="nearest"))
    assert saved(colour, "of 6 planes") == "9.2 kB a picture" and "3 of 6 planes a picture" in what(colour)
    assert saved(colour, "warping") == "3 warped planes a picture"
    assert saved(colour, "disparity maps") == "6.9 kB never read"
    far = make_plan(field(3, 101), with_keys(render__alpha_px=32.0))
    unseen = 3 * 101 - 3 * 43
    assert saved(far, "views") == f"{unseen * 3 * 48 * 64 / 1e6:.1f} MB never read" and f"{unseen} of 303 views" in what(far)


def test_the_viewers_distance_is_left_out_with_its_reason() -> None:
    for keys, why in ((dict(render__alpha_px=10.5), "render.alpha_px"), (dict(screen__distance_mm=600.0), "screen.distance_mm")):
        (one,) = (item for item in make_plan(field(3, 3), with_keys(**keys)).left_out if item.what == "the viewer's distance")
        assert one.why == f"{why} is given"
    assert "the viewer's distance" not in what(make_plan(field(3, 3), Config()))


def test_every_saving_has_a_number_and_measuring_changes_no_decision() -> None:
    for scene in (field(1, 1), field(1, 9), field(3, 3, 1), field(4, 4, extent_px=0.1)):
        plain, timed = make_plan(scene, Config()), make_plan(scene, Config(), measure=True)
        assert attrs.evolve(plain, left_out=()) == attrs.evolve(timed, left_out=())
        assert what(plain) == what(timed)
        assert all(any(c.isdigit() for c in item.saves) or "process" in item.saves for item in plain.left_out)
        assert json.dumps(timed.as_dict())
    assert any("measured" in item.saves for item in make_plan(field(1, 9), Config(), measure=True).left_out)
