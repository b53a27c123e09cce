"""Measures subjects: errors once, times in turns until the budget is spent."""

import importlib
import math
import os
import platform
import random
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import attrs
import cv2
import numpy as np

from lfpipe.bench.inputs import Inputs, Progress
from lfpipe.bench.results import MIN_SAMPLES, Results, Row, Table, Value, read, write
from lfpipe.bench.subjects import SUBJECTS, Subject
from lfpipe.errors import UserError
from lfpipe.files.output import check_output
from lfpipe.host.machine import versions
from lfpipe.host.processes import usable_cores

LONG_TURNS = 3  # a subject with at most this many turns has long turns and no warm-up
FILES = ("results.json", "report.html")
Samples = dict[str, list[float]]  # by the key of a column
Turn = Callable[[], Mapping[str, float]]  # one timed turn: a sample per column


@attrs.frozen(eq=False)
class Candidate:
    """A method to be measured. prepare: returns the samples of its errors, and its turn; None if nothing is timed."""

    curve: str
    knob: str
    prepare: Callable[[], tuple[Samples, Turn | None]]
    paper: bool = False
    used: bool = False

    @property
    def name(self) -> str:
        return f"{self.curve}, {self.knob}" if self.knob else self.curve


Offer = Candidate | Table | str  # a text says what is left out, and why


def measure(names: Sequence[str], inputs: Inputs, out: Path, progress: Progress) -> dict[str, Results]:
    """Measures the named subjects, and writes out/results.json after each. Returns all results in it: other subjects' stay.

    Raises UserError if out cannot be written.
    """
    results = opened(out)
    for name in names:
        subject, about = SUBJECTS[name], conditions()
        results[name] = run(subject, importlib.import_module(f"lfpipe.bench.{name}").measure(inputs), inputs.quick, progress)
        results[name].about = about | inputs.about
        results = {known: results[known] for known in SUBJECTS if known in results}
        write(results, out)
    return results


def opened(out: Path) -> dict[str, Results]:
    """Makes the folder and returns the results in it. Raises UserError if it has files of these names that are not ours."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{out}: {error.strerror}", "choose another folder with --out DIR") from None
    for name in FILES:
        check_output(out / name)
    try:
        return read(out)
    except UserError:  # nothing yet, or of another version
        return {}


def run(subject: Subject, offers: Iterable[Offer], quick: bool, progress: Progress) -> Results:
    """Measures a subject. A candidate that raises, or returns a number that is not finite, is a failure with the reason."""
    cv2.setNumThreads(1)  # as in a session
    results, started, cpu_s = Results(subject.name), time.monotonic(), sum(os.times()[:4])
    candidates: list[Candidate] = []
    for offer in offers:
        if isinstance(offer, Candidate):
            candidates.append(offer)
        elif isinstance(offer, Table):
            results.tables.append(offer)
        else:
            results.left_out.append(offer)
    samples: dict[str, Samples] = {}
    turns: dict[str, Turn] = {}
    for k, one in enumerate(candidates):
        progress(subject.title, k, 2 * len(candidates))
        try:
            errors, turn = one.prepare()
            samples[one.name] = _finite(errors)
        except Exception as error:  # report any failure of a method and continue with the others
            results.failures[one.name] = f"{type(error).__name__}: {error}"
        else:
            turns |= {one.name: turn} if turn is not None else {}
    times = _take_turns(subject, quick, turns, results.failures, progress)
    if candidates:
        measured = [one for one in candidates if one.name not in results.failures]
        rows = [
            Row(one.name, _values(subject, samples[one.name], times.get(one.name, {})), one.curve, one.knob, one.paper, one.used)
            for one in measured
        ]
        results.tables.insert(0, Table("method", subject.columns, tuple(rows)))
    results.wall_s, results.cpu_s = round(time.monotonic() - started, 1), round(sum(os.times()[:4]) - cpu_s, 1)
    progress(subject.title, 1, 1)
    return results


def _values(subject: Subject, errors: Samples, times: Samples) -> dict[str, Value]:
    values = {column.key: Value(column.of(errors[column.key])) for column in subject.columns if errors.get(column.key)}
    for column in subject.columns:
        if column.key in times:
            taken = times[column.key]
            values[column.key] = Value(column.of(taken), *median_interval(taken), len(taken))
    return values


def _take_turns(
    subject: Subject, quick: bool, turns: dict[str, Turn], failures: dict[str, str], progress: Progress
) -> dict[str, Samples]:
    """Samples by method. Rounds of one turn each, in a new order every round: other load on the machine affects all alike."""
    budget_s, least = subject.budget_s[0 if quick else 1], subject.turns[0 if quick else 1]
    shuffled, started, rounds = random.Random(1), time.monotonic(), -1 if least > LONG_TURNS else 0  # the first is a warm-up
    taken: dict[str, Samples] = {name: {} for name in turns}
    while turns and (rounds < least or time.monotonic() - started < budget_s):
        done = min(rounds / least, (time.monotonic() - started) / budget_s)
        progress(subject.title, len(turns) + int(done * len(turns)), 2 * len(turns) + 1)
        for name in shuffled.sample(list(turns), len(turns)):
            try:
                sample = _finite({key: [value] for key, value in turns[name]().items()})
            except Exception as error:  # as above
                failures[name] = f"{type(error).__name__}: {error}"
                turns.pop(name)
                continue
            for key, values in sample.items() if rounds >= 0 else ():
                taken[name].setdefault(key, []).extend(values)
        rounds += 1
    return taken


def _finite(samples: Samples) -> Samples:
    """samples. Raises ValueError if one is not finite."""
    if wrong := [key for key, values in samples.items() if not all(map(math.isfinite, values))]:
        raise ValueError(f"not finite: {', '.join(wrong)}")
    return samples


def median_interval(samples: Sequence[float]) -> tuple[float, float]:
    """95 % interval of the median by order statistics, for any distribution; the range below MIN_SAMPLES samples."""
    ordered, n = sorted(samples), len(samples)
    if n < MIN_SAMPLES:
        return ordered[0], ordered[-1]
    tail = np.cumsum([math.comb(n, k) / 2**n for k in range(n // 2)])
    k = int(np.searchsorted(tail, 0.025, side="right"))
    return ordered[k - 1], ordered[n - k]


def times_ms(call: Callable[[], object], count: int) -> list[float]:
    """Time of each of count calls, in ms."""
    times = []
    for _ in range(count):
        start = time.perf_counter_ns()
        call()
        times.append((time.perf_counter_ns() - start) / 1e6)
    return times


def time_figures(times: Sequence[float], unit: str = "ms", scale: float = 1.0) -> dict[str, float]:
    """The figures time_UNIT (median) and time_p95_UNIT of times, multiplied by scale."""
    p50, p95 = np.percentile(times, (50, 95)) * scale
    return {f"time_{unit}": float(p50), f"time_p95_{unit}": float(p95)}


def conditions() -> dict[str, str]:
    """What results depend on besides their inputs: time, command, machine, versions."""
    packages = versions()
    load = f", load {os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else ""
    machine = f"{packages.pop('processor')}, {len(usable_cores())} cores, {platform.system()} {platform.release()}{load}"
    return {
        "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "command": " ".join(["lfpipe", *sys.argv[1:]]),
        "machine": machine,
        "versions": ", ".join(f"{name} {version}" for name, version in packages.items()),
    }
