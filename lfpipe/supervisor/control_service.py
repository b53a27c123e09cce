"""Requests and telemetry of a session: `Control` receives them, `Delivery` sends the answers."""

import logging
from collections.abc import Iterator, Sequence
from functools import partial

from lfpipe.errors import plain
from lfpipe.supervisor.control_sockets import ControlSockets, Request
from lfpipe.supervisor.effects import Answer, Effect, Notify, Respond, Service
from lfpipe.supervisor.pending_answers import PendingAnswers
from lfpipe.supervisor.process_table import NAMES
from lfpipe.supervisor.requests import Reply, respond
from lfpipe.supervisor.session_state import SessionState
from lfpipe.supervisor.session_store import SessionStore
from lfpipe.supervisor.stage_process import StageProcesses
from lfpipe.transport.clock import MS_NS, SECOND_NS, now_ns
from lfpipe.transport.control import EXECUTED, Message

logger = logging.getLogger(__name__)
PENDING_NS = 4 * MS_NS  # between two checks of the stages while answers wait for them
ASKED_OFTEN = ("hello", "status", "pictures")  # requests that change nothing
SHOWN_TOPICS = ("source", "notice")  # telemetry for people
LOGGED_TOPICS = ("parallax",)  # it changes with the viewer's distance
# of telemetry: more lines than a person reads, also when every stage has restarted at once
MAX_LINES, LINES_NS = 20, SECOND_NS
MAX_LINE = 2000  # characters; a line of ours has some hundred


class Control(Service):
    """Receives requests and telemetry."""

    guarded = True

    def __init__(self, sockets: ControlSockets, pending: PendingAnswers) -> None:
        self._sockets = sockets
        self._pending = pending
        self._lines = 0  # since _lines_ns
        self._lines_ns = 0

    @property
    def fds(self) -> Sequence[int]:
        return self._sockets.fds

    def wait_ns(self, t_ns: int) -> int | None:
        return self._sockets.wait_ns()

    def update(self, state: SessionState, t_ns: int) -> Iterator[Effect]:
        if t_ns > self._lines_ns + LINES_NS:
            self._lines_ns = t_ns
            self._lines = 0
        for arrived in self._sockets.arrived():
            if isinstance(arrived, Request):
                yield Respond(arrived, partial(self._reply, request=arrived))
                continue
            for effect in self._notices(arrived):
                self._lines += 1
                if self._lines <= MAX_LINES:
                    yield effect

    def _reply(self, state: SessionState, request: Request) -> Reply:
        request.decode()
        if request.command == EXECUTED and request.sender in NAMES:
            self._pending.executed(request.sender, request.message)
            return Reply(silent=True)
        level = logging.DEBUG if request.command in ASKED_OFTEN else logging.INFO
        logger.log(level, "request %.500s", request.message)
        return respond(state, request.message, now_ns(), request.sender)

    def _notices(self, message: Message) -> Iterator[Effect]:
        topic = message.get("topic")
        if topic not in (*SHOWN_TOPICS, *LOGGED_TOPICS):
            return
        notes = message.get("notes")
        for text in notes if isinstance(notes, list) and notes else [message.get("text")]:
            if isinstance(text, str) and text and topic in LOGGED_TOPICS:
                logger.info("%.500s", text)
            elif isinstance(text, str) and text:
                yield Notify(plain(text, MAX_LINE))


class Delivery(Service):
    """Sends a new state to the stages, and the answers that waited for them."""

    def __init__(
        self,
        sockets: ControlSockets,
        pending: PendingAnswers,
        store: SessionStore,
        stages: StageProcesses,
    ) -> None:
        self._sockets = sockets
        self._pending = pending
        self._store = store
        self._stages = stages

    def wait_ns(self, t_ns: int) -> int | None:
        return PENDING_NS if self._pending else None

    def update(self, state: SessionState, t_ns: int) -> Iterator[Effect]:
        if new_state := self._store.take_message():
            self._sockets.broadcast(NAMES, new_state)

        def applied(rev: int) -> bool:
            return self._stages.have_applied(rev, state.options)

        for request, answer in self._pending.due(applied, t_ns):
            yield Answer(request, answer)
