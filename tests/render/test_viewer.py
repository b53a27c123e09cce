"""The viewer before the screen: neutral pose, prediction, distance, and what stays when scene or
configuration change.
"""

import math
from typing import Any

import attrs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.config import Camera, Config
from lfpipe.config.camera_pose import CameraPose, camera_focal_px
from lfpipe.render.viewer.viewer import VIDEO_LEAD, Viewer, Viewpoints
from tests.render import rendered
from tests.render.rendered import S, record, viewer


def middle(look: Viewpoints) -> tuple[float, float]:
    """Row and column between both eyes' views."""
    return look.left[0], (look.left[1] + look.right[1]) / 2


@pytest.mark.parametrize("alpha_px", [12.0, "auto"])
def test_viewer_recentre_makes_the_present_place_the_middle(
    alpha_px: Any,
) -> None:
    subject = viewer(alpha_px=alpha_px)
    subject.viewpoints(record(), 0, 0)
    here = subject.viewpoints(record(344.0, 252.0), S, S)
    away = subject.viewpoints(record(344.0, 252.0), 3 * S, 3 * S)
    assert middle(away) != (4.0, 4.0)
    subject.recentre()
    assert middle(subject.viewpoints(record(344.0, 252.0), 4 * S, 4 * S)) == pytest.approx(
        (4.0, 4.0)
    )
    back = subject.viewpoints(record(), 5 * S, 5 * S)
    assert middle(back)[1] - 4.0 == pytest.approx(4.0 - middle(away)[1], rel=1e-3)
    assert here.right[1] - here.left[1] == pytest.approx(back.right[1] - back.left[1], rel=1e-3)
    subject.set(rendered.field(5, 7, 16, 16), subject.config)
    assert middle(subject.viewpoints(record(344.0, 252.0), 6 * S, 6 * S)) == pytest.approx(
        (2.0, 3.0)
    )


@pytest.mark.parametrize("screen_hz", [60.0, 144.0])
@pytest.mark.parametrize("film_hz", [24.0, 25.0, 30.0])
def test_viewer_keeps_the_cadence_of_a_video(film_hz: float, screen_hz: float) -> None:
    """Every frame is shown for as many refreshes as its rate asks for, to one refresh, and those of
    30 on 60 Hz for two each.
    """
    film = attrs.evolve(rendered.field(1, 2, 8, 8), frame_rate_hz=film_hz)
    film = attrs.evolve(film, views=np.repeat(film.views, 500, axis=0))
    subject = Viewer(film, Config())
    random = np.random.default_rng(2)
    lead_ns = round(VIDEO_LEAD * S / screen_hz)
    display_times = [
        round(7 * S + k * S / screen_hz + random.uniform(-3e5, 3e5)) for k in range(1200)
    ]
    frames = [subject.viewpoints(None, 0, t_ns, lead_ns).frame for t_ns in display_times]
    ratio = screen_hz / film_hz
    assert frames[0] == 0, "it begins when it is first shown"
    assert set(np.bincount(frames)[1:-1].tolist()) <= (
        {int(ratio)} if ratio == int(ratio) else {int(ratio), int(ratio) + 1}
    )


@pytest.mark.parametrize("eye_distance_px", [math.nan, math.inf, -math.inf, 1e300, -5.0])
def test_viewer_forgets_one_senseless_distance(eye_distance_px: float) -> None:
    subject, plain = viewer(), viewer()
    for k in range(120):
        wrong = (
            {"eye_distance_px": eye_distance_px} if k == 60 or k == 0 else {"eye_distance_px": 24.0}
        )
        seen = subject.viewpoints(record(300.0 + k / 4, **wrong), k * S // 60, k * S // 60)
        same = plain.viewpoints(
            record(300.0 + k / 4, eye_distance_px=24.0), k * S // 60, k * S // 60
        )
    assert seen.left == pytest.approx(same.left, abs=1e-6) and seen.right == pytest.approx(
        same.right, abs=1e-6
    )


SIZE = (640, 480)
EYES_MM = Config().screen.eyes_mm
heights, tilts = st.floats(-300, 400), st.floats(-30, 30)


def seen_px(
    config: Config, point_mm: np.ndarray, above_mm: float, tilt_deg: float
) -> tuple[np.ndarray, float]:
    """Eyes around a point before the screen (x, y down, z) in the camera's picture, and how far
    apart they are in it.
    """
    focal_px = camera_focal_px(config, SIZE[0])
    t = math.radians(tilt_deg)
    offsets_mm = [[EYES_MM / 2, above_mm, 0], [-EYES_MM / 2, above_mm, 0]]
    x, y, z = np.add(point_mm, offsets_mm).T
    down, depth = y * math.cos(t) - z * math.sin(t), y * math.sin(t) + z * math.cos(t)
    eyes_px = focal_px * np.column_stack([x, down]) / depth[:, None] + np.array(SIZE) / 2
    return eyes_px, math.dist(*eyes_px)


@given(heights, tilts, st.floats(-150, 150), st.floats(-150, 150), st.floats(350, 1500))
def test_camera_pose_gives_points_before_the_screen_and_back(
    above_mm: float, tilt_deg: float, x: float, y: float, z: float
) -> None:
    config = Config(camera=Camera(above_mm=above_mm, tilt_deg=tilt_deg))
    eyes_px, eye_distance_px = seen_px(config, np.array([x, y, z]), above_mm, tilt_deg)
    pose = CameraPose.of(config, SIZE)
    if pose is None:
        return
    np.testing.assert_allclose(
        pose.points_mm(eyes_px, eye_distance_px).mean(axis=0), (x, y, z), atol=1e-6 * z
    )
    there = pose.from_screen(eyes_px, eye_distance_px)
    np.testing.assert_allclose(pose.from_camera(there, eye_distance_px), eyes_px, atol=1e-6)
