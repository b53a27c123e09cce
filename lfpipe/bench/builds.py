"""Two builds side by side: each in processes of its own, turn by turn, until it is clear what differs or the time is up."""

from __future__ import annotations

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

from lfpipe.bench.compare import Difference, Paired, error_ratios, judge, ratio, timed
from lfpipe.bench.inputs import make_inputs
from lfpipe.bench.model import Figure
from lfpipe.bench.subjects import SUBJECTS
from lfpipe.config import Config, updated
from lfpipe.errors import UserError

BUDGET_S, LEAST_ROUNDS, MOST = 60.0, 60, 3  # on a busy machine the least rounds may take MOST times the budget
LOOKS = (12, 18, 27, 40, 60, 90, 135)  # rounds after which is judged what differs
Say = Callable[[str, int, int], None]
# What of a subject is compared: the first candidate of these curves, not every setting; all of a subject that is not here.
CHOSEN: dict[str, tuple[str, ...]] = {"tracker": ("litert",), "synthesis": ("nearest", "blend", "warp", "warp2")}


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

    def send(self, **request: Any) -> None:
        """Asks without waiting; `answer` has to be called before the next one."""
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # then there is no answer, which tells why
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()

    def answer(self) -> dict[str, Any]:
        """The answer to what was sent."""
        assert self._process.stdout is not None
        answer = self._process.stdout.readline()
        if not answer:
            self._log.seek(0)
            said = self._log.read().strip().splitlines()
            raise UserError(
                f"{self._checkout}: cannot measure itself: {said[-1] if said else 'ended'}", "does `lfpipe bench` run there?"
            )
        told: dict[str, Any] = json.loads(answer)
        return told

    def ask(self, **request: Any) -> dict[str, Any]:
        """The worker's answer."""
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
    say: Say,
    inputs: Sequence[Path] = (),
    cache: Path | None = None,
    budget_s: float = BUDGET_S,
) -> list[Difference]:
    """Measures the chosen candidates of the subjects with both checkouts, in turns; what differs beyond noise.

    inputs: a scene and a sequence; the demo's where empty. cache: a folder for what is made of them, kept; without it one for
    this comparison. budget_s: of turns, less where all is clear before, more where LEAST_ROUNDS take longer. Raises UserError.
    """
    with contextlib.ExitStack() as stack:
        folder = cache or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        if cache is None:  # made once, or both would
            settings = updated(Config(), {"scene.cache_dir": str(folder)})
            make_inputs(tuple(inputs[:1]), inputs[1] if inputs else None, True, settings, say)
        say("comparing: starting both", 0, 1)
        both = Build(a, (folder, *inputs)), Build(b, (folder, *inputs))
        for build in both:
            stack.callback(build.close)
        compared = _Compared(both)
        for subject in subjects:
            compared.add(subject)
        return compared.run(say, budget_s)


@attrs.define
class _Candidate:
    """ratios: B over A of each timed figure, a value a round."""

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
        """The chosen candidates of a subject, their errors measured. Raises UserError where the builds have none in common."""
        told = self._together(prepare=subject, curves=CHOSEN.get(subject))
        before = {one.name for one in self._of}
        names = [name for name in told[0]["names"] if name in told[1]["names"] and name not in before]
        if not names:
            why = " ".join(f"{name}: {reason}" for one in told for name, reason in one["failed"].items())
            raise UserError(f"{subject}: nothing that both builds can measure", why or "another --on SCENE VIDEO")
        self._of += [_Candidate(subject, name, list(self._errors(subject, name))) for name in names]

    def _together(self, **request: Any) -> list[dict[str, Any]]:
        """Answers of both to what is not timed, worked on at the same time."""
        for build in self._both:
            build.send(**request)
        return [_sound(build.answer(), request) for build in self._both]

    def _errors(self, subject: str, name: str) -> Iterator[Paired]:
        """Pairs of all errors. Only where the builds differ is it looked at whether they repeat themselves, in every figure: one
        that is told in steps may be the same twice by chance."""
        first = self._together(errors=name)
        exact = first[0] == first[1] or first == self._together(errors=name)
        for figure in SUBJECTS[subject].figures:
            x, y = (told.get(figure.key) for told in first)
            if not x or not y:
                continue
            if exact:
                yield Paired(subject, name, figure, "error", [ratio(figure.of(x), figure.of(y))], exact=True)
            elif ratios := error_ratios(x, y):
                yield Paired(subject, name, figure, "error", ratios)

    def run(self, say: Say, budget_s: float) -> list[Difference]:
        """Rounds until all is settled or the budget ends; the judgement at the last look."""
        started, shuffled, open_ = time.monotonic(), random.Random(1), list(self._of)
        for done in range(1, LOOKS[-1] + 1):
            shuffled.shuffle(open_)
            for one in open_:
                self._round(one, swapped=done % 4 in (2, 3))  # A B, B A, B A, A B: a drift of the machine meets both alike
            gone = min(1.0, (time.monotonic() - started) / budget_s)
            say("comparing", int(100 * max(gone, 1 - len(open_) / len(self._of))), 100)
            late = gone >= 1 and (done >= LEAST_ROUNDS or time.monotonic() - started > MOST * budget_s)
            if done in LOOKS or late:
                unsettled = {(d.subject, d.candidate) for d in self._judged() if not d.settled}
                open_ = [one for one in open_ if (one.subject, one.name) in unsettled]
            if late or not open_:
                break
        say("comparing", 100, 100)
        return self._judged()

    def _round(self, one: _Candidate, swapped: bool) -> None:
        order = self._both[::-1] if swapped else self._both
        told = [_sound(build.ask(turn=one.name), {"turn": one.name}) for build in order]
        x, y = told[::-1] if swapped else told
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


def _sound(answer: dict[str, Any], request: dict[str, Any]) -> dict[str, Any]:
    """The answer. Raises UserError where what was asked for failed: a comparison without it would look like one with it."""
    if "names" not in answer and "failed" in answer:
        raise UserError(f"{next(iter(request.values()))}: {answer['failed']}", "`lfpipe bench` in that build tells more")
    return answer
