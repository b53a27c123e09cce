"""Measures subjects: errors once, times in turns, until the interval is narrow or the budget is spent."""

import math
import random
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np

from lfpipe.bench.inputs import Inputs
from lfpipe.bench.model import Candidate, Prepared, Samples, Skipped, Subject, Table, Turn
from lfpipe.bench.results import Measured, Results, SubjectResults, describe_run, read
from lfpipe.bench.subjects import SUBJECTS
from lfpipe.bench.timing import REFERENCE, reference_ms
from lfpipe.errors import UserError

NARROW = 0.05  # width of the 95 % interval of the median over the median
LONG_TURNS = 3  # a subject with at most this many turns has long turns and no warm-up
Progress = Callable[[str, int, int], None]


def measure(names: Sequence[str], inputs: Inputs, out: Path, progress: Progress) -> Results:
    """Measures the named subjects and writes out/results.json after every step. Returns all results in it.

    Results in out of the same inputs, versions and source are kept: an interrupted run continues, and a further subject is added.
    Other results are replaced. Raises UserError if out cannot be written.
    """
    cv2.setNumThreads(1)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{out}: {error.strerror}", "choose another folder with --out DIR") from None
    results = Results(describe_run(inputs))
    try:
        before = read(out)
        if before.about.get("identity") == results.about["identity"]:
            results.subjects = before.subjects
    except UserError:  # nothing to continue
        pass
    for name in names:
        found = results.subjects.setdefault(name, SubjectResults(name))
        if not found.done:
            run(SUBJECTS[name], inputs, found, progress, lambda: results.write(out))
    results.subjects = {name: results.subjects[name] for name in SUBJECTS if name in results.subjects}
    results.write(out)
    return results


def run(subject: Subject, inputs: Inputs, found: SubjectResults, progress: Progress, save: Callable[[], None]) -> None:
    """Measures what is missing in found; calls save after every candidate and every round.

    A candidate that raises or returns a number that is not finite moves to found.omissions, with the reason and no samples.
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
        ready: dict[str, Prepared] = {}
        try:
            for k, candidate in enumerate(wanted):
                progress(subject.title, k, 2 * len(wanted))
                _measure_errors(candidate, ready, found, save)
            _measure_turns(subject, inputs.quick, ready, found, progress, save)
        finally:
            for prepared in ready.values():
                prepared.close()
    found.seconds += time.monotonic() - started
    found.done = True
    progress(subject.title, 1, 1)
    save()


def _measure_errors(candidate: Candidate, ready: dict[str, Prepared], found: SubjectResults, save: Callable[[], None]) -> None:
    """Prepares a candidate and measures its errors unless they are known."""
    try:
        prepared = candidate.prepare()
        if candidate.name not in found.measured:
            errors = prepared.errors()
            _check_finite(errors)
            curve, knob, paper = candidate.curve, candidate.knob, candidate.paper
            found.measured[candidate.name] = Measured(curve, knob, paper, errors, line=candidate.line)
            save()
        ready[candidate.name] = prepared
    except Exception as error:  # report any failure of a method and continue with the others
        _omit(found, candidate.name, error)


def _measure_turns(
    subject: Subject,
    quick: bool,
    ready: dict[str, Prepared],
    found: SubjectResults,
    progress: Progress,
    save: Callable[[], None],
) -> None:
    """Rounds of one turn each, in a new order every round, so that other load on the machine affects all candidates alike."""
    budget_s, least = subject.budget_s[0 if quick else 1], subject.turns[0 if quick else 1]
    timed = {name: prepared.turn for name, prepared in ready.items() if prepared.turn is not None}
    shuffled, started = random.Random(1), time.monotonic()
    if least > LONG_TURNS:
        for name in list(timed):
            _measure_turn(name, timed, found, keep=False)
    while open_ := [name for name in timed if _turns(found, name) < least or not _settled(found, name)]:
        elapsed_s = time.monotonic() - started
        short = [name for name in open_ if _turns(found, name) < least]
        if elapsed_s > budget_s and not short:
            break
        if elapsed_s > 3 * budget_s and all(_turns(found, name) for name in open_):
            break
        settled = len(timed) - len(open_) + len(open_) * min(1.0, elapsed_s / budget_s)
        progress(subject.title, len(timed) + int(settled), 2 * len(timed) + 1)
        shuffled.shuffle(open_)
        for name in open_ if elapsed_s <= budget_s else short:
            _measure_turn(name, timed, found, keep=True)
        save()


def _measure_turn(name: str, timed: dict[str, Callable[[], Turn]], found: SubjectResults, keep: bool) -> None:
    try:
        reference = reference_ms()
        turn = {key: value if isinstance(value, list) else [value] for key, value in timed[name]().items()}
        turn[REFERENCE] = [reference]
        _check_finite(turn)
    except Exception as error:  # as above
        _omit(found, name, error)
        timed.pop(name)
        return
    if keep:
        measured = found.measured[name]
        for key, samples in turn.items():
            measured.turns.setdefault(key, []).append(float(np.median(samples)))
            if len(samples) > 1:
                measured.parts.setdefault(key, []).extend(samples)


def _turns(found: SubjectResults, name: str) -> int:
    return max((len(samples) for samples in found.measured[name].turns.values()), default=0)


def _settled(found: SubjectResults, name: str) -> bool:
    """Whether the interval of the first timed figure is narrow enough."""
    key = next((key for key in found.measured[name].turns if key.startswith("time")), None)
    return key is None or found.measured[name].noise(key) <= NARROW


def _check_finite(samples: Samples) -> None:
    wrong = [key for key, values in samples.items() if not all(math.isfinite(value) for value in values)]
    if wrong:
        raise ValueError(f"not finite: {', '.join(wrong)}")


def _omit(found: SubjectResults, name: str, error: Exception) -> None:
    found.measured.pop(name, None)
    found.omissions[name] = f"{type(error).__name__}: {error}"
