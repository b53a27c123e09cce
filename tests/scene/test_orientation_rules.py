"""The rules of the order of views, each by its definition."""

from typing import Any

import cv2
import numpy as np
import pytest

from lfpipe import config
from lfpipe.scene.lightfield import OrderSource
from lfpipe.scene.orientation import Orientation, orient
from lfpipe.scene.source import GridTransform, SceneSource
from tests.scene import made
from tests.scene.made import TURNS
from tests.scene.made import as_source as source

AUTO = config.Scene()


HABIT: dict[str, Any] = {"turn": GridTransform(), "turn_by": "habit", "turn_firm": False}
PAINTED = made.texture(192, 256, 4)
STEEP = np.array([[PAINTED[4 * k : 96 + 4 * k, 4 * k : 128 + 4 * k] for k in range(7)]])
NOISE = np.array([[made.texture(96, 128, 10 * r + c) for c in range(3)] for r in range(3)])
GRID = made.views(5, 5)
SMALL_STEPS = made.views(1, 31, 144, 192, 0.4, -0.2)[..., 1]
# of a sensor: motion between neighbours is lost in it
NOISY = np.random.default_rng(1).normal(SMALL_STEPS, 3).clip(0, 255).astype(np.uint8)
# views, settings, what is found of their order, and words of the reason or of the doubt
ORDERS: dict[str, tuple[SceneSource, dict[str, Any], dict[str, Any], str]] = {
    "motion of 0.4 px": (source(made.views(5, 5, 96, 128, 0.4, -0.4)), {}, {"by": "flow"}, ""),
    "small steps below the noise": (
        source(NOISY),
        {},
        {"by": "flow", "turn": GridTransform(), "depth_order_sure": True},
        "",
    ),
    "no motion": (source(made.views(5, 5, 96, 128, 0.0, 0.0)), {}, {"by": "nothing"}, "scene.flip"),
    "views that move across their line": (
        source(STEEP),
        {},
        {"by": "nothing", "depth_order_sure": False},
        "across the line",
    ),
    "columns that stand still": (
        source(np.repeat(made.views(1, 7), 3, axis=0)),
        {},
        {"by": "flow", "turn": GridTransform()},
        "whether this is a grid",
    ),
    # nothing hides anything, and cameras may converge in front of it
    **{
        f"one wall, {way}": (
            source(made.wall(5, 5, 96, 128, 4)[::step, ::step]),
            {},
            {"turn": GridTransform(), "depth_order_sure": False},
            "depth order",
        )
        for way, step in (("as it is", 1), ("inverted", -1))
    },
    **{
        f"too small: {height}x{width}": (
            source(np.random.default_rng(0).integers(0, 256, (3, 3, height, width, 3), np.uint8)),
            {},
            {"turn": GridTransform(), "by": "nothing", "sure": False},
            "too small",
        )
        for height, width in ((1, 1), (6, 8), (23, 200))
    },
    "a doubt of the layout": (
        source(GRID, doubt="perhaps 3x3"),
        {},
        {"undecided": "perhaps 3x3", "sure": False, "depth_order_sure": False},
        "",
    ),
    "a doubt about one view": (
        source(made.views(1, 1), doubt="x"),
        {},
        {"turn": GridTransform()},
        "",
    ),
    "a habit against clear flow": (
        source(made.views(5, 7)[::-1], **HABIT),
        {},
        {"turn": GridTransform(rows=True)},
        "",
    ),
    "a habit against noise": (
        source(NOISE, **HABIT),
        {},
        {"turn": GridTransform(), "by": "layout"},
        "",
    ),
    **{
        f"the user's word: {words}": (source(GRID), words, {"turn": turn, "by": by}, "")
        for words, turn, by in (
            ({"flip": "rows"}, GridTransform(rows=True), "override"),
            ({"flip": "none", "transpose": "yes"}, GridTransform(transpose=True), "override"),
            ({"flip": "both"}, GridTransform(True, True), "override"),
            ({"flip": "none"}, GridTransform(), "override"),
            ({"transpose": "yes"}, GridTransform(transpose=True), "override"),
            # a setting that changes nothing is none
            ({"transpose": "no"}, GridTransform(), "flow"),
        )
    },
}


@pytest.mark.parametrize("kind", ORDERS)
def test_order_of_views(kind: str) -> None:
    views, words, expected, said = ORDERS[kind]
    order = orient(views, config.Scene(**words))
    assert {name: getattr(order, name) for name in expected} == expected
    assert said in order.reason + order.undecided
    assert not words or (order.detected is None) == (order.by == "flow")


@pytest.mark.parametrize("turn", TURNS, ids=str)
def test_a_pack_leaves_depth_inversion_to_the_session(turn: GridTransform) -> None:
    order = Orientation(turn=turn, by=OrderSource.FLOW, reason="")
    assert order.invert_depth is turn.cols
    assert order.packed == (
        GridTransform(not turn.rows, False, turn.transpose) if turn.cols else turn
    )
    assert order.truth_sign == (-1 if turn.cols else 1)
    asked = Orientation(turn=turn, by=OrderSource.OVERRIDE, reason="", detected=GridTransform())
    assert (asked.invert_depth, asked.packed) == (False, turn)
    assert asked.truth_sign == (
        0 if turn.transpose or turn.rows != turn.cols else -1 if turn.cols else 1
    )


@pytest.mark.parametrize(("near_px", "far_px"), [(2.0, -1.0), (1.0, 0.5)])
def test_depth_is_that_of_the_middle_view_in_either_way(near_px: float, far_px: float) -> None:
    grid = made.views(5, 5, 96, 128, near_px, far_px)
    true = {(2, 2): lambda: made.middle_disparity(96, 128, near_px, far_px)}
    for more in (
        {"turn": GridTransform(), "turn_by": "names", "turn_firm": True, "truth": true},
        {"turn": GridTransform(), "turn_by": "names"},
        {},
    ):
        depth = orient(source(grid, **more), AUTO).depth
        assert depth is not None
        assert depth.max_px == pytest.approx(near_px, abs=0.4)
        assert depth.min_px == pytest.approx(far_px, abs=0.4)
    column = orient(
        source(grid[:, 2:3], turn=GridTransform(), turn_by="names", turn_firm=True), AUTO
    ).depth
    assert column is not None and column.max_px == pytest.approx(near_px, abs=0.4)
    turned = orient(
        source(grid[::-1, ::-1], turn=GridTransform(True, True), turn_by="names", turn_firm=True),
        AUTO,
    )
    assert turned.depth is not None and turned.depth.max_px == pytest.approx(-far_px, abs=0.4), (
        "of the pack, without depth inversion"
    )


def poles(count: int, near_px: float, grain: float) -> np.ndarray:
    """A line of views of upright poles with a little grain: hardly an edge crosses y."""
    shades, speckles = (np.random.default_rng(2).random((2, 144, 384))).astype(np.float32)
    painted = np.repeat(
        cv2.resize(shades[:1, ::6], (384, 1), interpolation=cv2.INTER_CUBIC), 144, 0
    )
    painted += grain * cv2.GaussianBlur(speckles, (0, 0), 2)
    y, x = np.mgrid[:144, :192].astype(np.float32)
    out = []
    for step in np.arange(count, dtype=np.float32) - count // 2:
        far, near = (
            cv2.remap(painted, x + at + np.float32(px) * step, y, cv2.INTER_LINEAR)
            for at, px in ((0, -near_px / 2), (192, near_px))
        )
        inside = np.abs(x + np.float32(near_px) * step - 96) < 32
        out.append(np.clip(180 * np.where(inside, near, far) + 30, 0, 255).astype(np.uint8))
    return np.array([out])


@pytest.mark.parametrize("near_px", [0.15, 0.5, 1.5])
@pytest.mark.parametrize("grain", [0.0, 0.02, 0.2])
@pytest.mark.parametrize("upright", [True, False])
def test_flow_along_edges_says_nothing(near_px: float, grain: float, upright: bool) -> None:
    line = poles(45, near_px, grain)
    order = orient(source(line if upright else line.swapaxes(2, 3)), AUTO)
    assert order.by == "flow" and order.turn.transpose is not upright
