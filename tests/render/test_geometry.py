"""The distance of the eyes on the grid: known cases computed by hand, and arbitrary configurations."""

import math

import attrs
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfpipe.config import Config, from_dict
from lfpipe.config.camera_pose import camera_focal_px
from lfpipe.errors import UserError
from lfpipe.render.geometry import focal_px_from, parallax
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


@pytest.mark.parametrize(
    ("width_mm", "distance_mm", "zero_px", "limit_mm", "extent_px", "why"),
    [
        (600.0, 600.0, 0.0, 600 * math.pi / 180, 1.6, "1 degree"),
        (299.0, 600.0, 0.0, 0.03 * 299, 1.6, "3% of the picture's width"),
        (3000.0, 10000.0, 0.0, 63.0, 1.6, "must not diverge"),
        (3000.0, 10000.0, -1.5, 0.03 * 3000, 3.0, "3% of the picture's width"),  # nearly all of it stands before the screen
        (299.0, 600.0, -1.0, 0.03 * 299, 2.5, "3% of the picture's width"),  # and so does more than stands behind it
        (299.0, 600.0, 1.0, 0.03 * 299, 2.6, "3% of the picture's width"),
    ],
)
def test_each_limit_of_comfort_by_hand(
    width_mm: float, distance_mm: float, zero_px: float, limit_mm: float, extent_px: float, why: str
) -> None:
    screen = {"width_mm": width_mm, "distance_mm": distance_mm}
    for alpha in (1e-3, 1e3):
        render = {"zero_plane_px": zero_px, "alpha_px": alpha}
        how = from_dict({"camera": {"focal_px": 600.0}, "screen": screen, "render": render})
        found = parallax(how, cotton(), 640, 63.0)
        assert found.distance_mm == distance_mm and "(configured)" in str(found)
        assert found.comfort_views == pytest.approx(limit_mm / (extent_px * width_mm / 512))
        assert (why in str(found)) == found.exceeds_comfort == (alpha < 1)


def test_the_advice_beyond_comfort_ends_it() -> None:
    advised = 63.0 / (parallax(config(alpha_px=3.5), cotton(), 640, 63.0).comfort_views or 0)
    assert f"use render.alpha_px of at least {advised:.1f}" in str(parallax(config(alpha_px=3.5), cotton(), 640, 63.0))
    assert not parallax(config(alpha_px=1.01 * advised), cotton(), 640, 63.0).exceeds_comfort
    assert parallax(config(alpha_px=0.99 * advised), cotton(), 640, 63.0).exceeds_comfort


def test_the_least_of_room_comfort_and_nature_decides() -> None:
    shallow = attrs.evolve(cotton(), disparity_min_px=-0.1, disparity_max_px=0.1)
    close_up = attrs.evolve(shallow, geometry=Geometry(100.0, 1000.0))  # 100 mm of baseline, one metre away
    found = parallax(config(alpha_px="auto"), close_up, 640, 63.0)
    assert found.views_between_eyes == found.true_views == pytest.approx(63 / (0.1 * 600))
    assert "true depth" in str(found) and found.compression == 1.0
    zeroed = parallax(config(alpha_px="auto", zero_plane_px=0.05), close_up, 640, 63.0)
    assert zeroed.true_views == found.true_views, "without the capture's focal length the zero plane's depth is not known"
    for rows, cols, room in ((9, 9, 4.0), (9, 1, 4.0), (1, 5, 2.0), (1, 1, 0.5)):
        grid = attrs.evolve(rendered.field(rows, cols, 4, 64), disparity_min_px=-1e-3, disparity_max_px=1e-3)
        assert parallax(config(alpha_px="auto"), grid, 640, 63.0).views_between_eyes == room, (rows, cols)
    unknown = attrs.evolve(rendered.field(1, 40, 4, 64), disparity_source="none")
    assert parallax(config(alpha_px="auto"), unknown, 640, 63.0).views_between_eyes == 4.0


def test_the_width_of_the_picture_is_the_persons_then_the_monitors_then_a_guess() -> None:
    auto = from_dict({"camera": {"focal_px": 600.0}})
    told, guessed = parallax(auto, cotton(), 640, 63.0, None, 300.0), parallax(auto, cotton(), 640, 63.0)
    assert "picture 300 mm wide on this monitor" in str(told) and "assuming a picture 530 mm wide" in str(guessed)
    asked = parallax(config(alpha_px="auto"), cotton(), 640, 63.0, None, 300.0)
    assert "wide" not in str(asked)
    assert asked.comfort_views == parallax(config(alpha_px="auto"), cotton(), 640, 63.0).comfort_views


def test_the_zero_plane_moves_what_is_farthest_and_the_truth() -> None:
    here, window = (parallax(config(alpha_px="auto", zero_plane_px=zero), cotton(), 640, 63.0) for zero in (0.0, 1.5))
    assert window.comfort_views == pytest.approx((here.comfort_views or 0) * 1.6 / 3.1)
    assert window.true_views is not None
    assert here.true_views is not None
    assert window.true_views < here.true_views
    assert "in front of the screen; render.zero_plane_px=1.50 puts everything behind it" in str(here)
    assert "in front of the screen" not in str(window)


def test_auto_puts_the_nearest_at_the_border_into_the_screen_and_chooses_alpha_for_it() -> None:
    offset = attrs.evolve(cotton(), disparity_min_px=9.0, disparity_max_px=12.0, border_px=(9.0, 10.5))
    found, unmoved = (parallax(config(zero_plane_px=zero), offset, 640, 63.0) for zero in ("auto", 0.0))
    assert found.zero_plane_px == 10.5 and "+10.50 px/view" in str(found)
    assert found.comfort_views == pytest.approx((unmoved.comfort_views or 0) * 12.0 / 1.5), "the budget is that of this screen"
    assert found.views_between_eyes == 4.0 > 2 * unmoved.views_between_eyes
    assert parallax(config(), offset.exchanged(), 640, 63.0).zero_plane_px == -9.0, "what was far is near"
    assert not found.exceeds_comfort and parallax(config(), cotton(), 640, 63.0).zero_plane_px == 0.0


def test_depth_follows_the_seat() -> None:
    """Twice as far the eyes are half as far apart in the picture: the same number of views between them, half of alpha."""
    near, far = (parallax(config(alpha_px="auto"), cotton(), 640, eyes_px) for eyes_px in (63.0, 31.5))
    assert far.distance_mm == pytest.approx(2 * near.distance_mm)
    assert far.alpha_px == pytest.approx(near.alpha_px / 2)


def test_a_step_of_the_viewer_is_no_news_and_another_seat_is() -> None:
    at = {eyes_px: parallax(config(alpha_px="auto"), cotton(), 640, eyes_px) for eyes_px in (63.0, 68.0, 80.0)}
    by_hand = parallax(config(alpha_px=20.0), cotton(), 640, 63.0)
    assert not at[68.0].differs_from(at[63.0])
    assert at[80.0].differs_from(at[63.0]) and by_hand.differs_from(at[63.0])


def test_focal_length() -> None:
    assert camera_focal_px(from_dict({"camera": {"fov_deg": 60.0}}), 640) == pytest.approx(320.0 * math.sqrt(3))
    wide = from_dict({"camera": {"focal_px": 600.0, "width_px": 640}})
    assert camera_focal_px(wide, 1280) == pytest.approx(1200.0)
    assert focal_px_from(63.0, 63.0, 600.0) == pytest.approx(600.0)
    with pytest.raises(UserError, match="0 px"):
        focal_px_from(0.0, 63.0, 600.0)


@settings(max_examples=200)
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
