"""Lost and found again: nothing jumps."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from lfpipe.render.presence import AWAY_S, BACK_S, HOLD_S, EyeEasing

STEP_NS = 16_666_667
NEUTRAL, EYES = np.array([4.0, 4.0, 4.0, 4.0]), np.array([1.0, 7.0, 1.0, 7.0])


def run(
    glide: EyeEasing, start: int, count: int, eyes: np.ndarray | None, generation: int = 0, step_ns: int = STEP_NS
) -> np.ndarray:
    """The positions shown at count refreshes."""
    target = None if eyes is None else tuple(eyes.tolist())
    return np.array([glide.at((start + i) * step_ns, target, tuple(NEUTRAL.tolist()), generation) for i in range(count)])


def test_found_held_gone_and_found_again() -> None:
    glide = EyeEasing()
    first = run(glide, 0, 120, EYES)
    np.testing.assert_array_equal(first[0], NEUTRAL)  # from neutral
    np.testing.assert_allclose(first[-1], EYES, atol=1e-4)
    hold = round(HOLD_S / STEP_NS * 1e9) - 1
    np.testing.assert_array_equal(run(glide, 120, hold, None), [first[-1]] * hold)
    away = run(glide, 120 + hold, 1000, None)
    assert np.abs(away[5] - first[-1]).max() < 0.1
    np.testing.assert_allclose(away[-1], NEUTRAL, atol=1e-4)
    shares = ((away - NEUTRAL) / (EYES - NEUTRAL))[:, 0]
    assert np.all(np.diff(shares) <= 1e-12)
    assert 0.65 < shares[round(AWAY_S / STEP_NS * 1e9) + 1] < 0.8, "(1 + 1) / e after the time constant"
    back = run(glide, 1200 + hold, 120, EYES + 1, 1)
    assert np.abs(back[0] - away[-1]).max() < 0.1
    np.testing.assert_allclose(back[-1], EYES + 1, atol=1e-3)
    for i in range(30):  # who is followed is not delayed
        np.testing.assert_allclose(run(glide, 1400 + hold + i, 1, EYES + i, 1)[0], EYES + i, atol=1e-3)


@given(st.lists(st.tuples(st.booleans(), st.integers(1, 40), st.floats(-8, 8)), min_size=1, max_size=12))
@settings(max_examples=80)
def test_never_a_jump_whatever_the_faces_do(spans: list[tuple[bool, int, float]]) -> None:
    """Faces come and go anywhere within 8 views; from refresh to refresh the picture moves by a part of that only."""
    glide, start, shown = EyeEasing(), 0, [NEUTRAL]
    for generation, (face, count, place) in enumerate(spans):
        shown += list(run(glide, start, count, NEUTRAL + place if face else None, generation))
        start += count
    steepest = STEP_NS / 1e9 / BACK_S / np.e  # of (1 + s) exp(-s), at s = 1
    assert np.abs(np.diff(shown, axis=0)).max() <= steepest * 16


@given(st.integers(0, 10**18))
def test_any_step_of_time_is_stable(step_ns: int) -> None:
    glide = EyeEasing()
    for i in range(5):
        out = run(glide, i, 1, None if i % 2 else EYES, step_ns=step_ns)
        assert np.all(out >= np.minimum(EYES, NEUTRAL)) and np.all(out <= np.maximum(EYES, NEUTRAL))
