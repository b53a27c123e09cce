"""Compares two builds, each in its own processes, in turns, until all differences are settled or the time is up."""

import contextlib
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import attrs

from lfpipe.bench.comparison import Difference, Paired, error_ratios, judge, ratio, timed
from lfpipe.bench.inputs import make_inputs
from lfpipe.bench.model import Figure
from lfpipe.bench.subjects import SUBJECTS
from lfpipe.config import Config, updated
from lfpipe.errors import UserError

BUDGET_S, MIN_ROUNDS, MAX_OVERRUN = 60.0, 60, 3  # MIN_ROUNDS may take up to MAX_OVERRUN budgets on a busy machine
LOOKS = (12, 18, 27, 40, 60, 90, 135)  # differences are judged after these rounds
Progress = Callable[[str, int, int], None]
# Only the first candidate of these curves is compared in these subjects; in others, every candidate.
CURVES: dict[str, tuple[str, ...]] = {"tracker": ("litert",), "synthesis": ("nearest", "blend", "warp", "warp2", "best")}


def is_build(path: Path) -> bool:
    """Whether path is a checkout of lfpipe that can measure itself."""
    return os.path.isfile(path / "lfpipe" / "bench" / "worker.py")  # noqa: PTH113 - no error for a name that is too long


class Build:
    """A worker process of a checkout. inputs: a folder for its cache, then a scene and a sequence if not the demo's.

    Raises UserError with the worker's last words if it fails.
    """

    def __init__(self, checkout: Path, inputs: Sequence[Path]) -> None:
        self._checkout = checkout
        environment = {**os.environ, "PYTHONPATH": str(checkout.resolve()), "PYTHONSAFEPATH": "1"}
        self._log = tempfile.TemporaryFile("w+")  # noqa: SIM115
        self._process = subprocess.Popen(
            [sys.executable, "-m", "lfpipe.bench.worker", *map(str, inputs)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._log, text=True, env=environment,
        )  # fmt: skip

    def send(self, **request: Any) -> None:
        """Sends a request; call `answer` before sending the next."""
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # then there is no answer, and `answer` reports why
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()

    def answer(self) -> dict[str, Any]:
        """The answer to the last request."""
        assert self._process.stdout is not None
        answer = self._process.stdout.readline()
        if not answer:
            self._log.seek(0)
            said = self._log.read().strip().splitlines()
            why = said[-1] if said else "it exited"
            raise UserError(f"{self._checkout}: its benchmark fails: {why}", "check that `lfpipe bench` runs there")
        decoded: dict[str, Any] = json.loads(answer)
        return decoded

    def ask(self, **request: Any) -> dict[str, Any]:
        """Sends a request and returns the answer."""
        self.send(**request)
        return self.answer()

    def close(self) -> None:
        """Ends the process."""
        if self._process.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self._process.stdin.close()
        self._process.wait(timeout=30)
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._log.close()


def compare_builds(
    a: Path,
    b: Path,
    subjects: Sequence[str],
    progress: Progress,
    inputs: Sequence[Path] = (),
    cache: Path | None = None,
    budget_s: float = BUDGET_S,
) -> list[Difference]:
    """Measures the compared candidates of the subjects with both checkouts, in turns.

    inputs: a scene and a sequence; the demo's if empty. cache: a folder for generated files; temporary if None. budget_s: for
    turns; it ends earlier if all is settled, later if MIN_ROUNDS take longer. Raises UserError.
    """
    with contextlib.ExitStack() as stack:
        folder = cache or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        if cache is None:  # generate the files once, not in both
            settings = updated(Config(), {"scene.cache_dir": str(folder)})
            make_inputs(tuple(inputs[:1]), inputs[1] if inputs else None, True, settings, progress)
        progress("comparing: starting both", 0, 1)
        both = Build(a, (folder, *inputs)), Build(b, (folder, *inputs))
        for build in both:
            stack.callback(build.close)
        compared = _Compared(both)
        for subject in subjects:
            compared.add(subject)
        return compared.run(progress, budget_s)


@attrs.define
class _Candidate:
    """ratios: B over A of each timed figure, one per round."""

    subject: str
    name: str
    errors: list[Paired]
    ratios: dict[str, list[float]] = attrs.Factory(dict)


class _Compared:
    """Candidates of two builds, measured in rounds."""

    def __init__(self, both: tuple[Build, Build]) -> None:
        self._both = both
        self._of: list[_Candidate] = []

    def add(self, subject: str) -> None:
        """Adds a subject's compared candidates and measures their errors. Raises UserError if the builds share none."""
        answers = self._together(prepare=subject, curves=CURVES.get(subject))
        before = {one.name for one in self._of}
        names = [name for name in answers[0]["names"] if name in answers[1]["names"] and name not in before]
        if not names:
            why = " ".join(f"{name}: {reason}" for one in answers for name, reason in one["failed"].items())
            raise UserError(f"{subject}: the two builds have no subject in common", why or "try another --on SCENE VIDEO")
        self._of += [_Candidate(subject, name, list(self._errors(subject, name))) for name in names]

    def _together(self, **request: Any) -> list[dict[str, Any]]:
        """Answers of both builds to an untimed request, computed in parallel."""
        for build in self._both:
            build.send(**request)
        return [_checked(build.answer(), request) for build in self._both]

    def _errors(self, subject: str, name: str) -> Iterator[Paired]:
        """Pairs of all errors. If the builds differ, a second measurement shows whether both repeat their samples exactly, in all
        figures: a single quantised figure may repeat by chance."""
        first = self._together(errors=name)
        exact = first[0] == first[1] or first == self._together(errors=name)
        for figure in SUBJECTS[subject].figures:
            x, y = (samples.get(figure.key) for samples in first)
            if not x or not y:
                continue
            if exact:
                yield Paired(subject, name, figure, "error", [ratio(figure.of(x), figure.of(y))], exact=True)
            elif ratios := error_ratios(x, y):
                yield Paired(subject, name, figure, "error", ratios)

    def run(self, progress: Progress, budget_s: float) -> list[Difference]:
        """Takes rounds until all is settled or the budget is spent; returns the last judgement."""
        started, shuffled, open_ = time.monotonic(), random.Random(1), list(self._of)
        for done in range(1, LOOKS[-1] + 1):
            shuffled.shuffle(open_)
            for one in open_:
                self._round(one, swapped=done % 4 in (2, 3))  # A B, B A, B A, A B cancels a drift of the machine
            spent = min(1.0, (time.monotonic() - started) / budget_s)
            progress("comparing", int(100 * max(spent, 1 - len(open_) / len(self._of))), 100)
            late = spent >= 1 and (done >= MIN_ROUNDS or time.monotonic() - started > MAX_OVERRUN * budget_s)
            if done in LOOKS or late:
                unsettled = {(d.subject, d.candidate) for d in self._judged() if not d.settled}
                open_ = [one for one in open_ if (one.subject, one.name) in unsettled]
            if late or not open_:
                break
        progress("comparing", 100, 100)
        return self._judged()

    def _round(self, one: _Candidate, swapped: bool) -> None:
        order = self._both[::-1] if swapped else self._both
        turns = [_checked(build.ask(turn=one.name), {"turn": one.name}) for build in order]
        x, y = turns[::-1] if swapped else turns
        for figure in SUBJECTS[one.subject].figures:
            if figure.key in x and figure.key in y and timed(figure):
                one.ratios.setdefault(figure.key, []).append(ratio(x[figure.key], y[figure.key]))

    def _judged(self) -> list[Difference]:
        pairs: list[Paired] = []
        for one in self._of:
            figures: dict[str, Figure] = {figure.key: figure for figure in SUBJECTS[one.subject].figures}
            pairs += one.errors
            pairs += [Paired(one.subject, one.name, figures[key], "time", ratios) for key, ratios in one.ratios.items()]
        return judge(pairs, len(LOOKS) + 1)


def _checked(answer: dict[str, Any], request: dict[str, Any]) -> dict[str, Any]:
    """The answer. Raises UserError if the request failed: without it the comparison would be incomplete."""
    if "names" not in answer and "failed" in answer:
        raise UserError(f"{next(iter(request.values()))}: {answer['failed']}", "run `lfpipe bench` in that build for details")
    return answer
