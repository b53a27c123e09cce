"""Latencies of a motion, as a session measures them, with pictures that are late by a known time
and with the filters in use.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest

from lfpipe.config import Track
from lfpipe.render.metrics import METRICS
from lfpipe.render.motion_latency import MotionLatency
from lfpipe.track.filters.base import make_filter
from lfpipe.transport.status import ROW, Row

MS = 1_000_000
DEVICE_LATENCY_MS, STEP_PX_S = 60, 200.0


def eyes_at(x: float) -> np.ndarray:
    return np.array([[x + 30, 200.0], [x - 30, 200.0]])


def swaying(t_ns: float) -> np.ndarray:
    return eyes_at(300 + 80 * math.sin(2 * math.pi * 0.5 * t_ns / 1e9))


def starting(t_ns: float) -> np.ndarray:
    """A head that rests for a second and moves for a second, to and fro, at once at STEP_PX_S."""
    t_s = t_ns / 1e9
    number = int(t_s // 2)
    away_s = max(t_s % 2 - 1, 0)
    return eyes_at(200 + STEP_PX_S * (away_s if number % 2 == 0 else 1 - away_s))


def record_px(eyes_px: np.ndarray) -> tuple[float, float, float, float]:
    (lx, ly), (rx, ry) = eyes_px.tolist()
    return lx, ly, rx, ry


def session(
    path: Callable[[float], np.ndarray],
    made_for: Callable[[int], np.ndarray] | None,
    noise_px: float,
    track: Track,
) -> Row:
    """30 Hz, presented 20 and 37 ms after the frame's stamp, light DEVICE_LATENCY_MS later; made
    for the middle of the refresh, by the filter or as made_for gives the eyes.
    """
    row = Row(np.zeros((), ROW), METRICS)
    latency = MotionLatency(row)
    filter_ = make_filter(track)
    rng = np.random.default_rng(1)
    for frame in range(900):
        stamp = frame * 33_333_333
        measured = path(stamp) + rng.normal(0, noise_px, (2, 2))
        latency.add_eyes(stamp, record_px(measured))
        filter_.update(stamp, measured)
        for refresh in range(2):
            presented = stamp + (20 + 17 * refresh) * MS
            after = (DEVICE_LATENCY_MS + 8) * MS
            eyes = made_for(presented + after) if made_for else filter_.predict(presented + after)
            latency.add_picture(presented, after, DEVICE_LATENCY_MS * MS, record_px(eyes))
    return row


@pytest.mark.parametrize(("late_ms", "noise_px"), [(0, 0.0), (40, 0.15), (-15, 0.15)])
def test_motion_latency_of_pictures_late_by_a_known_time(late_ms: int, noise_px: float) -> None:
    row = session(starting, lambda t_ns: starting(t_ns - late_ms * MS), noise_px, Track())
    assert row["onset_ns"] / MS == pytest.approx(max(late_ms, 8), abs=13.0), (
        "a picture every 17 ms; none before the motion"
    )
    row = session(swaying, lambda t_ns: swaying(t_ns - late_ms * MS), noise_px, Track())
    assert row["steady_ns"] / MS == pytest.approx(late_ms, abs=1.0)
