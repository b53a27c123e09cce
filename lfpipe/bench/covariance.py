"""The covariance of the Kalman filter in three forms, for stiff settings, compared with rational arithmetic."""

import itertools
import math
from collections.abc import Iterator
from fractions import Fraction
from typing import TypeVar

import attrs

from lfpipe.track.kalman import Covariance

Number = TypeVar("Number", float, Fraction)

NOISES = (1e-12, 1e-6, 1.0, 1e6, 1e12)
STEPS_S = (1e-9, 1e-3, 1 / 30, 10.0, 1e6)
FORMS = ("without subtraction", "Joseph", "standard")  # the first is the one in use
ROUNDS, EXACT_ROUNDS = 60, 12  # the rationals' digits double every round


@attrs.frozen
class StiffCase:
    """Process noise q and measurement noise r in one form. worst: relative error of an entry over the first EXACT_ROUNDS.
    definite: the matrix stayed positive semi-definite over all rounds."""

    form: str
    q: float
    r: float
    worst: float
    definite: bool


def _predicted(p: tuple[Number, Number, Number], q: Number, d: Number) -> tuple[Number, Number, Number]:
    return p[0] + 2 * p[1] * d + p[2] * d * d + q * d**3 / 3, p[1] + p[2] * d + q * d * d / 2, p[2] + q * d


def standard(p: tuple[Number, Number, Number], q: Number, r: Number, d: Number) -> tuple[Number, Number, Number]:
    a, b, c = _predicted(p, q, d)
    return a - a * a / (a + r), b - a * b / (a + r), c - b * b / (a + r)


def joseph(p: tuple[float, float, float], q: float, r: float, d: float) -> tuple[float, float, float]:
    a, b, c = _predicted(p, q, d)
    k0, k1 = a / (a + r), b / (a + r)
    m = 1 - k0
    return m * m * a + k0 * k0 * r, m * (b - k1 * a) + k0 * k1 * r, c - 2 * k1 * b + k1 * k1 * a + k1 * k1 * r


def stiff_cases(rounds: int = ROUNDS, exact_rounds: int = EXACT_ROUNDS) -> Iterator[StiffCase]:
    """The 125 settings of NOISES x NOISES x STEPS_S, each in every form."""
    for q, r, d in itertools.product(NOISES, NOISES, STEPS_S):
        truth = Fraction(1), Fraction(0), Fraction(1)
        forms = dict.fromkeys(FORMS, (1.0, 0.0, 1.0))
        ours = Covariance(1.0, 0.0, 1.0, 1.0)
        worst, indefinite = dict.fromkeys(FORMS, 0.0), set[str]()
        for k in range(rounds):
            ours = ours.ahead(d, q).measured(r)[0]
            forms["standard"], forms["Joseph"] = standard(forms["standard"], q, r, d), joseph(forms["Joseph"], q, r, d)
            forms["without subtraction"] = ours.a, ours.b, ours.c
            if k < exact_rounds:
                truth = standard(truth, Fraction(q), Fraction(r), Fraction(d))
            for name, entries in forms.items():
                a, b, c = entries
                if k < exact_rounds:
                    errors = (
                        abs(float(Fraction(v) / t - 1)) if math.isfinite(v) else math.inf
                        for v, t in zip(entries, truth, strict=True)
                    )
                    worst[name] = max(worst[name], *errors)
                if not (a >= 0 and c >= 0 and b * b <= a * c * (1 + 1e-12)):
                    indefinite.add(name)
        for name in FORMS:
            yield StiffCase(name, q, r, worst[name], name not in indefinite)
