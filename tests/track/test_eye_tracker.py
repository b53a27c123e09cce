"""`EyeTracker`: what an engine or a filter gives is finite and plausible, else it is no face."""

import math
from types import SimpleNamespace
from typing import Any

import attrs
import numpy as np
import pytest
from numpy.typing import NDArray

from lfpipe.config import Track
from lfpipe.eyes import EYES
from lfpipe.track.engine import Face
from lfpipe.track.eye_tracker import EyeTracker, OcclusionHold

FRAME_NS = 33_333_333
IMAGE = np.zeros((480, 640, 3), np.uint8)
FACE = Face(
    np.array([[350.0, 240.0], [290.0, 242.0]]),
    0.98,
    (250.0, 180.0, 390.0, 330.0),
    62.0,
    2.0,
    np.ones((10, 3)),
)
BAD = [math.nan, math.inf, -math.inf, 1e300, -1e300]
WRONG = [
    *({"eye_distance_px": value} for value in (*BAD, -60.0, 900.0, 0.1)),
    *({"eyes_px": np.array([[350.0, 240.0], [290.0, value]])} for value in BAD),
    {"eyes_px": np.array([[350.0, 240.0], [350.0, 240.0]])},
    *({"confidence": value} for value in (math.nan, -0.5, 2.0)),
    {"box_px": (math.nan, 0.0, 1.0, 1.0)},
    {"box_px": (340.0, 200.0, 345.0, 205.0)},
]


ENGINE: Any = SimpleNamespace(name="made", model="none", rotated_deg=0, reset=lambda: None)


def record_of(tracker: EyeTracker) -> NDArray[np.void]:
    record = np.zeros((), EYES)
    tracker.write(record, IMAGE)
    assert np.isfinite(record["filtered_px"]).all() and np.isfinite(record["velocity_px_s"]).all()
    return record


@pytest.mark.parametrize("change", WRONG, ids=str)
def test_eye_tracker_takes_an_implausible_face_for_none(change: dict[str, Any]) -> None:
    tracker = EyeTracker(Track(), engine=ENGINE)
    for k in range(5):
        tracker.update(FACE, k * FRAME_NS)
    assert tracker.update(attrs.evolve(FACE, **change), 5 * FRAME_NS) and not tracker.seen
    record = record_of(tracker)
    assert record["face"] == record["eye_distance_px"] == 0
    assert tracker.update(FACE, 6 * FRAME_NS) and tracker.seen


def test_faces_of_every_distance_and_lean_are_plausible() -> None:
    for scale in (0.06, 1.0, 12.0):
        x0, y0, x1, y1 = (scale * value for value in FACE.box_px)
        assert Face(scale * FACE.eyes_px, 1.0, (x0, y0, x1, y1), scale * 62).plausible
    profile = Face(
        np.array([[300.0, 240.0], [296.0, 240.0]]), 0.9, (250.0, 180.0, 350.0, 330.0), 60.0
    )
    assert profile.plausible


@pytest.mark.parametrize(("speed_px_s", "held"), [(10.0, True), (300.0, False)])
def test_a_face_that_moves_is_not_held_when_its_confidence_falls(
    speed_px_s: float, held: bool
) -> None:
    """It leaves the picture; a hand comes before a face that rests. Eyes 60 px apart."""
    hidden = OcclusionHold()
    hidden.reset(20.0, (300.0, 200.0))
    for k in range(1, 20):
        hidden.update(20.0, (300.0 + speed_px_s * k / 30, 200.0), 60.0, 1 / 30, speed_px_s)
    hidden.update(7.0, (300.0 + speed_px_s * 20 / 30, 200.0), 60.0, 1 / 30, speed_px_s)
    assert hidden.held == held


def test_eye_tracker_names_an_engine_without_a_usable_face_until_it_gives_one() -> None:
    tracker = EyeTracker(Track(), engine=ENGINE)
    tracker.update(None, 0)
    assert tracker.fault == "", "nobody is there"
    tracker.update(attrs.evolve(FACE, eyes_px=np.full((2, 2), math.nan)), 10**8)
    assert tracker.fault == "engine made returned an impossible face" and not tracker.seen
    tracker.update(None, 2 * 10**8)
    assert tracker.fault, "nobody there proves nothing"
    tracker.update(FACE, 3 * 10**8)
    assert tracker.fault == "" and tracker.seen


def test_eye_tracker_names_a_filter_that_returns_nan_and_its_eyes_are_no_face(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tracker = EyeTracker(Track(), engine=ENGINE)
    no_eyes = np.full((2, 2), math.nan), np.zeros((2, 2))
    made = SimpleNamespace(update=lambda *_: no_eyes, reset=lambda: None, restarts_after_loss=False)
    monkeypatch.setattr(tracker, "_filter", made)
    tracker.update(FACE, 10**8)
    assert tracker.fault == "the filter returned NaN or infinity" and not tracker.seen
    assert not record_of(tracker)["face"]
