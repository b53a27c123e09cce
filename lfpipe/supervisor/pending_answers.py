"""Answers that wait: until the stages have applied a revision of the state, or have executed a
command. Uses no socket and no clock.
"""

import itertools
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import attrs

from lfpipe.supervisor.control_sockets import Request
from lfpipe.transport.clock import SECOND_NS

APPLY_NS = SECOND_NS  # time limit for the stages to apply a change before the answer
EXECUTE_NS = 2 * SECOND_NS  # time limit for the stages to execute a command
Answer = dict[str, Any]


@attrs.define
class _Change:
    """A request whose answer waits until the stages have applied a revision."""

    request: Request
    answer: Answer
    rev: int
    until_ns: int


@attrs.define
class _Act:
    """A request whose answer waits until stages have executed its command."""

    request: Request
    missing: set[str]  # stages that have not answered yet
    answer: Answer  # of those that have
    until_ns: int


class PendingAnswers:
    """Requests that are answered later."""

    def __init__(self) -> None:
        self._changes: deque[_Change] = deque()  # by revision, so by time as well
        self._acts: dict[int, _Act] = {}  # by the number that the stages answer with
        self._numbers = itertools.count(1)

    def __bool__(self) -> bool:
        return bool(self._changes or self._acts)

    def await_revision(self, request: Request, answer: Answer, rev: int, t_ns: int) -> None:
        """The answer waits until the stages have applied revision rev. t_ns: now."""
        self._changes.append(_Change(request, answer, rev, t_ns + APPLY_NS))

    def await_stages(self, request: Request, stages: tuple[str, ...], t_ns: int) -> int:
        """The answer is that of the stages; returns the number to send with the command."""
        number = next(self._numbers)
        self._acts[number] = _Act(request, set(stages), {"ok": True}, t_ns + EXECUTE_NS)
        return number

    def executed(self, stage: str, message: dict[str, Any]) -> None:
        """Takes a stage's answer: `number`, `ok`, and what else its client receives."""
        number = message.get("number")
        act = self._acts.get(number) if isinstance(number, int) else None
        if act is None or stage not in act.missing:
            return
        act.missing.discard(stage)
        refused = not act.answer["ok"]
        kept = act.answer if refused else {}
        act.answer |= {
            key: value for key, value in message.items() if key not in ("v", "cmd", "number", "id")
        } | kept

    def refuse_changes(self, why: str) -> Iterator[tuple[Request, Answer]]:
        """The answers to all that wait for a change: it was rolled back."""
        while self._changes:
            yield self._changes.popleft().request, {"ok": False, "error": why}

    def due(self, applied: Callable[[int], bool], t_ns: int) -> Iterator[tuple[Request, Answer]]:
        """The answers that wait no longer. applied: whether the stages have applied a revision."""
        while self._changes:
            change = self._changes[0]
            done = applied(change.rev)
            if not done and t_ns <= change.until_ns:
                break
            self._changes.popleft()
            yield change.request, {**change.answer, "applied": done}
        for number, act in list(self._acts.items()):
            if not act.missing:
                yield self._acts.pop(number).request, act.answer
            elif t_ns > act.until_ns:
                stages = " and ".join(sorted(act.missing))
                why = f"{stages} did not execute it within {EXECUTE_NS // SECOND_NS} s"
                remedy = "see what the session does: `lfpipe monitor`"
                yield self._acts.pop(number).request, {"ok": False, "error": why, "remedy": remedy}
