"""Measures the candidates of a subject: errors once, times in turns, until the interval is narrow or the budget ends."""

from __future__ import annotations

import math
import random
import statistics
import time
from collections.abc import Callable

from lfpipe.bench.inputs import Inputs
from lfpipe.bench.model import Candidate, Prepared, Skipped, Subject, Table, Turn
from lfpipe.bench.results import Measured, SubjectResults
from lfpipe.bench.timing import REFERENCE, reference_ms

NARROW = 0.05  # width of the 95 % interval of the median over the median
Say = Callable[[str, int, int], None]


def run(subject: Subject, inputs: Inputs, found: SubjectResults, say: Say, save: Callable[[], None]) -> None:
    """Measures what found does not hold yet; calls save after every candidate and every round.

    A candidate that throws, or gives what is not finite, moves to found.omissions with the reason and keeps no sample.
    """
    started = time.monotonic()
    if subject.tables is not None:
        items = list(subject.tables(inputs))
        found.tables = [item for item in items if isinstance(item, Table)]
        found.skipped = [item for item in items if isinstance(item, Skipped)]
    elif subject.candidates is not None:
        offered = list(subject.candidates(inputs))
        found.skipped = [item for item in offered if isinstance(item, Skipped)]
        wanted = [item for item in offered if isinstance(item, Candidate) and item.name not in found.omissions]
        ready = _errors(wanted, found, say, save, subject)
        try:
            _turns(subject, inputs, ready, found, say, save)
        finally:
            for prepared in ready.values():
                prepared.close()
    found.seconds += time.monotonic() - started
    found.done = True
    say(subject.title, 1, 1)
    save()


def _errors(
    wanted: list[Candidate], found: SubjectResults, say: Say, save: Callable[[], None], subject: Subject
) -> dict[str, Prepared]:
    """Every candidate prepared, its errors measured where they are not known yet."""
    ready: dict[str, Prepared] = {}
    for k, candidate in enumerate(wanted):
        say(subject.title, k, 2 * len(wanted))
        try:
            prepared = candidate.prepare()
            if candidate.name not in found.measured:
                errors = prepared.errors()
                _finite(errors)
                found.measured[candidate.name] = Measured(
                    candidate.curve, candidate.knob, candidate.paper, errors, line=candidate.line
                )
                save()
            ready[candidate.name] = prepared
        except Exception as error:  # whatever a method throws is reported, and the others go on
            _omit(found, candidate.name, error)
    return ready


def _turns(
    subject: Subject, inputs: Inputs, ready: dict[str, Prepared], found: SubjectResults, say: Say, save: Callable[[], None]
) -> None:
    """Rounds of one turn each, in another order every round, so that what else the machine does meets all candidates."""
    budget_s, least = subject.budget_s[0 if inputs.quick else 1], subject.turns[0 if inputs.quick else 1]
    timed = {name: prepared.turn for name, prepared in ready.items() if prepared.turn is not None}
    shuffled, started = random.Random(1), time.monotonic()
    if least > 3:
        for name, turn in list(timed.items()):  # warm up: a turn that does not count
            _turn(name, turn, found, timed, keep=False)
    while open_ := [name for name in timed if _count(found, name) < least or not _settled(found, name)]:
        gone_s = time.monotonic() - started
        short = [name for name in open_ if _count(found, name) < least]
        if gone_s > budget_s and not short:
            break
        if gone_s > 3 * budget_s and all(_count(found, name) for name in open_):
            break
        settled = len(timed) - len(open_) + len(open_) * min(1.0, gone_s / budget_s)
        say(subject.title, len(timed) + int(settled), 2 * len(timed) + 1)
        shuffled.shuffle(open_)
        for name in open_ if gone_s <= budget_s else short:
            _turn(name, timed[name], found, timed, keep=True)
        save()


def _turn(
    name: str,
    turn: Callable[[], Turn],
    found: SubjectResults,
    timed: dict[str, Callable[[], Turn]],
    keep: bool,
) -> None:
    try:
        reference = reference_ms()
        told = {key: value if isinstance(value, list) else [value] for key, value in turn().items()} | {REFERENCE: [reference]}
        _finite(told)
    except Exception as error:  # as above
        _omit(found, name, error)
        timed.pop(name)
        return
    if keep:
        one = found.measured[name]
        for key, samples in told.items():
            one.turns.setdefault(key, []).append(statistics.median(samples))
            if len(samples) > 1:
                one.parts.setdefault(key, []).extend(samples)


def _count(found: SubjectResults, name: str) -> int:
    return max((len(samples) for samples in found.measured[name].turns.values()), default=0)


def _settled(found: SubjectResults, name: str) -> bool:
    """Whether the interval of the first figure that is timed is narrow enough."""
    key = next((key for key in found.measured[name].turns if key.startswith("time")), None)
    return key is None or found.measured[name].noise(key) <= NARROW


def _finite(samples: dict[str, list[float]]) -> None:
    wrong = [key for key, values in samples.items() if not all(math.isfinite(value) for value in values)]
    if wrong:
        raise ValueError(f"not finite: {', '.join(wrong)}")


def _omit(found: SubjectResults, name: str, error: Exception) -> None:
    found.measured.pop(name, None)
    found.omissions[name] = f"{type(error).__name__}: {error}"
