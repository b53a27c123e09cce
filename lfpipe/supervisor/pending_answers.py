"""Answers that wait: until the stages have applied a revision of the state, or have executed a
command. Uses no socket and no clock.
"""

import itertools
from collections.abc import Callable, Iterator

import attrs

from lfpipe.supervisor.control_sockets import Request
from lfpipe.transport.clock import SECOND_NS
from lfpipe.transport.control import Message

APPLY_NS = SECOND_NS  # time limit for the stages to apply a change before the answer
OF_THE_MESSAGE = ("v", "cmd", "number", "id")  # not of the answer
EXECUTE_NS = 2 * SECOND_NS  # time limit for the stages to execute a command


@attrs.define(kw_only=True)
class _Pending:
    """A request that waits for the stages."""

    request: Request
    answer: Message
    """Its answer so far."""
    until_ns: int
    """The latest time of the answer."""
    rev: int = 0
    """The revision that the stages apply; 0 if they execute a command."""
    on_trial: bool = False
    """Whether a rollback undoes the request."""
    missing: set[str] = attrs.field(factory=set)
    """The stages that have not executed it."""


class PendingAnswers:
    """Requests that are answered later."""

    def __init__(self) -> None:
        self._pending: dict[int, _Pending] = {}  # by the number that stages answer with
        self._numbers = itertools.count(1)

    def __bool__(self) -> bool:
        return bool(self._pending)

    def await_revision(
        self, request: Request, answer: Message, rev: int, t_ns: int, on_trial: bool
    ) -> None:
        """The answer waits until the stages have applied revision rev. t_ns: now. on_trial: whether
        a rollback undoes the request.
        """
        self._pending[next(self._numbers)] = _Pending(
            request=request,
            answer=answer,
            until_ns=t_ns + APPLY_NS,
            rev=rev,
            on_trial=on_trial,
        )

    def await_stages(self, request: Request, stages: tuple[str, ...], t_ns: int) -> int:
        """The answer is that of the stages; returns the number to send with the command."""
        number = next(self._numbers)
        self._pending[number] = _Pending(
            request=request, answer={"ok": True}, until_ns=t_ns + EXECUTE_NS, missing=set(stages)
        )
        return number

    def executed(self, stage: str, message: Message) -> None:
        """Processes a stage's answer: `number`, `ok`, and further values, which the client receives
        under `stages` and the stage's name, together with the first refusal.
        """
        number = message.get("number")
        pending = self._pending.get(number) if isinstance(number, int) else None
        if pending is None or stage not in pending.missing:
            return
        pending.missing.discard(stage)
        result = {key: value for key, value in message.items() if key not in OF_THE_MESSAGE}
        if result.pop("ok", None) is not True:
            pending.answer = {"ok": False, **result} if pending.answer["ok"] else pending.answer
        elif result and pending.answer["ok"]:
            stages = {**pending.answer.get("stages", {}), stage: result}
            pending.answer = {**pending.answer, "stages": stages}

    def refuse_changes(self, why: str) -> Iterator[tuple[Request, Message]]:
        """The answers to all requests that wait for a change that was rolled back; the others
        were not undone, and wait for the stages.
        """
        for number, pending in list(self._pending.items()):
            if pending.on_trial:
                del self._pending[number]
                yield pending.request, {"ok": False, "error": why}

    def due(self, applied: Callable[[int], bool], t_ns: int) -> Iterator[tuple[Request, Message]]:
        """The answers that wait no longer. applied: whether the stages have applied a revision."""
        for number, pending in list(self._pending.items()):
            done = applied(pending.rev) if pending.rev else not pending.missing
            if not done and t_ns <= pending.until_ns:
                continue
            del self._pending[number]
            if pending.rev:
                yield pending.request, {**pending.answer, "applied": done}
            elif done:
                yield pending.request, pending.answer
            else:
                stages = " and ".join(sorted(pending.missing))
                why = f"{stages} did not execute it within {EXECUTE_NS // SECOND_NS} s"
                remedy = "check the session: `lfpipe monitor`"
                yield pending.request, {"ok": False, "error": why, "remedy": remedy}
