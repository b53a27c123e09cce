"""What differs between two builds or two runs beyond noise: paired ratios, a test against a least effect, an interval to read."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Literal

import attrs
import numpy as np

from lfpipe.bench.model import Figure
from lfpipe.bench.numbers import above, bootstrap_interval
from lfpipe.bench.results import Measured, Results
from lfpipe.bench.subjects import SUBJECTS
from lfpipe.bench.timing import REFERENCE
from lfpipe.errors import UserError
from lfpipe.untrusted import Fields

Kind = Literal["time", "apart", "error"]
# Ratio up to which a difference is not worth a word, and none is called whatever the number of samples. apart: times of runs that
# were not taken in turns; what a process is lucky with in its memory lasts as long as it lives, by some percent.
WORTH: dict[Kind, float] = {"time": 1.03, "apart": 1.10, "error": 1.01}
CHANCE = 0.05  # that anything is called in a whole comparison where every true ratio lies at its limit of WORTH
SETTLED = 0.05  # chance at which a difference is ruled out
FAR = 1e9  # the ratio to an error of 0


@attrs.frozen
class Difference:
    """One figure of one candidate in two runs. ratio: median of B over A, with its 95 % interval by bootstrap. called: beyond
    noise. settled: called, or any difference worth a word ruled out; otherwise the samples were too few or too noisy to tell."""

    subject: str
    candidate: str
    figure: str
    ratio: float
    low: float
    high: float
    called: bool
    worse: bool
    settled: bool

    def __str__(self) -> str:
        word = ("worse" if self.worse else "better") if self.called else "same" if self.settled else "unsure"
        what = f"{self.subject}: {self.candidate}: {self.figure}"
        return f"{word:7}{what}: x {self.ratio:.3f} (interval {self.low:.3f} to {self.high:.3f})"


@attrs.frozen
class Paired:
    """Ratios B over A of one figure, each of samples taken under equal conditions. exact: both builds repeat their samples to the
    last bit and the one ratio is that of the figure itself, so no chance is in it."""

    subject: str
    candidate: str
    figure: Figure
    kind: Kind
    ratios: list[float]
    exact: bool = False


def judge(pairs: Sequence[Paired], looks: int = 1) -> list[Difference]:
    """Calls what lies beyond noise: that the ratio lies beyond WORTH is as good as sure, over all figures together.

    looks: how often the same samples are judged while they grow. Each look and figure has an equal part of CHANCE (Bonferroni).
    """
    part = CHANCE / max(1, 2 * looks * sum(not pair.exact for pair in pairs))
    return [_judged(pair, part) for pair in pairs]


def _judged(pair: Paired, part: float) -> Difference:
    middle, limit = float(np.median(pair.ratios)), math.log(WORTH[pair.kind])
    if pair.exact:
        low = high = middle
        called, settled = abs(math.log(middle)) > limit, True
    else:
        logs = np.log(pair.ratios)
        low, high = bootstrap_interval(pair.ratios)
        called = min(above((logs - limit).tolist()), above((-logs - limit).tolist())) <= part
        settled = called or max(above((limit - logs).tolist()), above((limit + logs).tolist())) <= SETTLED
    worse = called and (middle > 1) != pair.figure.more_is_better
    return Difference(pair.subject, pair.candidate, pair.figure.label, middle, low, high, called, worse, settled)


def compare_results(a: Results, b: Results) -> list[Difference]:
    """Two runs that were not taken in turns: times over the machine's own at that turn, and only large differences are told.
    For builds `builds.compare_builds` is the sharper tool.

    Raises UserError where the two measured different things.
    """
    remedy = "measure both with the same --scene, --sequence and --quick"
    one, other = (Fields(run.about, "about", remedy).table("identity") for run in (a, b))
    for key in ("scenes", "sequence", "quick"):
        if key not in one.values or one.values[key] != other.values.get(key):
            raise UserError(f"the two runs differ in {key}", remedy)
    pairs: list[Paired] = []
    for name, found in a.subjects.items():
        there = b.subjects.get(name)
        for candidate in found.measured:
            if there is not None and candidate in there.measured:
                pairs += paired(name, found.measured[candidate], there.measured[candidate])
    return judge(pairs)


def timed(figure: Figure) -> bool:
    """Whether a figure that turns give is compared: the 95th percentile of a turn is noise for the greater part."""
    return "p95" not in figure.key


def paired(subject: str, a: Measured, b: Measured) -> Iterator[Paired]:
    """Every figure that both hold, sample by sample."""
    for figure in SUBJECTS[subject].figures if subject in SUBJECTS else ():
        if figure.key in a.errors and figure.key in b.errors:
            ratios = error_ratios(a.errors[figure.key], b.errors[figure.key])
            if ratios:
                yield Paired(subject, a.name, figure, "error", ratios)
        elif figure.key in a.turns and figure.key in b.turns and timed(figure):
            ratios = time_ratios(a.turns, b.turns, figure.key)
            if ratios:
                yield Paired(subject, a.name, figure, "apart", ratios)


def error_ratios(a: Sequence[float], b: Sequence[float]) -> list[float]:
    """B over A for each sample; where A is 0 so must B be, or it is far worse. Empty where the two hold different
    samples, or one that is not finite."""
    known = len(a) == len(b) and all(map(math.isfinite, (*a, *b)))
    return [ratio(x, y) for x, y in zip(a, b, strict=True)] if known else []


def ratio(x: float, y: float) -> float:
    """y over x: 1 where they are equal, FAR or its inverse where one of them is 0."""
    if x == y:
        return 1.0
    return min(max(abs(y / x), 1 / FAR), FAR) if x else FAR


def time_ratios(a: dict[str, list[float]], b: dict[str, list[float]], key: str) -> list[float]:
    """B over A for each turn, each over the machine's own time at that turn; turns that are not finite are left out."""
    pairs = zip(_steady(a, key), _steady(b, key), strict=False)
    return [ratio(x, y) for x, y in pairs if math.isfinite(x) and math.isfinite(y)]


def _steady(turns: dict[str, list[float]], key: str) -> list[float]:
    own = turns.get(REFERENCE)
    if own and "copies" not in key:
        return [value / machine if machine else math.nan for value, machine in zip(turns[key], own, strict=False)]
    return turns[key]
