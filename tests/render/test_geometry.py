"""How far apart the eyes stand on the grid: the known cases worked out by hand, and whatever else may be configured."""

from __future__ import annotations

import math

import attrs
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfpipe.config import Config, from_dict
from lfpipe.errors import UserError
from lfpipe.render.geometry import camera_focal_px, focal_px_from, parallax
from lfpipe.scene.lightfield import Geometry, LightField
from tests.render import rendered

# The HCI scene "cotton": baseline 25 mm, focus 4.25 m, focal length 1462.9 px of 512, disparities -1.6..1.5
COTTON = Geometry(25.0, 4250.0, 1462.9)


def cotton(geometry: Geometry = COTTON) -> LightField:
    field = rendered.field(9, 9, 4, 512)
    return attrs.evolve(field, geometry=geometry, disparity_min_px=-1.6, disparity_max_px=1.5, name="cotton")


def config(**render: object) -> Config:
    return from_dict({"camera": {"focal_px": 600.0}, "screen": {"width_mm": 299.0}, "render": render})


def test_true_geometry_of_a_known_capture() -> None:
    """alpha = focal length of the webcam * baseline / focus distance, whatever the distance of the viewer."""
    for eyes_px in (63.0, 31.5):
        found = parallax(config(alpha_px="true"), cotton(), 640, eyes_px)
        assert found.alpha_px == pytest.approx(600 * 25 / 4250)
        assert found.compression == pytest.approx(1.0)
    assert parallax(config(alpha_px="true"), cotton(), 640, 63.0).true_views == pytest.approx(17.85, abs=0.01)


def test_true_geometry_of_an_unknown_capture_is_refused_by_name() -> None:
    with pytest.raises(UserError, match="cotton") as caught:
        parallax(config(alpha_px="true"), cotton(Geometry()), 640, 63.0)
    assert "auto" in caught.value.remedy


def test_comfort_by_hand() -> None:
    """At 600 mm one degree is 10.47 mm and 3 % of the width 8.97 mm; a view step moves the farthest 1.6 px of 0.584 mm."""
    found = parallax(config(alpha_px="auto"), cotton(), 640, 63.0)
    assert found.distance_mm == pytest.approx(600.0)
    assert found.comfort_views == pytest.approx(8.97 / (1.6 * 299 / 512), rel=1e-3)
    assert found.views_between_eyes == 4.0, "half of nine columns decides"
    assert found.alpha_px == pytest.approx(63.0 / 4)
    assert found.compression == pytest.approx(4 / 17.85, rel=1e-3)
    assert not found.exceeds_comfort


def test_a_deep_scene_is_held_to_comfort() -> None:
    deep = attrs.evolve(cotton(), disparity_min_px=-14.6, disparity_max_px=8.4)
    found = parallax(config(alpha_px="auto"), deep, 640, 63.0)
    assert found.views_between_eyes == pytest.approx(found.comfort_views or 0)
    assert found.views_between_eyes < 2


def test_alpha_by_hand_beyond_comfort_is_kept_and_said() -> None:
    found = parallax(config(alpha_px=3.5), cotton(), 640, 63.0)
    assert found.alpha_px == pytest.approx(3.5)
    assert found.exceeds_comfort
    assert "beyond comfort" in str(found)
    assert not parallax(config(alpha_px=20.0), cotton(), 640, 63.0).exceeds_comfort


def test_the_zero_plane_moves_what_is_farthest_and_the_truth() -> None:
    here, window = (parallax(config(alpha_px="auto", zero_plane_px=zero), cotton(), 640, 63.0) for zero in (0.0, 1.5))
    assert window.comfort_views == pytest.approx((here.comfort_views or 0) * 1.6 / 3.1)
    assert window.true_views is not None
    assert here.true_views is not None
    assert window.true_views < here.true_views
    assert "before the screen; render.zero_plane_px=1.50 puts all behind it" in str(here)
    assert "before the screen" not in str(window)


def test_depth_follows_the_seat() -> None:
    """Twice as far the eyes are half as far apart in the picture: the same number of views between them, half of alpha."""
    near, far = (parallax(config(alpha_px="auto"), cotton(), 640, eyes_px) for eyes_px in (63.0, 31.5))
    assert far.distance_mm == pytest.approx(2 * near.distance_mm)
    assert far.alpha_px == pytest.approx(near.alpha_px / 2)


def test_focal_length() -> None:
    assert camera_focal_px(from_dict({"camera": {"fov_deg": 90.0}}), 640) == pytest.approx(320.0)
    wide = from_dict({"camera": {"focal_px": 600.0, "width_px": 640}})
    assert camera_focal_px(wide, 1280) == pytest.approx(1200.0)
    assert focal_px_from(63.0, 63.0, 600.0) == pytest.approx(600.0)
    with pytest.raises(UserError, match="0 px"):
        focal_px_from(0.0, 63.0, 600.0)


@settings(max_examples=200, deadline=None)
@given(
    alpha=st.one_of(st.just("auto"), st.floats(1e-9, 1e9)),
    eyes_px=st.one_of(st.none(), st.floats(allow_nan=True, allow_infinity=True)),
    low=st.floats(-100, 100),
    span=st.floats(0, 200),
    zero=st.floats(-1000, 1000),
    grid=st.tuples(st.integers(1, 3), st.integers(1, 40)),
    distance=st.one_of(st.just("auto"), st.floats(50, 50000)),
    geometry=st.sampled_from([Geometry(), COTTON, Geometry(1e-9, 1e9, 1.0), Geometry(1e9, 1e-9, 1e9)]),
)
def test_always_an_answer(
    alpha: float | str,
    eyes_px: float | None,
    low: float,
    span: float,
    zero: float,
    grid: tuple[int, int],
    distance: float | str,
    geometry: Geometry,
) -> None:
    field = attrs.evolve(
        rendered.noise(*grid, 1, 1, 1.0, 0), disparity_min_px=low, disparity_max_px=low + span, geometry=geometry
    )
    how = from_dict({"render": {"alpha_px": alpha, "zero_plane_px": zero}, "screen": {"distance_mm": distance}})
    found = parallax(how, field, 640, eyes_px)
    assert math.isfinite(found.alpha_px)
    assert found.alpha_px > 0
    assert math.isfinite(found.views_between_eyes)
    assert 50 <= found.distance_mm <= 50000
    assert str(found)
