"""The camera above the screen: eyes as points before it, and what leaning in does to the row."""

import math

import attrs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.config import Camera, Config, Render
from lfpipe.config.camera_pose import CameraPose, camera_focal_px
from lfpipe.render.viewer import Viewer
from tests.render import rendered
from tests.render.rendered import S, record

SIZE, EYES_MM = (640, 480), Config().screen.eyes_mm
heights, tilts = st.floats(-300, 400), st.floats(-30, 30)


def seen_px(config: Config, point_mm: np.ndarray, above_mm: float, tilt_deg: float) -> tuple[np.ndarray, float]:
    """Eyes around a point before the screen (x, y down, z) in the camera's picture, and how far apart they are in it."""
    focal_px, t = camera_focal_px(config, SIZE[0]), math.radians(tilt_deg)
    eyes = []
    for side in (0.5, -0.5):
        x, y, z = point_mm + np.array([side * EYES_MM, above_mm, 0.0])
        down, depth = y * math.cos(t) - z * math.sin(t), y * math.sin(t) + z * math.cos(t)
        eyes.append([focal_px * x / depth + SIZE[0] / 2, focal_px * down / depth + SIZE[1] / 2])
    found = np.array(eyes)
    return found, float(np.hypot(*(found[0] - found[1])))


@given(heights, tilts, st.floats(-150, 150), st.floats(-150, 150), st.floats(350, 1500))
def test_eyes_become_points_before_the_screen_and_come_back(
    above_mm: float, tilt_deg: float, x: float, y: float, z: float
) -> None:
    config = Config(camera=Camera(above_mm=above_mm, tilt_deg=tilt_deg))
    eyes_px, apart_px = seen_px(config, np.array([x, y, z]), above_mm, tilt_deg)
    pose = CameraPose.of(config, SIZE)
    if pose is None:
        return
    np.testing.assert_allclose(pose.points_mm(eyes_px, apart_px).mean(axis=0), (x, y, z), atol=1e-6 * z)
    there = pose.from_screen(eyes_px, apart_px)
    np.testing.assert_allclose(pose.from_camera(there, apart_px), eyes_px, atol=1e-6)


@pytest.mark.parametrize("depth", [0.0, 1.0])
@pytest.mark.parametrize(("above_mm", "tilt_deg"), [(200.0, 15.0), (-150.0, -10.0)])
def test_leaning_in_does_not_look_like_moving_down(above_mm: float, tilt_deg: float, depth: float) -> None:
    field = attrs.evolve(rendered.field(9, 9, 16, 16), disparity_source="none")
    known = attrs.evolve(field.geometry, baseline_mm=5.0, focus_distance_mm=600.0, focal_length_px=16.0)
    field = attrs.evolve(field, geometry=known)

    def rows(**camera: float) -> list[float]:
        subject, found = Viewer(field, Config(camera=Camera(**camera), render=Render(method="warp2", depth=depth))), []
        for k in range(300):
            z_mm = 600.0 - 200.0 * min(max((k - 90) / 60, 0.0), 1.0)
            eyes_px, apart_px = seen_px(subject.config, np.array([0.0, 0.0, z_mm]), above_mm, tilt_deg)
            seen = record(filtered_px=eyes_px, apart_px=apart_px)
            found.append(subject.viewpoints(seen, k * S // 30, k * S // 30).left[0])
        return found

    without, with_pose = rows(), rows(above_mm=above_mm, tilt_deg=tilt_deg)
    assert max(abs(row - without[89]) for row in without) > 0.5, "what it is for"
    assert abs(with_pose[-1] - with_pose[89]) < 0.1
    worst, was = (max(abs(row - found[89]) for row in found[89:]) for found in (with_pose, without))
    assert worst < 0.5 * was, "and on the way, while the distance is followed"
