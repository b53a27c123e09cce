"""The order of the views is found from flow alone, however the grid was turned; what cannot be told
is said.
"""

from itertools import product
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe import config
from lfpipe.scene.analysis import grid_offsets
from lfpipe.scene.layouts._grid import coordinate_turn
from lfpipe.scene.orientation import orient
from lfpipe.scene.source import GridTransform
from tests.scene import made
from tests.scene.made import TURNS, as_source, turned

AUTO = config.Scene()


@pytest.mark.parametrize("turn", TURNS, ids=str)
def test_flow_finds_every_turn(turn: GridTransform) -> None:
    found = orient(as_source(turned(made.views(5, 7), turn)), AUTO)
    assert (found.turn, found.by, found.undecided) == (turn, "flow", "")
    assert found.depth_order_sure


@pytest.mark.parametrize(
    "more",
    [{}, {"turn": GridTransform(), "turn_by": "habit", "turn_firm": False}],
    ids=["", "habit"],
)
def test_one_way_motion_decides_all_but_depth_inversion(more: dict[str, Any]) -> None:
    size_px = (360, 480) if more else (96, 128)  # large views are looked at reduced
    found = orient(as_source(made.wall(5, 5, *size_px, 4)[:, ::-1], **more), AUTO)
    assert found.turn in (GridTransform(cols=True), GridTransform(rows=True))


@given(
    st.booleans(),
    st.booleans(),
    st.booleans(),
    st.integers(2, 6),
    st.integers(2, 6),
    st.integers(0, 2**31),
)
def test_coordinates_give_the_turn_and_the_jitter(
    rows_on: bool, cols_on: bool, across: bool, rows: int, cols: int, seed: int
) -> None:
    turn = GridTransform(rows_on, cols_on, across)
    rng = np.random.default_rng(seed)
    jitter = rng.uniform(-0.1, 0.1, (rows, cols, 2))
    canonical = (
        np.stack(np.meshgrid(np.arange(rows), np.arange(cols), indexing="ij"), axis=2) + jitter
    ) * 8.6 + 1000
    camera_positions = turned(canonical, turn)
    assert coordinate_turn(camera_positions) == turn
    offsets = grid_offsets(turn.applied(camera_positions))
    assert np.abs(offsets).max() < 0.3
    # The regular grid is a fit, so what is left has no mean.
    assert np.abs(offsets.mean(axis=(0, 1))).max() < 1e-5


def disturbed(grid: np.ndarray, kind: int) -> np.ndarray:
    """Cameras that converge elsewhere, noise, blur, or a part of the picture; grid: uint8 (rows,
    cols, h, w).
    """
    rng = np.random.default_rng(kind)
    rows, cols, height, width = grid.shape
    shift = int(rng.integers(-5, 6))
    sigma = float(rng.choice([0, 0, 4, 12]))
    blur = float(rng.choice([0, 0, 3]))
    out = np.empty_like(grid)
    for r, c in product(range(rows), range(cols)):
        move = np.array(
            [[1, 0, shift * (c - cols // 2)], [0, 1, shift * (r - rows // 2)]], np.float32
        )
        view = cv2.warpAffine(grid[r, c], move, (width, height), borderMode=cv2.BORDER_REPLICATE)
        view = cv2.GaussianBlur(view, (0, 0), blur) if blur else view
        out[r, c] = np.clip(view + rng.normal(0, sigma, view.shape), 0, 255)
    return out


def test_certainty_on_made_scenes() -> None:
    """(sure, right) for disturbed and turned copies of scenes."""
    depths = [(2.0, -1.0), (3.0, 0.5), (-0.5, -2.5), (1.0, -3.0)]
    scenes = [made.views(5, 5, 144, 192, 1.5 * near, 1.5 * far)[..., 1] for near, far in depths]
    scenes.append(made.views(1, 7, 144, 192, 4.5, 0.75)[..., 1])
    judged = []
    for (number, scene), kind in product(enumerate(scenes), range(3)):
        turn = TURNS[(3 * number + 5 * kind) % 8]
        source = as_source(turned(disturbed(scene, 100 * number + kind), turn))
        order = orient(source, AUTO)
        rows, cols = order.turn.grid(source.rows, source.cols)
        places = list(product(range(rows), range(cols)))
        right = [order.turn.file_index(*p, rows, cols) for p in places] == [
            turn.file_index(*p, *scene.shape[:2]) for p in places
        ]
        judged.append((order.sure, right))
    assert all(right for sure, right in judged if sure)
    assert sum(sure for sure, _ in judged) >= 0.4 * len(judged)
