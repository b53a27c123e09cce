"""Two builds side by side: each in processes of its own, turn by turn, so that both meet the same machine.

A process has luck with its memory that lasts as long as it lives: two processes that run the same code may well differ by some
percent for good. So several pairs are started, one after the other, and a pair counts as one observation.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lfpipe.bench.compare import Difference, Paired, error_ratios, judge
from lfpipe.bench.subjects import SUBJECTS
from lfpipe.errors import UserError

PAIRS, TURNS = 12, 4
Say = Callable[[str, int, int], None]
# What of a subject is compared where nothing else is asked: the default and what stands beside it, not every setting.
CHOSEN: dict[str, tuple[str, ...]] = {
    "tracker": ("litert, 640x480", "litert, 320x240"),
    "synthesis": ("nearest, every 2nd view", "blend, every 2nd view", "warp, every 2nd view", "warp2, every 2nd view"),
}


def is_build(path: Path) -> bool:
    """Whether path is a checkout of lfpipe that can measure itself."""
    return (path / "lfpipe" / "bench" / "worker.py").is_file()


class Build:
    """A worker process of a checkout. inputs: a folder for its cache, then a scene and a sequence where not the demo's.

    Raises UserError where it fails, with what it said.
    """

    def __init__(self, checkout: Path, inputs: Sequence[Path]) -> None:
        self._checkout = checkout
        environment = {**os.environ, "PYTHONPATH": str(checkout.resolve()), "PYTHONSAFEPATH": "1"}
        self._log = tempfile.TemporaryFile("w+")  # noqa: SIM115
        self._process = subprocess.Popen(
            [sys.executable, "-m", "lfpipe.bench.worker", *map(str, inputs)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._log, text=True, env=environment,
        )  # fmt: skip

    def ask(self, **request: Any) -> dict[str, Any]:
        """The worker's answer."""
        assert self._process.stdin is not None and self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
            answer = self._process.stdout.readline()
        except BrokenPipeError:
            answer = ""
        if not answer:
            self._log.seek(0)
            said = self._log.read().strip().splitlines()
            raise UserError(
                f"{self._checkout}: cannot measure itself: {said[-1] if said else 'ended'}", "does `lfpipe bench` run there?"
            )
        told: dict[str, Any] = json.loads(answer)
        return told

    def close(self) -> None:
        """Ends the process."""
        if self._process.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self._process.stdin.close()
        self._process.wait(timeout=30)
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._log.close()


@contextlib.contextmanager
def _both(a: Path, b: Path, inputs: Sequence[Path]) -> Iterator[tuple[Build, Build]]:
    with contextlib.ExitStack() as stack:
        found = []
        for path in (a, b):
            build = Build(path, inputs)
            stack.callback(build.close)
            found.append(build)
        yield found[0], found[1]


def compare_builds(
    a: Path, b: Path, subjects: Sequence[str], say: Say, inputs: Sequence[Path] = (), pairs: int = PAIRS, turns: int = TURNS
) -> list[Difference]:
    """Measures the quick candidates of the subjects with both checkouts, in turns; what differs beyond noise.

    inputs: a scene and a sequence; the demo's where empty. Raises UserError.
    """
    found: list[Paired] = []
    with tempfile.TemporaryDirectory() as folder:
        for subject in subjects:
            found += _compared(subject, (a, b), (Path(folder), *inputs), say, pairs, turns)
    return judge(found)


def _compared(
    subject: str, checkouts: tuple[Path, Path], inputs: Sequence[Path], say: Say, pairs: int, turns: int
) -> Iterator[Paired]:
    figures = SUBJECTS[subject].figures
    errors: dict[str, list[dict[str, list[float]]]] = {}
    ratios: dict[tuple[str, str], list[list[float]]] = {}
    for k in range(pairs):
        say(f"comparing {subject}", k, pairs)
        order = checkouts if k % 2 == 0 else checkouts[::-1]
        with _both(*order, inputs) as started:
            both = started if k % 2 == 0 else started[::-1]
            names = _prepared(subject, both)
            for name in names:
                if k == 0:
                    errors[name] = [build.ask(errors=name) for build in both]
                for build in both:
                    build.ask(turn=name)  # warm-up
            times: dict[tuple[str, str], list[float]] = {}
            for turn in range(turns):
                for name in names:
                    first, second = both if turn % 2 == 0 else both[::-1]
                    told = [first.ask(turn=name), second.ask(turn=name)]
                    x, y = told if turn % 2 == 0 else told[::-1]
                    for figure in figures:
                        if figure.key in x and figure.key in y and "p95" not in figure.key and x[figure.key] > 0:
                            times.setdefault((name, figure.key), []).append(y[figure.key] / x[figure.key])
        for place, values in times.items():
            ratios.setdefault(place, []).append([float(np.median(values))])
    say(f"comparing {subject}", pairs, pairs)
    for figure in figures:
        for name, (x, y) in errors.items():
            if figure.key in x and figure.key in y and (found := error_ratios(x[figure.key], y[figure.key])):
                yield Paired(subject, name, figure, "error", [[ratio] for ratio in found])
        for (name, key), groups in ratios.items():
            if key == figure.key:
                yield Paired(subject, name, figure, "time", groups)


def _prepared(subject: str, both: tuple[Build, Build]) -> list[str]:
    """Names of the candidates that both builds can measure."""
    told = [build.ask(prepare=subject, candidates=CHOSEN.get(subject)) for build in both]
    names = [name for name in told[0]["names"] if name in told[1]["names"]]
    if not names:
        raise UserError(f"{subject}: nothing that both builds can measure", f"{told[0].get('failed')} {told[1].get('failed')}")
    return names
