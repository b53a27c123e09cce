"""Latencies of a motion, as a session measures them, on pictures that are late by a known time."""

import math

import numpy as np
import pytest

from lfpipe.render.motion_latency import MotionLatency

MS = 1_000_000


def eyes(t_ns: float) -> np.ndarray:
    """A head that sways."""
    x = 300 + 80 * math.sin(2 * math.pi * 0.5 * t_ns / 1e9)
    return np.array([[x + 30, 200.0], [x - 30, 200.0]])


@pytest.mark.parametrize(("late_ms", "noise_px"), [(0, 0.0), (40, 0.15), (-15, 0.15)])
def test_both_latencies_of_known_pictures(late_ms: int, noise_px: float) -> None:
    latency, rng = MotionLatency(), np.random.default_rng(1)
    for frame in range(300):
        stamp = frame * 33 * MS
        latency.measured(stamp, eyes(stamp) + rng.normal(0, noise_px, (2, 2)))
        for refresh in range(2):  # presented 20 and 36 ms after the stamp, seen 58 ms later, made for 8 ms after that
            presented = stamp + (20 + 16 * refresh) * MS
            latency.pictured(stamp, presented, 66 * MS, 58 * MS, eyes(presented + (66 - late_ms) * MS))
    assert latency.steady_ns / MS == pytest.approx(late_ms, abs=1.0)
    assert latency.onset_ns / MS == pytest.approx(16.5 + 20 + 58, abs=0.1)


def test_a_still_viewer_and_one_who_leaves_give_no_steady_latency() -> None:
    latency = MotionLatency()
    for frame in range(60):
        stamp = frame * 33 * MS
        latency.measured(stamp, None if frame % 10 == 9 else eyes(0))
        latency.pictured(stamp, stamp + 20 * MS, 8 * MS, 0, eyes(0) + 1)
    assert latency.steady_ns == 0 and latency.onset_ns > 0


def test_the_first_frame_of_a_session_does_not_count_and_the_next_have_equal_weights() -> None:
    latency, ways_ms = MotionLatency(), (900, 20, 60, 25)
    for frame, way_ms in enumerate(ways_ms):
        stamp = (frame + 1) * 40 * MS
        latency.measured(stamp, eyes(stamp))
        latency.pictured(stamp, stamp + way_ms * MS, 0, 0, eyes(0))
    assert latency.onset_ns / MS == pytest.approx(20 + sum(ways_ms[1:]) / 3, abs=0.001)
