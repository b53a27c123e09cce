"""The filters: hulls, stability, bad stamps and bad measurements; the covariance of the default one
against exact arithmetic.
"""

import itertools
import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from lfpipe.config import FILTER_MODULES, Track
from lfpipe.eyes import MAX_EYE_PX, MAX_STEP_NS, low_pass_gain
from lfpipe.track.filters import learnt_motion, models, noise
from lfpipe.track.filters.base import MIN_STEP_NS, EyeFilter
from lfpipe.track.filters.half_distance import HalfDistance
from lfpipe.track.filters.imm import ImmFilter
from lfpipe.track.filters.mean import Mean
from lfpipe.track.filters.one_euro import OneEuro
from lfpipe.track.filters.outliers import OutlierGate
from lfpipe.track.filters.table import make_filter
from tests.support.examples import examples

FRAME_NS = 33_333_333
EYES = np.array([[350.0, 240.0], [290.0, 242.0]])
KINDS = tuple(FILTER_MODULES)
PREDICTING = tuple(kind for kind in KINDS if make_filter(Track(filter=kind)).predicts)

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
@pytest.mark.parametrize("where", [(0, 0), (1, 1), slice(None)])
def test_one_bad_measurement_is_forgotten_within_three_good_ones(
    kind: str, bad: float, where: tuple[int, int] | slice
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
@pytest.mark.parametrize("step_ns", [0, 1, MIN_STEP_NS - 1, -1, -FRAME_NS])
def test_doubled_and_late_frames_change_nothing(kind: str, step_ns: int) -> None:
    filter_ = settled(kind)
    before = filter_.predict(41 * FRAME_NS)
    position, _ = filter_.update(39 * FRAME_NS + step_ns, EYES + 30)
    np.testing.assert_allclose(position, EYES)
    np.testing.assert_array_equal(filter_.predict(41 * FRAME_NS), before)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("step_ns", [MAX_STEP_NS, 10**15, -MAX_STEP_NS, -(10**15)])
def test_gap_and_another_clock_start_afresh(kind: str, step_ns: int) -> None:
    filter_ = settled(kind)
    position, velocity = filter_.update(39 * FRAME_NS + step_ns, EYES + 30)
    np.testing.assert_array_equal(position, EYES + 30)
    assert not velocity.any()


@pytest.mark.parametrize("kind", KINDS)
def test_stamps_near_the_end_of_int64_are_as_good_as_any(kind: str) -> None:
    late_ns = 2**63 - 1 - 60 * FRAME_NS
    early, late = make(kind), make(kind)
    rng = np.random.default_rng(3)
    for i in range(50):
        measured = EYES + 5 * i + rng.normal(0, 0.3, (2, 2))
        a = early.update(i * FRAME_NS, measured)
        b = late.update(np.int64(late_ns + i * FRAME_NS), measured)  # type: ignore[arg-type]
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(
        early.predict(50 * FRAME_NS), late.predict(late_ns + 50 * FRAME_NS)
    )
    position, _ = late.update(-(2**63), EYES)  # the difference alone is beyond int64
    np.testing.assert_array_equal(position, EYES)


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


def missed_px(
    filter_: EyeFilter, x_px: Callable[[float], float], frames: range, ahead_s: float = 0.1
) -> float:
    """RMS of the error ahead_s after each frame of the second half, of eyes that move sideways."""
    ahead = predicted(filter_, sideways(x_px), frames, ahead_s)[..., 0].mean(axis=(1, 2))
    missed = ahead - [x_px(k / 30 + ahead_s) for k in frames]
    return float(np.sqrt(np.mean(np.square(missed[len(frames) // 2 + 1 :]))))


@pytest.mark.parametrize("speed_px_s", [150, 450, -450])
def test_a_face_that_enters_at_speed_is_predicted_from_its_third_frame_on(
    speed_px_s: float,
) -> None:
    path = sideways(lambda t_s: speed_px_s * t_s)
    ahead = predicted(make("predictive"), path, range(3), 0.1, noise_px=0)[-1, 0, :, 0].mean()
    assert ahead / (speed_px_s * 5 / 30) == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize(("size_px", "hz", "most_px"), [(80, 0.4, 2), (8, 4, 12.5)])
def test_acceleration_is_used_where_it_has_improved_predictions(
    size_px: float, hz: float, most_px: float
) -> None:
    """Without it, 2.75 px; a shaking head turns before an acceleration carries that far."""
    assert missed_px(make_filter(Track(), 0.05), swaying(size_px, hz), range(360)) < most_px


def test_landmarks_that_jump_do_not_change_how_far_acceleration_is_used() -> None:
    filter_, untouched = make("predictive"), make("predictive")
    for one in (filter_, untouched):
        missed_px(one, swaying(80, 0.4), range(240))
    filter_.update(round(8e9), EYES + np.array([900, -700]))
    after = [missed_px(one, swaying(80, 0.4), range(241, 360)) for one in (filter_, untouched)]
    assert after[0] < 1.1 * after[1]


def test_head_scale_does_not_matter() -> None:
    """Twice as near, twice the pixels: the same filter, twice the numbers."""
    near, far = make("predictive"), make("predictive")
    rng = np.random.default_rng(6)
    for i in range(50):
        measured = EYES + 8 * max(i - 20, 0) + rng.normal(0, 0.3, (2, 2))
        a, _ = far.update(i * FRAME_NS, measured)
        b, _ = near.update(i * FRAME_NS, 2 * measured)
    np.testing.assert_allclose(2 * a, b, rtol=1e-12)


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


def test_a_head_that_rolls_at_an_even_rate_is_predicted_without_lag() -> None:
    """By 1 rad/s, 80 ms ahead; a single frame whose one eye is wrong turns nothing."""
    filter_ = make_filter(Track(), 0.08)
    half_px = 30.0

    def rolled(angle: float) -> np.ndarray:
        aside = half_px * np.array((math.cos(angle), math.sin(angle)))
        return np.array((320.0, 240.0)) + np.stack((aside, -aside))

    for k in range(60):
        filter_.update(k * FRAME_NS, rolled(k * FRAME_NS / 1e9))
    seen_ns = 59 * FRAME_NS + 80_000_000
    off_px = np.abs(filter_.predict(seen_ns) - rolled(seen_ns / 1e9)).max()
    assert off_px < 0.15 * 0.08 * half_px

    half = HalfDistance((half_px, 0.0))
    for wrong_px in (0.0, 8.0, 0.0, 0.0):
        half.update((half_px, wrong_px), 0.01, 1 / 30)
    assert math.hypot(*half.velocity) < 1.0


@pytest.mark.parametrize(("rate_hz", "most"), [(0.5, 1.02), (3.5, 0.7)], ids=["sways", "shakes"])
def test_the_last_steps_predict_a_head_that_repeats_itself(
    rate_hz: float, most: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Error of the delay of 80 ms against that of the models alone."""
    learnt = missed_px(make_filter(Track(), 0.08), swaying(18, rate_hz), range(300))
    monkeypatch.setattr(learnt_motion, "PRIOR", 1e30)
    alone = missed_px(make_filter(Track(), 0.08), swaying(18, rate_hz), range(300))
    assert learnt < most * alone


def test_a_head_that_is_often_far_from_its_prediction_is_no_outlier() -> None:
    """As one that shakes fast; 24 px are 0.4 eye distances."""
    calm, shaken = OutlierGate(), OutlierGate()
    for _ in range(15):
        assert not calm.rejects((300.0, 200.0), (299.0, 200.0), 1.0, 60.0, 1 / 30)
        assert not shaken.rejects((300.0, 200.0), (286.0, 200.0), 14.0, 60.0, 1 / 30)
    assert calm.rejects((324.0, 200.0), (300.0, 200.0), 24.0, 60.0, 1 / 30)
    assert not shaken.rejects((324.0, 200.0), (300.0, 200.0), 24.0, 60.0, 1 / 30)


def lags_ms(x_px: Callable[[float], float], speed_px_s: float) -> float:
    """How late the prediction of a delay of 80 ms is, where eyes move as x_px: the error that
    follows the speed, over the speed.
    """
    frames, ahead_s = range(30 * 12), 0.03 + 0.08
    ahead = predicted(make_filter(Track(), 0.08), sideways(x_px), frames, ahead_s, noise_px=0.3)
    late, moved = [], []
    for k in frames[60:]:
        seen_s = k / 30 + ahead_s
        speed = (x_px(seen_s + 1e-3) - x_px(seen_s - 1e-3)) / 2e-3
        # of a turn, the speed has not yet been seen
        if abs(x_px(k / 30 - 0.4) - x_px(seen_s)) >= 0.4 * abs(speed_px_s):
            late.append((x_px(seen_s) - ahead[k, 0, :, 0].mean()) * speed)
            moved.append(speed * speed)
    return float(1e3 * sum(late) / sum(moved))


@pytest.mark.parametrize(
    ("speed_px_s", "most_ms"), [(40, 16), (100, 6), (150, 4), (300, 2.5), (450, 2)]
)
def test_a_head_at_constant_speed_is_not_late(speed_px_s: float, most_ms: float) -> None:
    """Forth and back, with a second of rest between: 1.4 s each way."""

    def x_px(t_s: float) -> float:
        phase = t_s % 4.8
        way = min(phase, 1.4) if phase < 2.4 else max(3.8 - phase, 0.0)
        return speed_px_s * way

    assert abs(lags_ms(x_px, speed_px_s)) < most_ms


@pytest.mark.parametrize(("sway_hz", "most_ms"), [(0.5, 8), (1, 8), (2, 45)])
def test_a_swaying_head_is_predicted_over_a_loop_of_80_ms(sway_hz: float, most_ms: float) -> None:
    """Without prediction it would be 110 ms."""
    assert lags_ms(swaying(60, sway_hz), 0.0) < most_ms


@pytest.mark.parametrize("rate_hz", [30, 60, 240])
def test_a_step_that_a_second_frame_confirms_is_followed(rate_hz: int) -> None:
    filter_ = make("predictive")
    for i in range(rate_hz):
        filter_.update(round(i * 1e9 / rate_hz), EYES)
    for i in range(rate_hz, rate_hz + 2):
        position, _ = filter_.update(round(i * 1e9 / rate_hz), EYES + 40)
    assert np.abs(position - EYES - 40).max() < 8


def test_a_velocity_is_trusted_over_a_long_loop_as_far_as_it_carries() -> None:
    """Nodding at 1.5 Hz: with 120 ms of loop a straight line overshoots, and would be worse than no
    prediction.
    """
    short, loop = (
        missed_px(make_filter(Track(), device_latency_s), swaying(15, 1.5), range(480), 0.17)
        for device_latency_s in (0.0, 0.12)
    )
    assert loop < 0.9 * short


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


def exact(
    q: float, r: float, dt_s: float, steps: int, start: tuple[float, ...]
) -> tuple[Fraction, ...]:
    """The textbook recursion in rational numbers: P = F P F' + Q, then P - K H P."""
    a, b, c = (Fraction(value) for value in start)
    fq, fr, d = Fraction(q), Fraction(r), Fraction(dt_s)
    for _ in range(steps):
        a, b, c = a + 2 * b * d + c * d * d + fq * d**3 / 3, b + c * d + fq * d * d / 2, c + fq * d
        s = a + fr
        a, b, c = a - a * a / s, b - a * b / s, c - b * b / s
    return a, b, c


def test_the_default_filter_keeps_its_digits_and_stays_positive(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One of its models, over and far beyond its settings: acceleration, noise in eye distances,
    time between frames.
    """
    eyes = np.array([[350.0, 240.0], [290.0, 242.0]])
    q_px = math.dist(*eyes.tolist()) ** 2
    monkeypatch.setattr(models, "STAY_S", 1e300)
    monkeypatch.setattr(noise, "RATE_POWER", 0.0)
    for q, deviation, dt_ns in itertools.product(
        (1e-6, 1.0, 1200.0, 1e9), (1e-6, 1e-3, 1.0), (200_000, 4_166_667, 400_000_000)
    ):
        monkeypatch.setattr(models, "ACCELERATIONS", (q,))
        monkeypatch.setattr(noise, "FIRST_NOISE", deviation)
        monkeypatch.setattr(noise, "MIN_NOISE", deviation)
        filter_ = ImmFilter()
        filter_.update(0, eyes)
        one = filter_._models.models[1]
        start = (one.a, one.b, one.c)
        r = filter_._noise.midpoint_variance
        for k in range(1, 8):
            filter_.update(k * dt_ns, eyes)
            assert one.a > 0 and one.c >= 0 and one.b**2 <= one.a * one.c * (1 + 1e-9)
        for value, truth in zip(
            (one.a, one.b, one.c), exact(q * q_px, r, dt_ns / 1e9, 7, start), strict=True
        ):
            assert abs(float(Fraction(value) / truth - 1)) < 1e-3, (q, deviation, dt_ns)
