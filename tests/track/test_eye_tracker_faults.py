"""`EyeTracker` with an engine or a filter that gives no usable numbers."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from lfpipe.config import Track
from lfpipe.eyes import EYES
from lfpipe.track.engine import Face
from lfpipe.track.eye_tracker import EyeTracker

IMAGE = np.zeros((480, 640, 3), np.uint8)
GOOD = Face(np.array([[352.0, 240.0], [288.0, 240.0]]), 0.99, (256.0, 176.0, 384.0, 304.0))
BAD = Face(np.full((2, 2), math.nan), 0.99, (256.0, 176.0, 384.0, 304.0))


class NoEngine:
    name, model, rotated_deg = "made", "none", 0

    def detect(self, image: NDArray[np.uint8]) -> Face | None:
        return None

    def examine(self, image: NDArray[np.uint8]) -> None: ...

    def reset(self) -> None: ...

    def close(self) -> None: ...


class NanFilter:
    def update(self, t_ns: int, eyes_px: object) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return np.full((2, 2), math.nan), np.zeros((2, 2))

    def reset(self) -> None: ...


def record_of(tracker: EyeTracker) -> NDArray[np.void]:
    record = np.zeros((), EYES)
    tracker.write(record, IMAGE)
    return record


def test_an_engine_without_a_usable_face_is_named_until_it_gives_one() -> None:
    tracker = EyeTracker(Track(), engine=NoEngine())
    tracker.update(None, 0)
    assert tracker.fault == "", "nobody is there"
    tracker.update(BAD, 10**8)
    assert tracker.fault == "engine made gives faces that cannot be" and not tracker.seen
    tracker.update(None, 2 * 10**8)
    assert tracker.fault, "nobody there proves nothing"
    tracker.update(GOOD, 3 * 10**8)
    assert tracker.fault == "" and tracker.seen


def test_a_filter_that_returns_nan_is_named_and_its_eyes_are_no_face(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tracker = EyeTracker(Track(), engine=NoEngine())
    monkeypatch.setattr(tracker, "_filter", NanFilter())
    tracker.update(GOOD, 10**8)
    assert tracker.fault == "the filter gives eyes that are not finite" and not tracker.seen
    record = record_of(tracker)
    assert not record["face"] and np.isfinite(record["filtered_px"]).all()
    assert np.isfinite(record["velocity_px_s"]).all()
