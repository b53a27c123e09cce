"""The covariance of the constant-velocity filter, against exact arithmetic on the stiff grid."""

import itertools
from fractions import Fraction

from hypothesis import given, settings
from hypothesis import strategies as st

from lfpipe.track.smoothing import Covariance

NOISES = (1e-12, 1e-6, 1.0, 1e6, 1e12)
STEPS_S = (1e-9, 1e-3, 1 / 30, 10.0, 1e6)
START = (1.0, 0.0, 1.0)


def exact(q: float, r: float, dt_s: float, steps: int) -> tuple[Fraction, Fraction, Fraction]:
    """The textbook recursion in rational numbers: P = F P F' + Q, then P - K H P."""
    a, b, c = (Fraction(value) for value in START)
    fq, fr, d = Fraction(q), Fraction(r), Fraction(dt_s)
    for _ in range(steps):
        a, b, c = a + 2 * b * d + c * d * d + fq * d**3 / 3, b + c * d + fq * d * d / 2, c + fq * d
        s = a + fr
        a, b, c = a - a * a / s, b - a * b / s, c - b * b / s
    return a, b, c


def test_the_stiff_grid_keeps_its_digits_and_stays_positive() -> None:
    worst = 0.0
    for q, r, dt_s in itertools.product(NOISES, NOISES, STEPS_S):
        p = Covariance(*START, START[0] * START[2])
        for _ in range(8):
            p, k0, k1 = p.ahead(dt_s, q).measured(r)
            assert p.a >= 0 and p.b >= 0 and p.c >= 0 and p.det >= 0
            assert 0 <= k0 <= 1 and k1 >= 0
        for value, truth in zip((p.a, p.b, p.c), exact(q, r, dt_s, 8), strict=True):
            worst = max(worst, abs(float((Fraction(value) - truth) / truth)))
    assert worst < 1e-13


@given(
    st.lists(st.tuples(st.floats(1e-9, 1e6), st.floats(1e-12, 1e12), st.floats(1e-12, 1e12)), min_size=1, max_size=40),
)
@settings(max_examples=100)
def test_any_mix_of_steps_stays_positive_semi_definite(steps: list[tuple[float, float, float]]) -> None:
    p = Covariance(1.0, 0.0, 1e6, 1e6)
    for dt_s, q, r in steps:
        p, k0, k1 = p.ahead(dt_s, q).measured(r)
        assert p.a >= 0 and p.b >= 0 and p.c >= 0
        assert p.b * p.b <= p.a * p.c * (1 + 1e-9)
        assert 0 <= k0 <= 1 and k1 >= 0


def test_nothing_measured_the_position_spreads_as_velocity_and_noise_say() -> None:
    p = Covariance(1.0, 0.0, 4.0, 4.0).ahead(0.5, 12.0)
    assert (p.a, p.b, p.c) == (1.0 + 4 * 0.25 + 12 * 0.125 / 3, 4 * 0.5 + 12 * 0.25 / 2, 4.0 + 12 * 0.5)
    assert abs(p.det - (p.a * p.c - p.b * p.b)) < 1e-12
