"""How the head is turned: of the model itself exactly, of portraits whose heads are turned by some 30 degrees roughly."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfpipe.track import head_pose
from lfpipe.track.head_pose import head_turn
from lfpipe.track.litert_engine import LitertEngine
from lfpipe.track.mediapipe_engine import MediapipeEngine
from tests.track.people import FACES, needs_faces, needs_mediapipe

MODEL = head_pose._MODEL
yaws, pitches, rolls = st.floats(-85, 85), st.floats(-80, 80), st.floats(-85, 85)


def turned(yaw_deg: float, pitch_deg: float, roll_deg: float) -> np.ndarray:
    """The rotation on the picture's axes, from the definition: of points about the viewer's axes (right, up, out of the back of
    the head), roll first, then pitch, then yaw; the viewer's right is the picture's left."""
    a, b, c = (math.radians(v) for v in (-yaw_deg, pitch_deg, -roll_deg))
    about_y = np.array([[math.cos(a), 0, math.sin(a)], [0, 1, 0], [-math.sin(a), 0, math.cos(a)]])
    about_x = np.array([[1, 0, 0], [0, math.cos(b), -math.sin(b)], [0, math.sin(b), math.cos(b)]])
    about_z = np.array([[math.cos(c), -math.sin(c), 0], [math.sin(c), math.cos(c), 0], [0, 0, 1]])
    axes = np.diag([-1.0, -1.0, 1.0])
    return axes @ about_y @ about_x @ about_z @ axes


@settings(max_examples=60)
@given(yaws, pitches, rolls, st.floats(0.1, 40), st.floats(-500, 500))
def test_the_model_turned_is_measured_as_it_was_turned(yaw: float, pitch: float, roll: float, scale: float, shift: float) -> None:
    points = scale * MODEL @ turned(yaw, pitch, roll).T + shift
    np.testing.assert_allclose(head_turn(points), (yaw, pitch, roll), atol=1e-5)


def test_the_signs_are_those_that_are_documented() -> None:
    nose = MODEL[0]
    right, up, tilted = turned(20, 0, 0) @ nose, turned(0, 20, 0) @ nose, turned(0, 0, 20) @ MODEL[1]
    assert right[0] < nose[0] - 1  # the person's right is the picture's left
    assert up[1] < nose[1] - 1  # up is smaller y
    assert tilted[0] < MODEL[1][0] - 1  # the forehead moves to the right shoulder


@settings(max_examples=30)
@given(st.lists(st.floats(-1e6, 1e6), min_size=30, max_size=30))
def test_whatever_the_points_the_angles_are_numbers(values: list[float]) -> None:
    assert all(math.isfinite(value) for value in head_turn(np.array(values).reshape(10, 3)))


@needs_faces
@pytest.mark.parametrize("engine", [LitertEngine, pytest.param(MediapipeEngine, marks=needs_mediapipe)])
def test_portraits_turned_to_either_side(engine: type[LitertEngine]) -> None:
    found = engine()
    for kind, low, high in (("1m", -8, 8), ("3m", 10, 45), ("4m", -45, -10)):  # straight, to their right, to their left
        for person in ("02", "04", "05"):
            picture = cv2.imread(str(next((FACES / "imm").glob(f"{person}-{kind}.*"))))
            found.reset()
            faces = [found.detect(picture) for _ in range(3)]
            face = faces[-1]
            assert face is not None and low <= face.turn_deg[0] <= high, (person, kind, face)
            assert abs(face.turn_deg[1]) < 12 and abs(face.turn_deg[2]) < 8
    found.close()
