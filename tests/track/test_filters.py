"""The filters: hulls, stability, bad stamps and bad measurements; the covariance of the default one
against exact arithmetic.
"""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.config import FILTER_MODULES, Track
from lfpipe.eyes import MAX_EYE_PX, MAX_STEP_NS, low_pass_gain
from lfpipe.track.filters.base import MIN_STEP_NS, EyeFilter, make_filter
from lfpipe.track.filters.mean import Mean
from lfpipe.track.filters.one_euro import OneEuro
from tests.support.examples import examples

FRAME_NS = 33_333_333
EYES = np.array([[350.0, 240.0], [290.0, 242.0]])
KINDS = tuple(FILTER_MODULES)
PREDICTING = ("predictive",)

pixels = st.floats(-1e6, 1e6)
steps = st.one_of(st.integers(-(10**18), 10**18), st.integers(1, 10**9))


def make(kind: str) -> EyeFilter:
    return make_filter(Track(filter=kind))


def settled(kind: str, frames: int = 40, start_ns: int = 0) -> EyeFilter:
    filter_ = make(kind)
    for i in range(frames):
        filter_.update(start_ns + i * FRAME_NS, EYES)
    return filter_


@pytest.mark.parametrize("kind", KINDS)
@given(
    track=st.lists(
        st.tuples(steps, st.tuples(pixels, pixels, pixels, pixels)), min_size=1, max_size=30
    )
)
@examples(60)
def test_whatever_comes_the_output_is_finite_and_bounded(
    kind: str, track: list[tuple[int, tuple[float, ...]]]
) -> None:
    filter_ = make(kind)
    t_ns = 0
    seen = []
    for step_ns, values in track:
        t_ns += step_ns
        seen.append(np.reshape(values, (2, 2)))
        position, velocity = filter_.update(t_ns, seen[-1])
        assert np.all(np.abs(position) < 1e8)
        assert np.all(np.isfinite(velocity))
        assert np.all(np.isfinite(filter_.predict(t_ns + FRAME_NS)))
        if kind not in PREDICTING:  # it only smooths
            slack = 1e-9 * (1 + np.abs(seen).max())  # a mean of equal numbers may round
            assert np.all(position >= np.min(seen, axis=0) - slack) and np.all(
                position <= np.max(seen, axis=0) + slack
            )
            assert not velocity.any()


@pytest.mark.parametrize("kind", KINDS)
@given(
    start_ns=st.sampled_from([0, 2**63 - 1 - 60 * FRAME_NS, -(2**63)]),
    late_ns=st.sampled_from([0, 1, MIN_STEP_NS - 1, -1, -FRAME_NS]),
    gap_ns=st.sampled_from([MAX_STEP_NS, 10**15, -MAX_STEP_NS, -(10**15)]),
)
def test_scale_origin_and_doubled_frames_change_nothing(
    kind: str, start_ns: int, late_ns: int, gap_ns: int
) -> None:
    """Twice as near are twice the pixels; a gap, or another clock, starts afresh."""
    plain, other = make(kind), make(kind)
    rng = np.random.default_rng(3)
    for i in range(50):
        measured = EYES + 5 * max(i - 20, 0) + rng.normal(0, 0.3, (2, 2))
        t_ns = start_ns + i * FRAME_NS
        wanted = plain.update(i * FRAME_NS, measured)
        found = other.update(np.int64(t_ns), 2 * measured)  # type: ignore[arg-type]
        np.testing.assert_allclose(found, 2 * np.array(wanted), rtol=1e-12)
        again, _ = other.update(max(t_ns + late_ns, -(2**63)), measured + 30)
        np.testing.assert_allclose(again, found[0])
        there = other.predict(t_ns + FRAME_NS), plain.predict((i + 1) * FRAME_NS)
        np.testing.assert_allclose(there[0], 2 * there[1], rtol=1e-12)
    position, velocity = plain.update(49 * FRAME_NS + gap_ns, EYES + 30)
    np.testing.assert_array_equal(position, EYES + 30)
    assert not velocity.any()


@pytest.mark.parametrize("eye", [0, 1], ids=["left", "right"])
def test_a_frame_in_which_one_eye_jumps_moves_nothing(eye: int) -> None:
    filter_ = settled("predictive")
    wrong = EYES.copy()
    wrong[eye] += (24.0, 0.0)  # 0.4 eye distances
    position, _ = filter_.update(40 * FRAME_NS, wrong)
    np.testing.assert_allclose(position, EYES, atol=0.1)


TRACKS = st.lists(
    st.tuples(st.integers(1, 150), st.tuples(*[st.floats(-1000, 1000)] * 4)),
    min_size=2,
    max_size=25,
)


@given(TRACKS, st.floats(0.1, 5), st.floats(0, 20), st.floats(0.5, 8))
def test_one_euro_is_the_published_filter(
    track: list[tuple[int, tuple[float, ...]]], least_hz: float, beta: float, slope_hz: float
) -> None:
    """Each coordinate on its own, in plain Python; the speed is of both eyes together, in distances
    between them.
    """
    filter_ = OneEuro(least_hz, beta, slope_hz)
    t_ms = 0
    at: tuple[float, ...] = (0.0,) * 4
    last = slopes = at
    for k, (step_ms, eyes) in enumerate(track):
        t_ms += step_ms
        position, velocity = filter_.update(t_ms * 10**6, np.array(eyes).reshape(2, 2))
        if k == 0:
            at, last = eyes, eyes
        else:
            w = 2 * math.pi * slope_hz * step_ms / 1e3
            slopes = tuple(
                s + w / (1 + w) * ((e - x) / (step_ms / 1e3) - s)
                for s, e, x in zip(slopes, eyes, last, strict=True)
            )
            eye_distance_px = max(math.hypot(eyes[0] - eyes[2], eyes[1] - eyes[3]), 1.0)
            speed = math.sqrt(sum(s * s for s in slopes) / 2) / eye_distance_px
            w = 2 * math.pi * (least_hz + beta * speed) * step_ms / 1e3
            at = tuple(a + w / (1 + w) * (e - a) for a, e in zip(at, eyes, strict=True))
            last = eyes
        assert np.allclose(position.ravel(), at, rtol=1e-9, atol=1e-7) and not velocity.any()
        assert np.array_equal(filter_.predict((t_ms + 50) * 10**6), position), "it predicts nothing"


def test_the_limits_of_a_measurement_are_where_they_are_said_to_be() -> None:
    eyes = np.array([[350.0, 240.0], [290.0, 240.0]])
    for where in (MAX_EYE_PX, -MAX_EYE_PX):
        filter_ = Mean(1)
        filter_.update(0, eyes)
        assert filter_.update(10**7, eyes * 0 + where)[0][0, 0] == where
        assert (
            filter_.update(2 * 10**7, eyes * 0 + np.nextafter(where, 2 * where))[0][0, 0] == where
        ), "too far away to be true"
    for step_ns, heard in ((MIN_STEP_NS - 1, False), (MIN_STEP_NS, True), (MAX_STEP_NS - 1, True)):
        filter_ = Mean(2)
        filter_.update(0, eyes)
        assert np.array_equal(filter_.update(step_ns, eyes + 2)[0], eyes + heard)
    filter_ = Mean(2)
    filter_.update(0, eyes)
    assert np.array_equal(filter_.update(MAX_STEP_NS, eyes + 2)[0], eyes + 2), "a new beginning"
    assert (
        low_pass_gain(0.5, 0.5) == 0.5
        and low_pass_gain(1.0, 0.0) == 1.0
        and low_pass_gain(0.0, 1.0) == 0.0
    )
