"""Executes replies: stores a state, starts a load or a check, sends commands to stages, answers."""

import logging
import traceback
from collections.abc import Callable
from functools import partial

from lfpipe.errors import UserError, plain
from lfpipe.scene.open_scene import Packing
from lfpipe.supervisor.check_service import FileChecks
from lfpipe.supervisor.control_sockets import ControlSockets, Request
from lfpipe.supervisor.effects import EndKind, Outcome
from lfpipe.supervisor.metrics import SessionMetrics
from lfpipe.supervisor.pending_answers import PendingAnswers
from lfpipe.supervisor.process_table import NAMES, SHOWN_BY
from lfpipe.supervisor.requests import Reply
from lfpipe.supervisor.scene_loads import SceneLoads, ScenePreviews
from lfpipe.supervisor.session_store import SessionStore
from lfpipe.transport.clock import now_ns
from lfpipe.transport.control import BadMessage, Message

logger = logging.getLogger(__name__)
INTERNAL = {
    "ok": False,
    "error": "internal error",
    "remedy": "report the stack in its log; the session continues",
}
REPLACED = {
    "ok": False,
    "error": "superseded by a newer load request",
    "remedy": "load it again",
    "replaced": True,
}


class ReplyExecutor:
    """Executes replies, and turns every error into an answer."""

    def __init__(
        self,
        store: SessionStore,
        sockets: ControlSockets,
        pending: PendingAnswers,
        metrics: Callable[[], SessionMetrics],
        notify: Callable[[str], None],
        packing: Packing | None,
    ) -> None:
        self._store = store
        self._sockets = sockets
        self._pending = pending
        self._metrics = metrics
        self._notify = notify
        show = partial(sockets.send, SHOWN_BY)
        self._loads = SceneLoads(show, sockets.connections, packing)
        self._previews = ScenePreviews(show)
        self._checks = FileChecks(sockets.connections)
        self.services = (self._loads, self._previews, self._checks)

    def close(self) -> None:
        """Ends the child processes."""
        for service in self.services:
            service.close()

    def respond(self, request: Request, reply: Callable[[], Reply]) -> Outcome | None:
        """Executes a reply to a request; the outcome if it ends the session."""
        try:
            return self._execute(request, reply())
        except Exception as error:
            self._refuse(request, self.refusal(error))
        return None

    def refusal(self, error: Exception) -> Message:
        """The answer for an error; a defect is logged with its stack."""
        if isinstance(error, UserError):
            answer = {"ok": False, "error": error.message, "remedy": error.remedy}
        elif isinstance(error, BadMessage):
            # parts of the text come from outside
            answer = {"ok": False, "error": plain(str(error), 2000)}
        else:
            stack = "".join(traceback.format_exception(error))
            self._notify(f"internal error while handling a message; the session continues\n{stack}")
            answer = INTERNAL
        logger.info("refused: %s", answer["error"])
        return answer

    def _refuse(self, request: Request, answer: Message) -> None:
        if request.sender in NAMES:  # nobody reads a stage's answers
            remedy = f" ({answer['remedy']})" if answer.get("remedy") else ""
            self._notify(f"{answer['error']}{remedy}")
        self.answer(request, answer)

    def answer(self, request: Request, answer: Message) -> None:
        """Answers a request."""
        self._sockets.answer(request, self._store.state.rev, answer)

    def _execute(self, request: Request, reply: Reply) -> Outcome | None:
        """Executes a reply; answers now, or when it is done."""
        if reply.silent:
            return None
        if reply.check is not None:
            self._checks.begin(request, reply.check)
        elif reply.load is not None:
            if replaced := self._loads.want(request, reply.load):
                self.answer(replaced, REPLACED)
        elif reply.executed_by:
            number = self._pending.await_stages(request, reply.executed_by, now_ns())
            for stage in reply.executed_by:  # nothing else of the request reaches a stage
                command = {"cmd": request.command, "number": number, **reply.sent}
                self._sockets.send(stage, command)
        else:
            self._answer(request, reply)
        if not reply.stop:
            return None
        closed = request.sender == SHOWN_BY
        reason = "the window was closed" if closed else "stopped by command"
        return Outcome(kind=EndKind.REQUEST, reason=reason)

    def _answer(self, request: Request, reply: Reply) -> None:
        """Stores the state of a reply, and answers once the stages have applied it."""
        if reply.previews is not None:
            self._previews.begin(reply.previews, self._store.state.config.scene)
        answer = {"ok": True, **reply.answer}
        if reply.with_stages:
            answer |= self._metrics().to_dict()
        before = self._store.state
        state = before if reply.state is None else reply.state
        self._store.apply(state)
        if state.rev == before.rev:
            self.answer(request, answer)
        else:
            on_trial = state.replaces_basis_of(before)
            self._pending.await_revision(request, answer, state.rev, now_ns(), on_trial)
