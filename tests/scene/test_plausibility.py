"""Pictures that hardly fit together get a note before they are packed; no light field does."""

from pathlib import Path

import attrs
import cv2
import numpy as np
import pytest

from lfpipe import config
from lfpipe.scene.analysis import analyse_scene, plausible
from lfpipe.scene.lightfield import HARDLY_FIT
from tests.scene import made
from tests.scene.made import as_source


def zoomed(view: np.ndarray, by: float, degrees: float = 0) -> np.ndarray:
    height, width = view.shape[:2]
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), degrees, by)
    return np.asarray(cv2.warpAffine(view, turn, (width, height), borderMode=cv2.BORDER_REFLECT))


UNRELATED = np.array([made.texture(120, 160, seed)[..., 1] for seed in range(16)])
NO_LIGHT_FIELDS = {
    "unrelated, line": UNRELATED[None],
    "unrelated, 2x2": UNRELATED[:4].reshape(2, 2, 120, 160),
    "unrelated, grid": UNRELATED.reshape(4, 4, 120, 160),
    "unrelated, pair": UNRELATED[None, :2],
    "bracket": np.stack(
        [np.clip(UNRELATED[0] * gain, 0, 255).astype(np.uint8) for gain in (0.3, 0.5, 1, 2, 3)]
    )[None],
    "one picture cut up": made.texture(480, 640, 3)[..., 1].reshape(4, 120, 4, 160).swapaxes(1, 2),
}


@pytest.mark.parametrize("kind", NO_LIGHT_FIELDS)
def test_what_is_no_light_field_gets_a_note(kind: str) -> None:
    source, _ = plausible(attrs.evolve(as_source(NO_LIGHT_FIELDS[kind]), certain=False))
    assert HARDLY_FIT in source.notes


NOISE = np.random.default_rng(0).normal(0, 20, made.views(5, 5).shape)
BEHIND = made.views(5, 5, 96, 128, -3.0, -5.0)  # shines through, as in a window


def held_by_hand(grid: np.ndarray) -> np.ndarray:
    """Views that are shifted by some px and turned by about a degree each."""
    rng = np.random.default_rng(0)
    height, width = grid.shape[2:4]
    out = grid.copy()
    for r, c in np.ndindex(grid.shape[:2]):
        move = cv2.getRotationMatrix2D((width / 2, height / 2), rng.normal(0, 1.0), 1)
        move[:, 2] = move[:, 2] + rng.normal(0, 1.5, 2)
        out[r, c] = cv2.warpAffine(grid[r, c], move, (width, height), borderMode=cv2.BORDER_REFLECT)
    return out


def ends_where_it_began(shift_px: int) -> np.ndarray:
    """A line of views, no circle."""
    line = np.array(made.views(1, 9, 144, 192, 0.3, -0.2))
    line[0, -1], line[0, 0] = (np.roll(line[0, 0], -k * shift_px, 1) for k in (2, 1))
    return line


LIGHT_FIELDS = {
    # cameras look at the middle of the scene: near and far move in opposite directions
    "looking inwards": made.views(5, 5, 192, 256, 7.7, -6.9),
    "a quilt": made.views(1, 32, 150, 200, 1.5, -0.3),
    # found again, by flow or by blocks, however far apart
    **{
        f"a pair, {px} px": made.views(1, 2, 192, 256, px, -px / 2) for px in (2.0, 8.0, 16.0, 24.0)
    },
    **{f"ends where it began, {px} px": ends_where_it_began(px) for px in range(3)},
    "held by hand": held_by_hand(made.views(3, 5, 144, 192)),
    "held by hand, a line": held_by_hand(made.views(1, 9, 144, 192)),
    "plain": made.views(5, 5),
    "line": made.views(1, 9),
    "line of small steps": made.views(1, 45, 150, 200, 0.5, -0.3),
    "line of smaller steps": made.views(1, 45, 150, 200, 0.25, -0.15),
    "wide baseline": made.views(3, 5, 96, 128, 16.0, -8.0),
    "converging": made.views(5, 5, 96, 128, -2.0, -6.0),
    "reflection": (0.6 * made.views(5, 5) + 0.4 * BEHIND).astype(np.uint8),
    "2x2": made.views(2, 2, 96, 128, 8.0, -4.0),
    "noise": np.clip(made.views(5, 5) + NOISE, 0, 255).astype(np.uint8),
    "one colour": np.full((3, 3, 96, 128, 3), 40, np.uint8),
    "little texture": np.stack(
        [[cv2.GaussianBlur(view, (0, 0), 6) for view in row] for row in made.views(5, 5)]
    ),
    "rows reversed": made.views(5, 5)[::-1],
    "no parallax": np.broadcast_to(made.texture(96, 128, 7), (3, 3, 96, 128, 3)),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("kind", LIGHT_FIELDS)
def test_no_light_field_gets_a_note(kind: str) -> None:
    source, measured = plausible(attrs.evolve(as_source(LIGHT_FIELDS[kind]), certain=False))
    assert HARDLY_FIT not in source.notes and measured is not None
    assert (source.rows * source.cols == 1) == (
        kind in ("no parallax", "ends where it began, 0 px")
    )


def test_a_pair_by_name_that_is_none_gets_a_note(tmp_path: Path) -> None:
    for name, picture in zip(("left", "right"), UNRELATED, strict=False):
        made.write(tmp_path / f"x_{name}.png", picture)
    found = analyse_scene(tmp_path, config.Scene())
    assert found.source.layout == "stereo" and HARDLY_FIT in found.source.notes
