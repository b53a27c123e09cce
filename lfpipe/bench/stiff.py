"""The covariance of the Kalman filter in three forms over stiff settings, beside rational arithmetic."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from fractions import Fraction

import attrs

from lfpipe.track.kalman import Covariance

Entry = tuple[float, float, float]
Rational = tuple[Fraction, Fraction, Fraction]

NOISES = (1e-12, 1e-6, 1.0, 1e6, 1e12)
STEPS_S = (1e-9, 1e-3, 1 / 30, 10.0, 1e6)
FORMS = ("without subtraction", "Joseph", "standard")  # the first is the one used
ROUNDS, EXACT_ROUNDS = 60, 12  # the digits of the rationals double with every round


@attrs.frozen
class Stiff:
    """One cell: form, process noise q, measurement noise r; worst relative error of an entry over the first rounds, and
    whether the matrix stayed positive semi-definite over all."""

    form: str
    q: float
    r: float
    worst: float
    definite: bool


def standard(p: Entry, q: float, r: float, d: float) -> Entry:
    a, b, c = p[0] + 2 * p[1] * d + p[2] * d * d + q * d**3 / 3, p[1] + p[2] * d + q * d * d / 2, p[2] + q * d
    s = a + r
    return a - a * a / s, b - a * b / s, c - b * b / s


def joseph(p: Entry, q: float, r: float, d: float) -> Entry:
    a, b, c = p[0] + 2 * p[1] * d + p[2] * d * d + q * d**3 / 3, p[1] + p[2] * d + q * d * d / 2, p[2] + q * d
    k0, k1 = a / (a + r), b / (a + r)
    m = 1 - k0
    return m * m * a + k0 * k0 * r, m * (b - k1 * a) + k0 * k1 * r, c - 2 * k1 * b + k1 * k1 * a + k1 * k1 * r


def exact(p: Rational, q: Fraction, r: Fraction, d: Fraction) -> Rational:
    a, b, c = p[0] + 2 * p[1] * d + p[2] * d * d + q * d**3 / 3, p[1] + p[2] * d + q * d * d / 2, p[2] + q * d
    s = a + r
    return a - a * a / s, b - a * b / s, c - b * b / s


def _away(p: Entry, truth: Rational) -> float:
    return max(abs(float(Fraction(v) / t - 1)) if math.isfinite(v) else math.inf for v, t in zip(p, truth, strict=True))


def cells(rounds: int = ROUNDS, exact_rounds: int = EXACT_ROUNDS) -> Iterator[Stiff]:
    """The 125 settings of NOISES x NOISES x STEPS_S, each in every form."""
    for q, r, d in itertools.product(NOISES, NOISES, STEPS_S):
        truth: Rational = (Fraction(1), Fraction(0), Fraction(1))
        forms: dict[str, Entry] = dict.fromkeys(FORMS, (1.0, 0.0, 1.0))
        ours = Covariance(1.0, 0.0, 1.0, 1.0)
        worst, broken = dict.fromkeys(FORMS, 0.0), set[str]()
        for k in range(rounds):
            ours = ours.ahead(d, q).measured(r)[0]
            forms["standard"], forms["Joseph"] = standard(forms["standard"], q, r, d), joseph(forms["Joseph"], q, r, d)
            forms["without subtraction"] = ours.a, ours.b, ours.c
            if k < exact_rounds:
                truth = exact(truth, Fraction(q), Fraction(r), Fraction(d))
            for name, (a, b, c) in forms.items():
                if k < exact_rounds:
                    worst[name] = max(worst[name], _away((a, b, c), truth))
                if not (a >= 0 and c >= 0 and b * b <= a * c * (1 + 1e-12)):
                    broken.add(name)
        for name in FORMS:
            yield Stiff(name, q, r, worst[name], name not in broken)
