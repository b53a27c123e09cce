"""`EyeTracker`: results of engine and filter are finite and plausible, or the face is discarded."""

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
    assert tracker.update(attrs.evolve(FACE, **change), 5 * FRAME_NS) and not tracker.has_face
    record = record_of(tracker)
    assert record["face"] == record["eye_distance_px"] == 0
    assert tracker.update(FACE, 6 * FRAME_NS) and tracker.has_face


@pytest.mark.parametrize(("speed_px_s", "held"), [(10.0, True), (300.0, False)])
def test_a_face_that_moves_is_not_held_when_its_confidence_falls(
    speed_px_s: float, held: bool
) -> None:
    """It leaves the picture; a hand comes before a face that rests. Eyes 60 px apart."""
    hidden = OcclusionHold()
    hidden.reset(20.0, eyes_at(300.0))
    for k in range(1, 20):
        hidden.update(20.0, eyes_at(300.0 + speed_px_s * k / 30), 60.0, 1 / 30, speed_px_s)
    hidden.update(7.0, eyes_at(300.0 + speed_px_s * 20 / 30), 60.0, 1 / 30, speed_px_s)
    assert hidden.is_holding == held


@pytest.mark.parametrize("left_px", [0.0, 15.0], ids=["dark", "hand"])
def test_a_moving_face_is_followed_by_the_eye_that_no_hand_pulls(left_px: float) -> None:
    """Darkness moves neither eye; both froze the picture of a face below an eye distance a second,
    and a hand pulled a faster one. Eyes 60 px apart.
    """
    hidden = OcclusionHold()
    hidden.reset(20.0, eyes_at(300.0))
    for k in range(1, 40):
        x = 300.0 + 1.2 * k
        covered = k >= 20
        logit = 7.0 if covered else 20.0
        hidden.update(logit, eyes_at(x, left_px * covered), 60.0, 1 / 30, 36.0)
        assert hidden.eyes_px == pytest.approx(eyes_at(x)) and not hidden.is_holding


def eyes_at(x: float, left_px: float = 0.0) -> tuple[float, float, float, float]:
    """Eyes 60 px apart. left_px: what a hand adds to the left one."""
    return x + 30.0 + left_px, 200.0, x - 30.0, 200.0


@pytest.mark.parametrize(
    ("x", "left_px", "held"),
    [(300.0, 40.0, True), (318.0, 22.0, True), (326.0, 0.0, False), (326.0, 15.0, False)],
    ids=["one eye", "both, one more", "the head", "the head, and one eye more"],
)
def test_a_hold_ends_where_both_eyes_move_by_more_than_a_hand_pulls_them(
    x: float, left_px: float, held: bool
) -> None:
    """Hands pull both eyes of real faces by a third of their distance at most, one by two."""
    hidden = OcclusionHold()
    hidden.reset(20.0, eyes_at(300.0))
    assert not hidden.update(5.0, eyes_at(300.0), 60.0, 1 / 30, 0.0) and hidden.is_holding
    assert hidden.update(5.0, eyes_at(x, left_px), 60.0, 1 / 30, 0.0) != held
    assert hidden.is_holding == held


def test_the_face_after_a_hold_is_the_same_and_its_filter_starts_anew() -> None:
    """Another generation would count as another viewer."""
    tracker = EyeTracker(Track(), engine=ENGINE)
    sure = attrs.evolve(FACE, confidence=1 - 1e-8)
    tracker.update(sure, 0)
    before = record_of(tracker)
    pulled = FACE.eyes_px + np.array((15.0, 0.0))
    tracker.update(attrs.evolve(FACE, eyes_px=pulled), 30_000_000)
    np.testing.assert_array_equal(record_of(tracker)["filtered_px"], before["filtered_px"])
    tracker.update(attrs.evolve(sure, eyes_px=pulled), 60_000_000)
    after = record_of(tracker)
    np.testing.assert_array_equal(after["filtered_px"], pulled)
    assert after["generation"] == before["generation"]


def test_eye_tracker_names_an_engine_without_a_usable_face_until_it_gives_one() -> None:
    tracker = EyeTracker(Track(), engine=ENGINE)
    tracker.update(None, 0)
    assert tracker.fault == "", "nobody is there"
    tracker.update(attrs.evolve(FACE, eyes_px=np.full((2, 2), math.nan)), 10**8)
    assert tracker.fault == "engine made returned an impossible face" and not tracker.has_face
    tracker.update(None, 2 * 10**8)
    assert tracker.fault, "nobody there proves nothing"
    tracker.update(FACE, 3 * 10**8)
    assert tracker.fault == "" and tracker.has_face


def test_eye_tracker_names_a_filter_that_returns_nan_and_its_eyes_are_no_face(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tracker = EyeTracker(Track(), engine=ENGINE)
    no_eyes = np.full((2, 2), math.nan), np.zeros((2, 2))
    made = SimpleNamespace(update=lambda *_: no_eyes, reset=lambda: None, restarts_after_loss=False)
    monkeypatch.setattr(tracker, "_filter", made)
    tracker.update(FACE, 10**8)
    assert tracker.fault == "the filter returned NaN or infinity" and not tracker.has_face
    assert not record_of(tracker)["face"]
