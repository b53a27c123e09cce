"""The demo's light field: exact by its own geometry, and in the layout that it claims."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene import layouts
from lfpipe.scene.demo import demo_scene
from lfpipe.scene.demo_layers import Ball, Quad, render_view
from lfpipe.scene.demo_still_life import OFFSET_PX, still_life
from lfpipe.scene.source import SceneSource


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SceneSource:
    return layouts.describe(demo_scene(tmp_path_factory.mktemp("cache"), grid=3, size_px=256), config.Scene())


def view(scene: SceneSource, index: int) -> np.ndarray:
    return scene.read(0, *divmod(index, 3))


def disparity(scene: SceneSource, index: int) -> np.ndarray:
    return scene.truth[divmod(index, 3)]()


def test_every_view_follows_from_the_middle_one_by_its_disparity(scene: SceneSource) -> None:
    """Warped along the true disparity the middle view is the other view, wherever it sees the same; unwarped it is not."""
    y, x = np.mgrid[0:256, 0:256].astype(np.float32)
    middle, middle_d = view(scene, 4), disparity(scene, 4)
    for index in (0, 1, 3, 5, 7, 8):
        v, u = index // 3 - 1, index % 3 - 1
        d = disparity(scene, index)
        mx, my = x + d * u, y + d * v
        warped = cv2.remap(middle, mx, my, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE).astype(int)
        same = np.abs(cv2.remap(middle_d, mx, my, cv2.INTER_NEAREST) - d) < 0.02
        same &= (mx > 1) & (mx < 254) & (my > 1) & (my < 254)
        assert same.mean() > 0.9
        other = view(scene, index).astype(int)
        error, unwarped = np.abs(warped - other)[same].mean(), np.abs(middle - other)[same].mean()
        assert error < 1.5 and error < 0.35 * unwarped


def test_the_scene_reaches_before_and_behind_the_screen(scene: SceneSource) -> None:
    d = disparity(scene, 4) * 2  # of 512 px
    assert np.isfinite(d).all()
    assert d.min() == pytest.approx(-2.0) and 1.5 < d.max() < 2.1
    assert (d > 0.3).mean() > 0.1 and (d < -0.3).mean() > 0.3


def test_there_is_texture_nearly_everywhere(scene: SceneSource) -> None:
    grey = cv2.cvtColor(view(scene, 4), cv2.COLOR_RGB2GRAY).astype(np.float32)
    spread = np.sqrt(np.maximum(cv2.blur(grey**2, (15, 15)) - cv2.blur(grey, (15, 15)) ** 2, 0))
    assert (spread > 1.5).mean() > 0.95


def test_the_geometry_says_what_the_pictures_show(scene: SceneSource) -> None:
    known = scene.geometry
    at_infinity = known.focal_length_px * known.baseline_mm / known.focus_distance_mm
    assert at_infinity == pytest.approx(OFFSET_PX / 2, rel=1e-4), "half of 512 px"


def test_a_cache_that_cannot_be_written_is_the_users_to_fix(tmp_path: Path) -> None:
    (tmp_path / "demo").write_text("in the way")
    with pytest.raises(UserError, match="demo scene") as refused:
        demo_scene(tmp_path, grid=3, size_px=64)
    assert "scene.cache_dir" in refused.value.remedy


def test_the_same_picture_every_time() -> None:
    first, second = (render_view(still_life(96), 96, 96, 1, -1) for _ in range(2))
    assert np.array_equal(first[0], second[0]) and np.array_equal(first[1], second[1])


offsets = st.floats(-4, 4)


@settings(max_examples=40)
@given(offsets, offsets, st.floats(-2, 2), st.floats(-1, 1), st.floats(-1, 1))
def test_a_quad_stands_where_its_disparity_says(u: float, v: float, d: float, tilt_x: float, tilt_y: float) -> None:
    """In every view, (x + d u, y + d v, d) of each covered pixel lies in the plane of the quad and inside it."""
    at = np.array([(20.0, 20.0), (44.0, 20.0), (44.0, 44.0), (20.0, 44.0)])
    slope = np.array([tilt_x, tilt_y]) / 24
    depth = d + (at - 32) @ slope
    texture = np.full((32, 32, 4), 255, np.uint8)
    _, seen = render_view([Quad(texture, np.column_stack([at, depth]))], 64, 64, u, v, 1)
    y, x = np.nonzero(np.isfinite(seen))
    assert len(x) > 100
    found = seen[y, x]
    centre = np.column_stack([x + found * u, y + found * v])
    assert np.abs(d + (centre - 32) @ slope - found).max() < 1e-3
    assert centre.min() > 18.5 and centre.max() < 45.5


@settings(max_examples=40)
@given(offsets, offsets, st.floats(-2, 2), st.floats(0.05, 0.6))
def test_a_balls_points_lie_on_it_and_face_the_camera(u: float, v: float, d: float, depth: float) -> None:
    ball = Ball(np.zeros((4, 4, 3), np.uint8), 32.0, 30.0, d, 14.0, depth, 0.0)
    _, seen = render_view([ball], 64, 64, u, v, 1)
    y, x = np.nonzero(np.isfinite(seen))
    assert len(x) > 300
    found = seen[y, x].astype(float)
    nx, ny, nd = (x + found * u - 32) / 14, (y + found * v - 30) / 14, (found - d) / depth
    assert np.abs(nx**2 + ny**2 + nd**2 - 1).max() < 1e-3
    facing = nx * u / 14 + ny * v / 14 + nd / depth  # the ray runs along (u, v, 1) towards the camera
    assert facing.min() > -0.05 / depth
