"""Heads before the screen: eyes projected by hand into a camera's picture are found again where
they are.
"""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.config import Config, updated
from lfpipe.eyes import EYES
from lfpipe.track.eye_tracker import MODEL, Head, HeadEstimator
from tests.support.examples import examples

SIZE = (640, 480)
EYE_DISTANCE_MM = 63.0
T0_NS = 10**9


def rotation(yaw_deg: float, pitch_deg: float, roll_deg: float) -> np.ndarray:
    """On the screen's axes: roll towards the right shoulder first, then pitch up, then yaw to the
    right.
    """
    a, b, c = math.radians(-yaw_deg), math.radians(pitch_deg), math.radians(-roll_deg)
    y = np.array([[math.cos(a), 0, math.sin(a)], [0, 1, 0], [-math.sin(a), 0, math.cos(a)]])
    x = np.array([[1, 0, 0], [0, math.cos(b), -math.sin(b)], [0, math.sin(b), math.cos(b)]])
    z = np.array([[math.cos(c), -math.sin(c), 0], [math.sin(c), math.cos(c), 0], [0, 0, 1]])
    return np.asarray(y @ x @ z)


def record_of(config: Config, position_mm: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """What tracking would report of a head there: (x right, y up, z to the viewer) in mm, turned
    (3, 3) on these axes.
    """
    camera = config.camera
    tilt = math.radians(camera.tilt_deg)
    focal_px = SIZE[0] / 2 / math.tan(math.radians(camera.fov_deg) / 2)
    # the camera's axes on the screen's: it stands above and looks at the viewer, down by tilt
    right, ahead = np.array([-1.0, 0, 0]), np.array([0.0, -math.sin(tilt), math.cos(tilt)])
    axes = np.stack([right, np.cross(ahead, right), ahead])  # down = ahead x right
    made = np.zeros((), EYES)
    for k, side in enumerate((-0.5, 0.5)):  # the left eye first
        x, y, z = axes @ (
            position_mm + turned @ (side * EYE_DISTANCE_MM, 0, 0) - (0, camera.above_mm, 0)
        )
        made["filtered_px"][k] = focal_px * x / z + SIZE[0] / 2, focal_px * y / z + SIZE[1] / 2
    middle = axes @ (position_mm - (0, camera.above_mm, 0))
    made["eye_distance_px"] = focal_px * EYE_DISTANCE_MM / middle[2]
    # the network's points are turned against the line of sight
    sight = middle / np.linalg.norm(middle)
    axis = np.cross([0, 0, 1.0], sight)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    along = np.eye(3) + cross + cross @ cross / (1 + sight[2])  # Rodrigues
    made["head_px"] = 8 * MODEL @ (along.T @ axes @ turned @ np.diag([-1.0, -1, 1])).T + 100
    made["width_px"], made["height_px"], made["face"], made["generation"] = *SIZE, 1, 1
    return made


def head_in(config: Config, record: np.ndarray) -> Head:
    estimator = HeadEstimator(config)
    estimator.update(record, T0_NS)
    found = estimator.head(record)
    assert found is not None
    return found


@examples(60)
@given(
    st.tuples(st.floats(-150, 150), st.floats(-120, 120), st.floats(400, 1200)),
    st.tuples(st.floats(-35, 35), st.floats(-25, 25), st.floats(-30, 30)),
    st.floats(-100, 300),
    st.floats(-15, 25),
)
def test_a_head_before_the_screen_is_found_where_it_is(
    position: tuple[float, float, float],
    turn: tuple[float, float, float],
    above_mm: float,
    tilt_deg: float,
) -> None:
    config = updated(Config(), {"camera.above_mm": above_mm, "camera.tilt_deg": tilt_deg})
    record = record_of(config, np.array(position), rotation(*turn))
    found = head_in(config, record)
    np.testing.assert_allclose(found.position_mm, position, atol=3)
    np.testing.assert_allclose((found.yaw_deg, found.pitch_deg, found.roll_deg), turn, atol=0.6)
    for eye_mm, side in ((found.left_mm, -0.5), (found.right_mm, 0.5)):
        expected = np.array(position) + rotation(*turn) @ (side * EYE_DISTANCE_MM, 0, 0)
        np.testing.assert_allclose(eye_mm, expected, atol=3)


def test_the_depth_is_smoothed_and_forgotten_after_a_loss() -> None:
    config = Config()
    near, far = (
        record_of(config, np.array([0.0, 0, z]), rotation(0, 0, 0)) for z in (500.0, 1000.0)
    )
    estimator = HeadEstimator(config)
    estimator.update(near, T0_NS)
    estimator.update(far, T0_NS + 33_000_000)
    head = estimator.head(far)
    assert head is not None and 500 < head.position_mm[2] < 700
    far["generation"] = 2  # somebody else
    estimator.update(far, T0_NS + 66_000_000)
    head = estimator.head(far)
    assert head is not None and head.position_mm[2] == pytest.approx(1000)


def test_without_a_face_or_with_a_wrong_one_there_is_no_head() -> None:
    estimator = HeadEstimator(Config())
    record = record_of(Config(), np.array([0.0, 0, 600]), rotation(0, 0, 0))
    assert estimator.head(record) is None
    estimator.update(record, T0_NS)
    record["filtered_px"] = np.nan
    assert estimator.head(record) is None
    record["face"] = 0
    assert estimator.head(record) is None
