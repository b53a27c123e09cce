"""Measures subjects: errors once, times in turns until the budget is spent."""

import importlib
import math
import os
import platform
import random
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import attrs
import cv2
import numpy as np

import lfpipe
from lfpipe.bench.inputs import Inputs, Progress
from lfpipe.bench.results import MIN_SAMPLES, Results, Row, Table, Value, exact, read, write
from lfpipe.bench.subjects import SUBJECTS, Subject
from lfpipe.errors import UserError
from lfpipe.files.output import check_output
from lfpipe.host.machine import versions
from lfpipe.host.processes import usable_cores

LONG_TURNS = 3  # a subject with at most this many turns has long turns and no warm-up
FILES = ("results.json", "report.html")
Samples = dict[str, list[float]]  # by the key of a column
Turn = Callable[[], Mapping[str, float | list[float]]]  # one timed turn: a sample per column, or those of its parts if it is long


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


Found = Candidate | Table | str
Measure = Callable[[Inputs], Iterator[Found]]


def measure(names: Sequence[str], inputs: Inputs, out: Path, progress: Progress) -> dict[str, Results]:
    """Measures the named subjects, and writes out/results.json after each. Returns all results in it: other subjects' stay.

    Raises UserError if out cannot be written.
    """
    cv2.setNumThreads(1)
    results = opened(out)
    for name in names:
        subject = SUBJECTS[name]
        started = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        found: Measure = importlib.import_module(f"lfpipe.bench.{name}").measure
        results[name] = run(subject, found, inputs, progress)
        results[name].about = {"started": started, **conditions(), **inputs.described(subject.needs)}
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


def run(subject: Subject, found: Measure, inputs: Inputs, progress: Progress) -> Results:
    """Measures a subject. A candidate that raises, or returns a number that is not finite, is a failure with the reason."""
    results = Results(subject.name)
    started, cpu_s = time.monotonic(), sum(os.times()[:4])
    items = list(found(inputs))
    results.tables = [item for item in items if isinstance(item, Table)]
    results.left_out = [item for item in items if isinstance(item, str)]
    if candidates := {item.name: item for item in items if isinstance(item, Candidate)}:
        rows = _rows(subject, candidates, inputs.quick, results.failures, progress)
        results.tables.insert(0, Table("method", subject.columns, tuple(rows)))
    results.wall_s, results.cpu_s = round(time.monotonic() - started, 1), round(sum(os.times()[:4]) - cpu_s, 1)
    progress(subject.title, 1, 1)
    return results


def _rows(
    subject: Subject, candidates: dict[str, Candidate], quick: bool, failures: dict[str, str], progress: Progress
) -> list[Row]:
    errors: dict[str, Samples] = {}
    turns: dict[str, Turn] = {}
    for k, (name, candidate) in enumerate(candidates.items()):
        progress(subject.title, k, 2 * len(candidates))
        try:
            samples, turn = candidate.prepare()
            errors[name] = _finite(samples)
        except Exception as error:  # report any failure of a method and continue with the others
            failures[name] = f"{type(error).__name__}: {error}"
            continue
        turns |= {name: turn} if turn is not None else {}
    taken = _take_turns(subject, quick, turns, failures, progress)
    rows = []
    for name in (name for name in candidates if name not in failures):
        values = {}
        for column in subject.columns:
            if samples_ := errors[name].get(column.key):
                values[column.key] = exact(column.of(samples_))
            elif medians := [float(np.median(turn[column.key])) for turn in taken.get(name, []) if column.key in turn]:
                parts = [x for turn in taken[name] for x in turn.get(column.key, []) if len(turn[column.key]) > 1]
                interval = median_interval(medians if len(medians) >= MIN_SAMPLES or len(parts) < MIN_SAMPLES else parts)
                values[column.key] = Value(column.of(medians), *interval, len(medians), len(parts))
        one = candidates[name]
        rows.append(Row(name, values, one.curve, one.knob, one.paper, one.used))
    return rows


def _take_turns(
    subject: Subject, quick: bool, turns: dict[str, Turn], failures: dict[str, str], progress: Progress
) -> dict[str, list[Samples]]:
    """Samples by turn. Rounds of one turn each, in a new order every round: other load on the machine affects all alike."""
    budget_s, least = subject.budget_s[0 if quick else 1], subject.turns[0 if quick else 1]
    shuffled, started, rounds = random.Random(1), time.monotonic(), -1 if least > LONG_TURNS else 0  # the first is a warm-up
    taken: dict[str, list[Samples]] = {name: [] for name in turns}
    while turns and (rounds < least or time.monotonic() - started < budget_s):
        done = min(rounds / least, (time.monotonic() - started) / budget_s)
        progress(subject.title, len(turns) + int(done * len(turns)), 2 * len(turns) + 1)
        for name in shuffled.sample(list(turns), len(turns)):
            try:
                turn = turns[name]().items()
                turn_samples = _finite({key: value if isinstance(value, list) else [value] for key, value in turn})
            except Exception as error:  # as above
                failures[name] = f"{type(error).__name__}: {error}"
                turns.pop(name)
            else:
                taken[name] += [turn_samples] if rounds >= 0 else []
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
    """What results depend on besides their inputs: command, machine, versions, commit."""
    packages = versions()
    load = f", load {os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else ""
    machine = f"{packages.pop('processor')}, {len(usable_cores())} cores, {platform.system()} {platform.release()}{load}"
    try:
        git = ["git", "-C", str(Path(lfpipe.__file__).parent), "describe", "--always", "--dirty", "--abbrev=12"]
        commit = subprocess.run(git, capture_output=True, text=True, timeout=5, check=False).stdout.strip()
    except (OSError, subprocess.TimeoutExpired):
        commit = ""
    return {
        "command": " ".join(["lfpipe", *sys.argv[1:]]),
        "machine": machine,
        "versions": ", ".join(f"{name} {version}" for name, version in packages.items()),
        "commit": commit or "not a git checkout",
    }
