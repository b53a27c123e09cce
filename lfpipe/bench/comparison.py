"""Differences between two builds or two runs beyond noise: paired ratios, a test against a minimum effect, an interval."""

import math
from collections.abc import Iterator, Sequence
from typing import Literal

import attrs
import numpy as np

from lfpipe.bench.model import Figure
from lfpipe.bench.results import Measured, Results
from lfpipe.bench.stats import bootstrap_interval, p_above
from lfpipe.bench.subjects import SUBJECTS
from lfpipe.bench.timing import REFERENCE
from lfpipe.errors import UserError
from lfpipe.files.untrusted import Fields

Kind = Literal["time", "apart", "error"]
# Smaller ratios are not reported, however many samples there are. apart: times of runs that did not take turns. They differ by
# some percent because the memory layout of a process affects its speed for its whole life.
MIN_EFFECT: dict[Kind, float] = {"time": 1.03, "apart": 1.10, "error": 1.01}
ALPHA = 0.05  # probability of any false call in a comparison if every true ratio is at its MIN_EFFECT
RULED_OUT = 0.05  # p-value at which a difference is ruled out
MAX_RATIO = 1e9  # also the ratio if the other error is 0


@attrs.frozen
class Difference:
    """One figure of one candidate in two runs. ratio: median of B over A, with its 95 % bootstrap interval. called: beyond noise.
    settled: called, or a difference beyond MIN_EFFECT is ruled out; otherwise the samples are too few or too noisy."""

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
    """Ratios B over A of one figure, each from samples taken under equal conditions. exact: both builds repeat their samples bit
    for bit, so the single ratio is that of the figure itself, free of chance."""

    subject: str
    candidate: str
    figure: Figure
    kind: Kind
    ratios: list[float]
    exact: bool = False


def judge(pairs: Sequence[Paired], looks: int = 1) -> list[Difference]:
    """Calls differences beyond noise: ratios that lie beyond MIN_EFFECT with near certainty, over all figures together.

    looks: how often the growing samples are judged. Each look and figure has an equal part of ALPHA (Bonferroni).
    """
    part = ALPHA / max(1, 2 * looks * sum(not pair.exact for pair in pairs))
    return [_judged(pair, part) for pair in pairs]


def _judged(pair: Paired, part: float) -> Difference:
    middle, limit = float(np.median(pair.ratios)), math.log(MIN_EFFECT[pair.kind])
    if pair.exact:
        low = high = middle
        called, settled = abs(math.log(middle)) > limit, True
    else:
        logs = np.log(pair.ratios)
        low, high = bootstrap_interval(pair.ratios)
        called = min(p_above((logs - limit).tolist()), p_above((-logs - limit).tolist())) <= part
        settled = called or max(p_above((limit - logs).tolist()), p_above((limit + logs).tolist())) <= RULED_OUT
    worse = called and (middle > 1) != pair.figure.more_is_better
    return Difference(pair.subject, pair.candidate, pair.figure.label, middle, low, high, called, worse, settled)


def compare_results(a: Results, b: Results) -> list[Difference]:
    """Compares two runs that did not take turns: times relative to the speed of the machine, large differences only.

    `builds.compare_builds` is more sensitive. Subjects that no longer exist are ignored. Raises UserError if the runs had
    different inputs.
    """
    remedy = "measure both with the same --scene, --sequence and --quick"
    one, other = (Fields(run.about, "about", remedy).table("identity") for run in (a, b))
    for key in ("scenes", "sequence", "quick"):
        if key not in one.values or one.values[key] != other.values.get(key):
            raise UserError(f"the two runs differ in {key}", remedy)
    pairs: list[Paired] = []
    for name in [name for name in SUBJECTS if name in a.subjects and name in b.subjects]:
        first, second = a.subjects[name].measured, b.subjects[name].measured
        for candidate in [key for key in first if key in second]:
            pairs += paired(name, first[candidate], second[candidate])
    return judge(pairs)


def timed(figure: Figure) -> bool:
    """Whether a timed figure is compared: the 95th percentile of a turn is mostly noise."""
    return "p95" not in figure.key


def paired(subject: str, a: Measured, b: Measured) -> Iterator[Paired]:
    """Every figure in both, sample by sample."""
    for figure in SUBJECTS[subject].figures:
        key, ratios = figure.key, list[float]()
        kind: Kind = "error"
        if key in a.errors and key in b.errors:
            ratios = error_ratios(a.errors[key], b.errors[key])
        elif key in a.turns and key in b.turns and timed(figure):
            kind, ratios = "apart", time_ratios(a.turns, b.turns, key)
        if ratios:
            yield Paired(subject, a.name, figure, kind, ratios)


def error_ratios(a: Sequence[float], b: Sequence[float]) -> list[float]:
    """B over A for each sample; empty if the two have different samples, or one that is not finite."""
    comparable = len(a) == len(b) and all(map(math.isfinite, (*a, *b)))
    return [ratio(x, y) for x, y in zip(a, b, strict=True)] if comparable else []


def ratio(x: float, y: float) -> float:
    """y over x: 1 if equal, MAX_RATIO or its inverse if one of them is 0."""
    if x == y:
        return 1.0
    return min(max(abs(y / x), 1 / MAX_RATIO), MAX_RATIO) if x else MAX_RATIO


def time_ratios(a: dict[str, list[float]], b: dict[str, list[float]], key: str) -> list[float]:
    """B over A for each turn, each relative to the reference time of that turn; without turns that are not finite."""
    pairs = zip(_over_reference(a, key), _over_reference(b, key), strict=False)
    return [ratio(x, y) for x, y in pairs if math.isfinite(x) and math.isfinite(y)]


def _over_reference(turns: dict[str, list[float]], key: str) -> list[float]:
    reference = turns.get(REFERENCE)
    if not reference or "copies" in key:  # "copies" is a ratio of times already
        return turns[key]
    return [value / own if own else math.nan for value, own in zip(turns[key], reference, strict=False)]
