"""Runs benchmarks: errors once, times in interleaved repetitions."""

import contextlib
import importlib
import math
import os
import platform
import random
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import attrs
import cv2

from lfpipe.bench.benchmarks import BENCHMARKS, Benchmark
from lfpipe.bench.inputs import Inputs, Progress
from lfpipe.bench.results import (
    MIN_ROUNDS,
    Metrics,
    Results,
    Row,
    Table,
    Value,
    read,
    timing,
    write,
)
from lfpipe.errors import UserError
from lfpipe.files.safe_files import check_output
from lfpipe.host.files import exists
from lfpipe.host.worker import usable_cores, versions

FILES = ("results.json", "report.html")
Repetition = Callable[[], Metrics]  # takes one sample of each time
# the errors of a method, and the function that times it once; None if it is not timed
Prepared = tuple[dict[str, Value], Repetition | None]


@attrs.frozen(eq=False, kw_only=True)
class Variant:
    """A method to be measured."""

    curve: str
    parameter: str
    prepare: Callable[[], Prepared]
    paper: bool = False
    used: bool = False

    @property
    def name(self) -> str:
        return f"{self.curve}, {self.parameter}" if self.parameter else self.curve


Offer = Variant | Table | str  # text: an omitted measurement, with the reason


def measure(
    names: Sequence[str], inputs: Inputs, out: Path, progress: Progress
) -> dict[str, Results]:
    """Measures the named benchmarks, and writes out/results.json after each. Returns all results in
    it, including those of other benchmarks.

    Raises UserError if out cannot be written.
    """
    results = opened(out)
    for name in names:
        benchmark = BENCHMARKS[name]
        about = conditions()
        results[name] = run(
            benchmark,
            importlib.import_module(f"lfpipe.bench.{name}").measure(inputs),
            inputs.quick,
            progress,
        )
        results[name].about = about | inputs.about
        results = {known: results[known] for known in BENCHMARKS if known in results}
        write(results, out)
    return results


def opened(out: Path) -> dict[str, Results]:
    """Makes the folder and returns the results in it.

    Raises UserError if it contains a report.html, but no results, or results of another version.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(
            f"{out}: {error.strerror}", "choose another folder with --out DIR"
        ) from None
    if exists(out / FILES[0]):
        return read(out)
    check_output(out / FILES[1])
    return {}


def run(benchmark: Benchmark, offers: Iterable[Offer], quick: bool, progress: Progress) -> Results:
    """Measures a benchmark. A variant that raises, or returns NaN or infinity, is recorded as a
    failure.

    Every round runs one repetition of each variant in a new order, so that other load on the
    machine affects all alike. The first of more than MIN_ROUNDS does not count.
    """
    cv2.setNumThreads(1)  # as in a session
    started_s = time.monotonic()
    offered = list(offers)
    variants = [one for one in offered if isinstance(one, Variant)]
    results = Results(
        benchmark.name,
        tables=[one for one in offered if isinstance(one, Table)],
        left_out=[one for one in offered if isinstance(one, str)],
    )
    rounds = benchmark.rounds[0 if quick else 1]
    errors: dict[str, dict[str, Value]] = {}
    repetitions: dict[str, Repetition] = {}
    samples: dict[str, list[Metrics]] = {one.name: [] for one in variants}
    for k, one in enumerate(variants):
        progress(benchmark.title, k, (1 + rounds) * len(variants))
        with _failing(one.name, results):
            errors[one.name], repetition = one.prepare()
            _check({key: value.value for key, value in errors[one.name].items()})
            if repetition is not None:
                repetitions[one.name] = repetition
    shuffled = random.Random(1)
    for k in range(rounds if repetitions else 0):
        progress(benchmark.title, (1 + k) * len(variants), (1 + rounds) * len(variants))
        for name in shuffled.sample(list(repetitions), len(repetitions)):
            if name not in results.failures:
                with _failing(name, results):
                    _check(sample := repetitions[name]())
                    samples[name].append(sample)
    rows = []
    for one in variants:
        if one.name not in results.failures:
            # if there are enough, without the first repetition: caches are cold
            warm = samples[one.name][rounds > MIN_ROUNDS :]
            times = (
                {key: timing([sample[key] for sample in warm]) for key in warm[0]} if warm else {}
            )
            values = errors[one.name] | times
            rows.append(
                Row(
                    one.name,
                    values,
                    one.curve,
                    one.parameter,
                    one.paper,
                    one.used,
                    tuple(samples[one.name]),
                )
            )
    if variants:
        results.tables.insert(0, Table("method", benchmark.columns, tuple(rows)))
    results.wall_s = round(time.monotonic() - started_s, 1)
    progress(benchmark.title, 1, 1)
    return results


@contextlib.contextmanager
def _failing(name: str, results: Results) -> Iterator[None]:
    """Records any exception of a method as its result; the others continue."""
    try:
        yield
    except Exception as error:
        results.failures[name] = f"{type(error).__name__}: {error}"


def _check(metrics: Metrics) -> None:
    if wrong := [key for key, value in metrics.items() if not math.isfinite(value)]:
        raise ValueError(f"not finite: {', '.join(wrong)}")


def cpu_ms(
    call: Callable[[], object], count: int, clock_ns: Callable[[], int] = time.thread_time_ns
) -> float:
    """CPU time of this thread per call, mean of count calls; independent of other programs.
    clock_ns: time.process_time_ns counts all threads.
    """
    start_ns = clock_ns()
    for _ in range(count):
        call()
    return (clock_ns() - start_ns) / 1e6 / count


def conditions() -> dict[str, str]:
    """Conditions of the results besides their inputs: time, command, machine, versions."""
    packages = versions()
    load = f"load {os.getloadavg()[0]:.2f}"
    return {
        "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "command": " ".join(["lfpipe", *sys.argv[1:]]),
        "machine": (
            f"{packages.pop('processor')}, {len(usable_cores())} cores, {platform.system()}, {load}"
        ),
        "versions": ", ".join(f"{name} {version}" for name, version in packages.items()),
    }
