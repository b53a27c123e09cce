"""The gate for what an engine returns: finite and plausible, else no face."""

import math

import attrs
import numpy as np
import pytest

from lfpipe.config import Track
from lfpipe.eyes import EYES
from lfpipe.track.engine import Face
from lfpipe.track.eye_tracker import EyeTracker

FRAME_NS = 33_333_333
IMAGE = np.zeros((480, 640, 3), np.uint8)
FACE = Face(np.array([[350.0, 240.0], [290.0, 242.0]]), 0.98, (250.0, 180.0, 390.0, 330.0), 62.0, 2.0, np.ones((10, 3)))
BAD = [math.nan, math.inf, -math.inf, 1e300, -1e300]
WRONG = [
    *({"apart_px": value} for value in (*BAD, -60.0, 900.0, 0.1)),
    *({"eyes_px": np.array([[350.0, 240.0], [290.0, value]])} for value in BAD),
    {"eyes_px": np.array([[350.0, 240.0], [350.0, 240.0]])},
    *({"confidence": value} for value in (math.nan, -0.5, 2.0)),
    {"box_px": (math.nan, 0.0, 1.0, 1.0)},
    {"box_px": (340.0, 200.0, 345.0, 205.0)},
]


@pytest.mark.parametrize("change", WRONG, ids=str)
def test_an_implausible_face_is_no_face(change: dict[str, object]) -> None:
    tracker, record = EyeTracker(Track()), np.zeros((), EYES)
    for k in range(5):
        tracker.update(FACE, k * FRAME_NS)
    assert tracker.update(attrs.evolve(FACE, **change), 5 * FRAME_NS) and not tracker.seen
    tracker.write(record, IMAGE)
    assert record["face"] == 0 and record["apart_px"] == 0 and np.isfinite(record["filtered_px"]).all()
    assert tracker.update(FACE, 6 * FRAME_NS) and tracker.seen


def test_faces_of_every_distance_and_lean_are_plausible() -> None:
    for scale in (0.06, 1.0, 12.0):
        x0, y0, x1, y1 = (scale * value for value in FACE.box_px)
        assert Face(scale * FACE.eyes_px, 1.0, (x0, y0, x1, y1), scale * 62).plausible
    profile = Face(np.array([[300.0, 240.0], [296.0, 240.0]]), 0.9, (250.0, 180.0, 350.0, 330.0), 60.0)
    assert profile.plausible
