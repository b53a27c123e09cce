"""Requests and telemetry of a session: `Control` receives them, `Delivery` sends the answers."""

import logging
from collections.abc import Iterator, Sequence
from functools import partial

import zmq

from lfpipe.supervisor.control_sockets import ControlSockets, Request
from lfpipe.supervisor.effects import Answer, Effect, Notify, Respond, Service
from lfpipe.supervisor.pending_answers import PendingAnswers
from lfpipe.supervisor.process_table import NAMES
from lfpipe.supervisor.requests import Reply, respond
from lfpipe.supervisor.session_state import SessionState
from lfpipe.supervisor.session_store import SessionStore
from lfpipe.supervisor.stage_process import StageProcesses
from lfpipe.transport.clock import MS_NS, now_ns
from lfpipe.transport.control import EXECUTED, Message

logger = logging.getLogger(__name__)
PENDING_NS = 4 * MS_NS  # between two checks of the stages while answers wait for them
ASKED_OFTEN = ("hello", "status", "pictures")  # requests that change nothing
SHOWN_TOPICS = ("source", "notice")  # telemetry for people
LOGGED_TOPICS = ("parallax",)  # it changes with the viewer's distance


class Control(Service):
    """Receives requests and telemetry."""

    guarded = True

    def __init__(self, sockets: ControlSockets, pending: PendingAnswers) -> None:
        self._sockets = sockets
        self._pending = pending

    @property
    def fds(self) -> Sequence[int | zmq.Socket[bytes]]:
        return self._sockets.pollable()

    def wait_ns(self, t_ns: int) -> int:
        return self._sockets.rest_ns() or super().wait_ns(t_ns)

    def update(self, state: SessionState, t_ns: int) -> Iterator[Effect]:
        for request in self._sockets.requests():
            yield Respond(request, partial(self._reply, request=request))
        for message in self._sockets.telemetry():
            yield from self._notices(message)
        self._sockets.update_connections()

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
                logger.info(text)
            elif isinstance(text, str) and text:
                yield Notify(text)


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

    def wait_ns(self, t_ns: int) -> int:
        return PENDING_NS if self._pending else super().wait_ns(t_ns)

    def update(self, state: SessionState, t_ns: int) -> Iterator[Effect]:
        if new_state := self._store.take_message():
            self._sockets.broadcast(NAMES, new_state)

        def applied(rev: int) -> bool:
            return self._stages.have_applied(rev, state.options)

        for request, answer in self._pending.due(applied, t_ns):
            yield Answer(request, answer)
