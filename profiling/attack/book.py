"""What was tried, how often, what held; failures by cause, each with what repeats it."""

import threading
from collections import Counter
from pathlib import Path

import attrs

from profiling.attack.case import FAILURES, HELD, Outcome

KEPT = 2  # inputs kept for a cause


@attrs.define
class Failure:
    """A cause of failures: the first inputs that showed it, and how many did."""

    part: str
    outcome: str
    group: str
    detail: str
    count: int = 0
    numbers: list[int] = attrs.Factory(list)
    repeats: list[str] = attrs.Factory(list)


@attrs.define
class Book:
    """Of one run. failures: where inputs that failed are kept."""

    seed: int
    failures: Path
    counts: dict[tuple[str, str], Counter[str]] = attrs.Factory(dict)
    causes: dict[tuple[str, str, str], Failure] = attrs.Factory(dict)
    peak_mb: dict[str, float] = attrs.Factory(dict)
    notes: list[str] = attrs.Factory(list)
    seconds: dict[str, float] = attrs.Factory(dict)
    _lock: threading.Lock = attrs.field(factory=threading.Lock, repr=False)

    def wants(self, outcome: Outcome) -> bool:
        """Whether an input that failed so is worth keeping."""
        found = self.causes.get((outcome.kind.partition(":")[0], outcome.outcome, outcome.group))
        return found is None or len(found.repeats) < KEPT

    def add(self, part: str, outcome: Outcome, number: int = -1, repeat: str = "", times: int = 1) -> None:
        """Counts an input."""
        with self._lock:
            self._add(part, outcome, number, repeat, times)

    def _add(self, part: str, outcome: Outcome, number: int, repeat: str, times: int) -> None:
        self.counts.setdefault((part, outcome.kind), Counter())[outcome.outcome] += times
        if outcome.outcome == "refused":
            self.peak_mb[part] = max(self.peak_mb.get(part, 0.0), outcome.peak_mb)
        if outcome.outcome in HELD:
            return
        key = (outcome.kind.partition(":")[0], outcome.outcome, outcome.group)
        cause = self.causes.setdefault(key, Failure(part, outcome.outcome, outcome.group, outcome.detail))
        cause.count += times
        if repeat:
            cause.numbers.append(number)
            cause.repeats.append(repeat)

    def total(self, outcome: str) -> int:
        """Inputs with that outcome."""
        return sum(counter[outcome] for counter in list(self.counts.values()))

    @property
    def inputs(self) -> int:
        """All of them."""
        return sum(sum(counter.values()) for counter in list(self.counts.values()))

    @property
    def failed(self) -> int:
        """Inputs that did not hold."""
        return sum(self.total(outcome) for outcome in FAILURES)
