"""Measures subjects: errors once, times in turns, until the interval is narrow or the budget is spent."""

import math
import os
import random
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import attrs
import cv2
import numpy as np

from lfpipe.bench import anaglyph, filters, judder, photon, pipeline, stability, synthesis, tracker
from lfpipe.bench.conditions import describe
from lfpipe.bench.inputs import Inputs
from lfpipe.bench.results import (
    Candidate,
    Prepared,
    Row,
    Samples,
    Skipped,
    Subject,
    SubjectResults,
    Table,
    Value,
    read,
    write,
)
from lfpipe.bench.stats import MIN_SAMPLES, median_interval
from lfpipe.errors import UserError
from lfpipe.files.output import check_output

SUBJECTS: dict[str, Subject] = {  # in the order of the report
    module.SUBJECT.name: module.SUBJECT for module in (tracker, filters, photon, judder, synthesis, anaglyph, pipeline, stability)
}
NARROW = 0.05  # width of the 95 % interval of the median over the median
LONG_TURNS = 3  # a subject with at most this many turns has long turns and no warm-up
Progress = Callable[[str, int, int], None]


def measure(names: Sequence[str], inputs: Inputs, out: Path, progress: Progress) -> dict[str, SubjectResults]:
    """Measures the named subjects and writes out/results.json after each of them. Returns all results in it.

    A subject that out holds for the same inputs, versions and source is not measured again, so an interrupted run continues.
    Raises UserError if out cannot be written.
    """
    cv2.setNumThreads(1)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{out}: {error.strerror}", "choose another folder with --out DIR") from None
    for name in ("results.json", "report.html", "summary.md"):
        check_output(out / name)
    try:
        results = read(out)
    except UserError:  # nothing to continue
        results = {}
    for name in names:
        subject = SUBJECTS[name]
        identity, about = describe(subject, inputs)
        if name not in results or results[name].identity != identity:
            results[name] = attrs.evolve(run(subject, inputs, progress), identity=identity, about=about)
            results = {known: results[known] for known in SUBJECTS if known in results}
            write(results, out)
    write(results, out)
    return results


def run(subject: Subject, inputs: Inputs, progress: Progress) -> SubjectResults:
    """Measures a subject. A candidate that raises, or returns a number that is not finite, is a failure with the reason."""
    found = SubjectResults(subject.name)
    started, cpu_s = time.monotonic(), _cpu_s()
    if subject.tables is not None:
        items = list(subject.tables(inputs))
        found.tables = [item for item in items if isinstance(item, Table)]
        found.skipped = [item for item in items if isinstance(item, Skipped)]
    if subject.candidates is not None:
        offered = list(subject.candidates(inputs))
        found.skipped += [item for item in offered if isinstance(item, Skipped)]
        _measure(subject, [item for item in offered if isinstance(item, Candidate)], inputs.quick, found, progress)
    found.wall_s, found.cpu_s = round(time.monotonic() - started, 1), round(_cpu_s() - cpu_s, 1)
    progress(subject.title, 1, 1)
    return found


def _cpu_s() -> float:
    """CPU time of this process and of those that have ended."""
    return sum(os.times()[:4])


def _measure(subject: Subject, wanted: Sequence[Candidate], quick: bool, found: SubjectResults, progress: Progress) -> None:
    ready: dict[str, Prepared] = {}
    errors: dict[str, Samples] = {}
    turns: dict[str, Samples] = {}
    parts: dict[str, Samples] = {}
    try:
        for k, candidate in enumerate(wanted):
            progress(subject.title, k, 2 * len(wanted))
            try:
                prepared = ready[candidate.name] = candidate.prepare()
                errors[candidate.name] = _finite(prepared.errors())
                turns[candidate.name], parts[candidate.name] = {}, {}
            except Exception as error:  # report any failure of a method and continue with the others
                found.failures[candidate.name] = f"{type(error).__name__}: {error}"
        timed = {name: one.turn for name, one in ready.items() if one.turn is not None and name not in found.failures}
        _take_turns(subject, quick, timed, turns, parts, found.failures, progress)
    finally:
        for prepared in ready.values():
            prepared.close()
    for one in wanted:
        if one.name not in found.failures:
            figures = {}
            for figure in subject.figures:
                if samples := errors[one.name].get(figure.key):
                    value = figure.of(samples)
                    figures[figure.key] = Value(value, value, value)
                elif samples := turns[one.name].get(figure.key):
                    inner = parts[one.name].get(figure.key, [])
                    low, high = median_interval(samples if len(samples) >= MIN_SAMPLES or len(inner) < MIN_SAMPLES else inner)
                    figures[figure.key] = Value(figure.of(samples), low, high, len(samples), len(inner))
            found.rows.append(Row(one.name, one.curve, one.knob, one.paper, one.used, one.line, figures))


def _take_turns(
    subject: Subject, quick: bool, timed: dict[str, Callable[[], Mapping[str, float | list[float]]]], turns: dict[str, Samples],
    parts: dict[str, Samples], failures: dict[str, str], progress: Progress,
) -> None:  # fmt: skip
    """Rounds of one turn each, in a new order every round, so that other load on the machine affects all candidates alike."""
    budget_s, least = subject.budget_s[0 if quick else 1], subject.turns[0 if quick else 1]
    shuffled, started = random.Random(1), time.monotonic()

    def count(name: str) -> int:
        return max(map(len, turns[name].values()), default=0)

    def settled(name: str) -> bool:
        key = next((key for key in turns[name] if key.startswith("time")), None)
        low, high = median_interval(turns[name][key]) if key else (0.0, 0.0)
        return key is None or (count(name) >= MIN_SAMPLES and high - low <= NARROW * abs(float(np.median(turns[name][key]))))

    def take(name: str, keep: bool) -> None:
        try:
            turn = _finite({key: value if isinstance(value, list) else [value] for key, value in timed[name]().items()})
        except Exception as error:  # as above
            failures[name] = f"{type(error).__name__}: {error}"
            timed.pop(name)
            return
        for key, samples in turn.items() if keep else ():
            turns[name].setdefault(key, []).append(float(np.median(samples)))
            if len(samples) > 1:
                parts[name].setdefault(key, []).extend(samples)

    if least > LONG_TURNS:
        for name in list(timed):
            take(name, keep=False)
    while names := [name for name in timed if count(name) < least or not settled(name)]:
        elapsed_s = time.monotonic() - started
        hurried = [name for name in names if count(name) < least] if elapsed_s > budget_s else names
        if not hurried or (elapsed_s > 3 * budget_s and all(map(count, names))):
            break
        done = len(timed) - len(names) + len(names) * min(1.0, elapsed_s / budget_s)
        progress(subject.title, len(timed) + int(done), 2 * len(timed) + 1)
        shuffled.shuffle(hurried)
        for name in hurried:
            take(name, keep=True)


def _finite(samples: Samples) -> Samples:
    """samples. Raises ValueError if one is not finite."""
    if wrong := [key for key, values in samples.items() if not all(math.isfinite(value) for value in values)]:
        raise ValueError(f"not finite: {', '.join(wrong)}")
    return samples
