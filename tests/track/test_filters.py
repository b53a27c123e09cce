"""The filters: hulls, stability, bad stamps and bad measurements; the covariance of the default one
against exact arithmetic.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

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


Motion = Callable[[float], Any]


def predicted(
    filter_: EyeFilter,
    moved: Motion,
    frames: range,
    *ahead_s: float,
    rate_hz: float = 30,
    noise_px: float = 0.15,
) -> NDArray[np.float64]:
    """How far from EYES the eyes are predicted ahead_s after each frame: (frame, ahead, eye, x y).

    moved: how far from EYES they are at a time in s, as it is broadcast to (2, 2).
    """
    rng = np.random.default_rng(4)
    found = []
    for k in frames:
        noise = rng.normal(0, noise_px, (2, 2))
        filter_.update(round(k * 1e9 / rate_hz), EYES + moved(k / rate_hz) + noise)
        found.append([filter_.predict(round((k / rate_hz + s) * 1e9)) - EYES for s in ahead_s])
    return np.array(found)


def sideways(x_px: Callable[[float], float]) -> Motion:
    return lambda t_s: np.array((x_px(t_s), 0.0))


def swaying(size_px: float, hz: float) -> Callable[[float], float]:
    return lambda t_s: size_px * math.sin(2 * math.pi * hz * t_s)


@pytest.mark.parametrize("kind", PREDICTING)
@pytest.mark.parametrize("velocity_px_s", [60.0, -200.0, 450.0])
def test_prediction_of_an_even_motion_is_where_it_goes(kind: str, velocity_px_s: float) -> None:
    """Without noise, 80 ms ahead: within a tenth of what the eyes move in that time."""
    path = sideways(lambda t_s: velocity_px_s * t_s)
    ahead = predicted(make(kind), path, range(45), 0.08, noise_px=0)[-1, 0]
    assert ahead[:, 1] == pytest.approx(0, abs=0.1)
    expected = velocity_px_s * (44 / 30 + 0.08)
    assert ahead[:, 0] == pytest.approx(expected, abs=abs(velocity_px_s) * 0.008)


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
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e18, 5e-324])
@pytest.mark.parametrize("where", [(1, 1)])
def test_one_bad_measurement_is_forgotten_within_three_good_ones(
    kind: str, bad: float, where: tuple[int, int]
) -> None:
    fresh = make(kind)
    filter_ = settled(kind)
    untouched = settled(kind)
    assert np.isnan(fresh.update(0, np.full((2, 2), np.nan))[0]).all()
    np.testing.assert_array_equal(fresh.update(FRAME_NS, EYES), (EYES, np.zeros((2, 2))))
    measured = EYES.copy()
    measured[where] = bad
    position, velocity = filter_.update(40 * FRAME_NS, measured)
    assert np.all(np.isfinite(position))
    assert np.all(np.isfinite(velocity))
    for i in (41, 42, 43):
        position, velocity = filter_.update(i * FRAME_NS, EYES)
        expected, _ = untouched.update(i * FRAME_NS, EYES)
    if bad == 5e-324 and kind == "mean":  # a number like any other: the mean keeps it for k frames
        expected = (4 * EYES + measured) / 5
    if bad == 5e-324 and kind != "mean":
        assert np.all(np.abs(position - expected) < 0.12 * np.abs(measured - EYES).max())
    else:
        np.testing.assert_allclose(position, expected, rtol=1e-12)


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


@pytest.mark.parametrize("kind", KINDS)
def test_no_drift_over_any_number_of_updates(kind: str) -> None:
    """Once the whole state comes back, bit for bit, after a few updates, 10^8 more change
    nothing.
    """
    filter_ = settled(kind, 20_000)
    before = _state(filter_)
    period = None
    for i in range(1, 33):
        filter_.update((19_999 + i) * FRAME_NS, EYES)
        if _state(filter_) == before:
            period = i
            break
    assert period is not None, "the state does not come back"
    np.testing.assert_allclose(filter_.predict(20_040 * FRAME_NS), EYES, rtol=1e-14)


def _state(filter_: object) -> str:
    """Everything a filter and its parts hold but stamps."""
    return repr(
        {
            key: _state(value) if hasattr(value, "__dict__") else repr(value)
            for key, value in vars(filter_).items()
            if key not in ("_t_ns", "_used_ns", "_predictions")
        }
    )


@pytest.mark.parametrize("rate_hz", [30, 60, 120, 240])
def test_one_wrong_landmark_is_not_magnified(rate_hz: int) -> None:
    """One frame is off by half a distance between the eyes.

    It used to be predicted 1.2 to 3.9 such distances away.
    """
    wrong = sideways(lambda t_s: 30.0 * (t_s == 3))
    off = predicted(make("predictive"), wrong, range(4 * rate_hz), 0.1, rate_hz=rate_hz)
    assert np.abs(off[3 * rate_hz :]).max() < 0.05 * 60


@pytest.mark.parametrize("eye", [0, 1], ids=["left", "right"])
def test_a_frame_in_which_one_eye_jumps_moves_nothing(eye: int) -> None:
    filter_ = settled("predictive")
    wrong = EYES.copy()
    wrong[eye] += (24.0, 0.0)  # 0.4 eye distances
    position, _ = filter_.update(40 * FRAME_NS, wrong)
    np.testing.assert_allclose(position, EYES, atol=0.1)


@pytest.mark.parametrize("rate_hz", [60, 120])
def test_the_step_of_a_still_head_is_no_more_than_the_means_at_high_rates(rate_hz: int) -> None:
    """A head is never quite still: it sways by a few px, slowly. Noise of 0.3 px."""
    path, frames = sideways(swaying(3, 0.15)), range(10 * rate_hz)
    mean, predictive = (
        predicted(make(kind), path, frames, 0.02, rate_hz=rate_hz, noise_px=0.3)[2 * rate_hz :]
        for kind in ("mean", "predictive")
    )
    assert np.square(np.diff(predictive, axis=0)).mean() <= np.square(np.diff(mean, axis=0)).mean()


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


@given(TRACKS, st.integers(1, 8))
def test_a_mean_is_that_of_the_last_k(track: list[tuple[int, tuple[float, ...]]], k: int) -> None:
    filter_ = Mean(k)
    t_ms = 0
    for n, (step_ms, eyes) in enumerate(track, 1):
        t_ms += step_ms
        position, velocity = filter_.update(t_ms * 10**6, np.array(eyes).reshape(2, 2))
        window = np.array([one for _, one in track[max(0, n - k) : n]])
        assert np.allclose(position.ravel(), window.mean(axis=0), atol=1e-9) and not velocity.any()


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
