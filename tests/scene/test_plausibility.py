"""Pictures that hardly fit together get a note before they are packed; no light field does."""

from pathlib import Path

import attrs
import cv2
import numpy as np
import pytest

from lfpipe import config
from lfpipe.cli.prepare import startup_lines
from lfpipe.config.modes import MouseViewer, Nothing
from lfpipe.render.plan import make_plan
from lfpipe.scene.analysis import analyse_scene
from lfpipe.scene.classification import best_method
from lfpipe.scene.info import lines
from lfpipe.scene.lightfield import HARDLY_FIT
from lfpipe.scene.packing import pack_scene
from lfpipe.scene.plausibility import plausible
from lfpipe.scene.source import GridTransform
from tests.scene import made
from tests.scene.made import as_source


def turntable(count: int, degrees: float) -> np.ndarray:
    """A lumpy ball of dots that turns before a white wall."""
    rng = np.random.default_rng(1)
    points = rng.normal(size=(2500, 3))
    points *= (1 + 0.3 * np.sin(5 * points[:, :1])) / np.linalg.norm(points, axis=1)[:, None]
    shades = rng.integers(30, 220, len(points))
    out = np.full((1, count, 160, 220), 255, np.uint8)
    for k, angle in enumerate(np.radians(degrees) * np.arange(count)):
        x = points[:, 0] * np.cos(angle) + points[:, 2] * np.sin(angle)
        z = points[:, 2] * np.cos(angle) - points[:, 0] * np.sin(angle)
        for i in np.argsort(z):
            cv2.circle(
                out[0, k],
                (int(110 + 60 * x[i]), int(80 + 60 * points[i, 1])),
                4,
                int(shades[i]),
                -1,
            )
    return out


def zoomed(view: np.ndarray, by: float, degrees: float = 0) -> np.ndarray:
    height, width = view.shape[:2]
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), degrees, by)
    return np.asarray(cv2.warpAffine(view, turn, (width, height), borderMode=cv2.BORDER_REFLECT))


def quilt_row(seed: int) -> np.ndarray:
    """Three views of a scene of its own, side by side."""
    wide = made.texture(60, 100, seed)[..., 1]
    return np.hstack([wide[:, shift : shift + 80] for shift in (0, 8, 16)])


def before_a_skyline(person: int, shift: int) -> np.ndarray:
    """A portrait before a row of houses; other people stand before the same ones."""
    rng = np.random.default_rng(3)
    picture = np.full((240, 640), 200, np.uint8)
    left = 0
    while left < 640:
        width, top = int(rng.integers(12, 40)), int(rng.uniform(24, 110))
        picture[top:, left : left + width] = rng.integers(60, 140)
        for y, x in np.ndindex(30, width // 7):
            if top + 4 + 9 * y < 240:
                window = picture[top + 4 + 9 * y :, left + 3 + 7 * x :][:4, :3]
                window[:] = rng.integers(20, 240)
        left += width
    picture = picture[:, shift : shift + 320].copy()
    y, x = np.mgrid[:240, :320]
    middle = 320 * np.random.default_rng(person).uniform(0.35, 0.65)
    head = np.hypot((x - middle) / 42, (y - 96) / 53) < 1
    body = np.hypot((x - middle) / 102, (y - 252) / 108) < 1
    picture[head | body] = made.texture(240, 320, 50 + person)[..., 1][head | body]
    return picture


UNRELATED = np.array([made.texture(120, 160, seed)[..., 1] for seed in range(16)])
NO_LIGHT_FIELDS = {
    "unrelated, line": UNRELATED[None],
    "unrelated, 2x2": UNRELATED[:4].reshape(2, 2, 120, 160),
    "unrelated, grid": UNRELATED.reshape(4, 4, 120, 160),
    "unrelated, pair": UNRELATED[None, :2],
    "turntable": turntable(8, 30),
    "turntable of a few steps": turntable(12, 30),
    "bracket": np.stack(
        [np.clip(UNRELATED[0] * gain, 0, 255).astype(np.uint8) for gain in (0.3, 0.5, 1, 2, 3)]
    )[None],
    "one picture cut up": made.texture(480, 640, 3)[..., 1].reshape(4, 120, 4, 160).swapaxes(1, 2),
    "quilts": np.stack([quilt_row(seed) for seed in range(0, 60, 10)])[None],
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
    **{
        f"person {person} before a skyline, {shift} px": np.stack(
            [before_a_skyline(person, 10), before_a_skyline(person, 10 + shift)]
        )[None]
        for person, shift in ((5, 4), (8, 20), (5, 40))
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


@pytest.mark.parametrize("form", ["a grid that looks inwards", "a quilt"])
def test_sets_whose_views_have_no_common_shift_open_right(tmp_path: Path, form: str) -> None:
    """As real ones that lfpipe refused."""
    if form == "a quilt":
        grid = made.views(1, 32, 150, 200, 1.5, -0.3)
        tiles = grid.reshape(8, 4, 150, 200, 3)[::-1]
        made.write(tmp_path / "scene_qs4x8.png", made.mosaic(tiles))
    else:
        grid = made.views(5, 5, 192, 256, 7.7, -6.9)
        made.write_grid(tmp_path, grid, "{r:02d}_{c:02d}.png")
    found = analyse_scene(tmp_path, config.Scene())
    assert (found.rows, found.cols, found.source.notes) == (*grid.shape[:2], ())
    assert found.orientation.sure and found.turn == GridTransform()


def test_an_album_opens_with_a_note_wherever_it_is_shown(tmp_path: Path) -> None:
    made.write_grid(tmp_path / "s", UNRELATED[:9].reshape(3, 3, 120, 160))
    field = pack_scene(tmp_path / "s", config.Scene(cache_dir=str(tmp_path / "cache")))
    assert (field.rows, field.cols) == (3, 3) and HARDLY_FIT in field.manifest.notes
    plan = make_plan(field, config.Config())
    started = startup_lines(config.Config(), field, plan, MouseViewer(), Nothing())
    for shown in (lines(field.manifest), started):
        assert sum(HARDLY_FIT in line for line in shown) == 1


def test_a_pair_by_name_that_is_none_gets_a_note(tmp_path: Path) -> None:
    for name, picture in zip(("left", "right"), UNRELATED, strict=False):
        made.write(tmp_path / f"x_{name}.png", picture)
    found = analyse_scene(tmp_path, config.Scene())
    assert found.source.layout == "stereo" and HARDLY_FIT in found.source.notes


@pytest.mark.parametrize(
    ("scores", "reach_px", "has_disparity", "method"),
    [
        ({"nearest": 30.0, "blend": 30.2, "warp": 30.2, "warp2": 30.24}, 9, True, "nearest"),
        ({"nearest": 30.0, "blend": 31.0, "warp": 34.0, "warp2": 34.1}, 9, True, "warp"),
        ({"nearest": 30.0, "warp": 34.0, "warp2": 34.5}, 9, True, "warp2"),
        ({}, 0.6, True, "warp2"),
        ({}, 0.4, True, "blend"),
        ({}, 2.0, False, "blend"),
        ({}, 2.1, False, "nearest"),
    ],
)
def test_best_method_is_the_cheapest_that_nothing_beats_visibly(
    scores: dict[str, float], reach_px: float, has_disparity: bool, method: str
) -> None:
    assert best_method(scores, reach_px, has_disparity) == method
