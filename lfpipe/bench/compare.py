"""What differs between two runs beyond noise: paired samples, the median ratio and a bootstrap interval of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import attrs
import numpy as np

from lfpipe.bench.model import Figure
from lfpipe.bench.numbers import bootstrap_interval
from lfpipe.bench.results import Measured, Results
from lfpipe.bench.subjects import SUBJECTS
from lfpipe.errors import UserError

LEVEL = 0.99  # of the interval of one figure; that it must also clear WORTH is what keeps chance out
WORTH = {"time": 1.03, "error": 1.01}  # ratio below which a difference is not worth a word
LEAST_PAIRS = 6
REFERENCE = "reference_ms"


@attrs.frozen
class Difference:
    """One figure of one candidate in two runs. ratio: median of B over A, with its interval. called: beyond noise."""

    subject: str
    candidate: str
    figure: str
    ratio: float
    low: float
    high: float
    called: bool
    worse: bool

    def __str__(self) -> str:
        word = "worse" if self.worse else "better"
        what = f"{self.subject}: {self.candidate}: {self.figure}"
        return f"{word:7}{what}: x {self.ratio:.3f} (interval {self.low:.3f} to {self.high:.3f})"


@attrs.frozen
class Paired:
    """Ratios B over A of one figure, in groups: samples of one group share what a repetition would draw anew."""

    subject: str
    candidate: str
    figure: Figure
    kind: str  # a key of WORTH
    groups: list[list[float]]


def judge(pairs: Sequence[Paired]) -> list[Difference]:
    """Calls what lies beyond noise: the interval of the median ratio is wholly on one side of 1, by WORTH at least."""
    found = []
    for pair in pairs:
        ratios = [ratio for group in pair.groups for ratio in group]
        middle = float(np.median(ratios))
        if min(ratios) == max(ratios):
            low = high = middle
        else:
            low, high = bootstrap_interval(pair.groups, LEVEL)
        worth = WORTH[pair.kind]
        enough = len(ratios) >= LEAST_PAIRS
        called = enough and (low > worth or high < 1 / worth)
        worse = (middle > 1) != pair.figure.more_is_better
        found.append(Difference(pair.subject, pair.candidate, pair.figure.label, middle, low, high, called, called and worse))
    return found


def compare_results(a: Results, b: Results) -> list[Difference]:
    """Two runs that were not taken in turns. Times are taken over the machine's own (`timing.reference_ms`) where both runs
    have it; for builds on a machine that others use too, `builds.compare_builds` is the sharper tool.

    Raises UserError where the two measured different things.
    """
    for key in ("scenes", "sequence", "quick"):
        if a.about["identity"][key] != b.about["identity"][key]:
            raise UserError(f"the two runs differ in {key}", "measure both with the same --scene, --sequence and --quick")
    pairs: list[Paired] = []
    for name, one in a.subjects.items():
        other = b.subjects.get(name)
        for candidate in one.measured:
            if other is not None and candidate in other.measured:
                pairs += paired(name, one.measured[candidate], other.measured[candidate])
    return judge(pairs)


def paired(subject: str, a: Measured, b: Measured) -> Iterator[Paired]:
    """Every figure that both hold, sample by sample."""
    for figure in SUBJECTS[subject].figures:
        if figure.key in a.errors and figure.key in b.errors:
            ratios = error_ratios(a.errors[figure.key], b.errors[figure.key])
            if ratios:
                yield Paired(subject, a.name, figure, "error", [[ratio] for ratio in ratios])
        elif figure.key in a.turns and figure.key in b.turns and "p95" not in figure.key:
            yield Paired(subject, a.name, figure, "time", time_ratios(a.turns, b.turns, figure.key))


def error_ratios(a: Sequence[float], b: Sequence[float]) -> list[float]:
    """B over A for each sample; where A is 0 so must B be, or it is far worse. Empty where the two hold different samples."""
    if len(a) != len(b):
        return []
    return [y / x if x else (1.0 if y == x else 1e9) for x, y in zip(a, b, strict=True)]


def time_ratios(a: dict[str, list[float]], b: dict[str, list[float]], key: str) -> list[list[float]]:
    """B over A for each turn, each over the machine's own time at that turn."""
    steady = [_steady(turns, key) for turns in (a, b)]
    count = min(map(len, steady))
    return [[y / x] for x, y in zip(steady[0][:count], steady[1][:count], strict=True) if x > 0 and math.isfinite(y)]


def _steady(turns: dict[str, list[float]], key: str) -> list[float]:
    own = turns.get(REFERENCE)
    return (
        [value / machine for value, machine in zip(turns[key], own, strict=True)] if own and "copies" not in key else turns[key]
    )
