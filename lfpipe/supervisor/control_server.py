"""The supervisor's sockets: receives requests on ctl, answers them, and forwards telemetry from bus to tap. Never blocks.

No request or message can end the session: an unexpected exception is answered as an internal error, and its stack is logged.
"""

import contextlib
import logging
import traceback
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import attrs
import zmq

from lfpipe.errors import UserError
from lfpipe.host import endpoints
from lfpipe.supervisor.connection_limit import ConnectionLimit
from lfpipe.supervisor.file_checker import FileChecker
from lfpipe.supervisor.process_table import NAMES, SHOWN_BY
from lfpipe.supervisor.requests import Reply, respond, respond_checked
from lfpipe.supervisor.session_store import SessionStore
from lfpipe.supervisor.throttled_socket import ThrottledSocket
from lfpipe.transport import control
from lfpipe.transport.clock import MS_NS, SECOND_NS, now_ns
from lfpipe.transport.control import BadMessage
from lfpipe.transport.session import Session

logger = logging.getLogger(__name__)
APPLY_NS = SECOND_NS  # time limit for the stages to apply a change before the answer
APPLY_POLL_MS = 4  # polling period meanwhile
STEP_NS = SECOND_NS // 5  # between two reports of progress
ASKED_OFTEN = ("hello", "status", "pictures")  # requests that change nothing
MAX_ERROR_CHARS, MAX_NAME_CHARS = 2000, 200
INTERNAL = {"ok": False, "error": "internal error", "remedy": "the session continues; please report the stack in its log"}


@attrs.define
class _Waiting:
    """A client whose answer waits until the stages have applied revision rev."""

    client: bytes
    answer: dict[str, Any]
    rev: int
    until_ns: int


@attrs.define
class _Checking:
    """A client whose request waits for a check of its files."""

    client: bytes
    message: dict[str, Any]
    checker: FileChecker
    step: str = ""  # reported last
    report_ns: int = 0  # of the next


class ControlServer:
    """ctl, bus and tap of a session, bound in its run directory.

    applied: whether every stage has applied a revision. stages: returns the figures of the stages. stop: ends the session.
    hear: receives telemetry. log: receives lines for people. Raises UserError if a socket cannot be bound.
    """

    def __init__(
        self,
        ctx: zmq.Context[zmq.Socket[bytes]],
        session: Session,
        store: SessionStore,
        applied: Callable[[int], bool],
        stages: Callable[[], dict[str, Any]],
        stop: Callable[[], None],
        hear: Callable[[dict[str, Any]], None],
        log: Callable[[str], None],
    ) -> None:
        self._store, self._applied, self._stages = store, applied, stages
        self._stop, self._hear, self._log = stop, hear, log
        self._ctl, self._bus, self._tap = (ctx.socket(kind) for kind in (zmq.ROUTER, zmq.PULL, zmq.XPUB))
        self._ctl.setsockopt(zmq.ROUTER_HANDOVER, 1)  # a restarted stage reconnects under its old name
        named = {"ctl": self._ctl, "bus": self._bus, "tap": self._tap}
        self._connections = ConnectionLimit(named.values(), log)
        for name, socket in named.items():
            control.limit(socket)
            endpoints.bind(socket, session.run_dir, name)
        self._requests, self._telemetry = ThrottledSocket(self._ctl), ThrottledSocket(self._bus)
        self._waiting: deque[_Waiting] = deque()  # by revision, so by time as well
        self._checking: list[_Checking] = []

    def close(self) -> None:
        """Ends the running checks and closes the sockets."""
        for checking in self._checking:
            checking.checker.close()
        self._connections.close()
        for socket in (self._ctl, self._bus, self._tap):
            socket.close()

    def register(self, poller: zmq.Poller) -> None:
        """Registers what should wake the supervisor now."""
        for intake in (self._requests, self._telemetry):
            if not intake.rest_ns():
                poller.register(intake.socket, zmq.POLLIN)
        for each in self._connections.sockets:
            poller.register(each, zmq.POLLIN)
        for checking in self._checking:
            for fd in checking.checker.fds:
                poller.register(fd, zmq.POLLIN)

    def wait_ms(self, most_ms: int) -> int:
        """How long the supervisor may sleep, at most most_ms, unless a registered descriptor wakes it."""
        rests = [intake.rest_ns() // MS_NS + 1 for intake in (self._requests, self._telemetry) if intake.rest_ns()]
        return min([most_ms, *rests, *([APPLY_POLL_MS] if self._waiting else [])])

    def send(self, stage: str, message: bytes) -> None:
        """Sends an encoded message to one stage. It is lost if the stage is not connected; the stage will send hello later."""
        self._ctl.send_multipart([stage.encode(), message], zmq.NOBLOCK)

    def broadcast(self, message: bytes) -> None:
        """Sends an encoded message to every stage."""
        for name in NAMES:
            self.send(name, message)

    def flush(self) -> None:
        """Broadcasts the state if it is new."""
        if message := self._store.take_message():
            self.broadcast(message)

    def publish(self, topic: str, **values: Any) -> None:
        """Sends a message to every subscriber of the tap."""
        self._tap.send(control.encode({"topic": topic, "t_ns": now_ns(), **values}), zmq.NOBLOCK)

    def serve(self) -> None:
        """Processes arrived messages, within its share of time."""
        for identity, *parts in self._requests.messages():
            self._guard(identity, lambda client=identity, parts=parts: self._take(client, parts))  # type: ignore[misc]
        for parts in self._telemetry.messages():
            self._guard(None, lambda parts=parts: self._pass_on(parts))  # type: ignore[misc]
        while self._tap.poll(0):
            self._tap.recv()  # discard subscription messages, which would accumulate
        self._connections.serve()
        for checking in list(self._checking):
            checking.checker.read()
            self._report_step(checking, checking.checker.progress)
            if checking.checker.done:
                self._checking.remove(checking)
                self._report_step(checking, "")
                self._guard(checking.client, lambda each=checking: self._checked(each))  # type: ignore[misc]
        self.flush()
        self._answer_applied()

    def _report_step(self, checking: _Checking, step: str) -> None:
        """Sends the stage that shows pictures how far a scene is loaded, whoever asked for it; "" at the end."""
        if checking.message["cmd"] == "load" and step != checking.step and (not step or now_ns() >= checking.report_ns):
            checking.step, checking.report_ns = step, now_ns() + STEP_NS
            scene = Path(checking.checker.path).name[:MAX_NAME_CHARS]
            self.send(SHOWN_BY, control.encode({"cmd": "loading", "scene": scene, "step": step}))

    def refuse_waiting(self, why: str) -> None:
        """Answers every client that waits for a change: it was rolled back."""
        while self._waiting:
            self._answer(self._waiting.popleft().client, {"ok": False, "error": why})

    def _guard(self, client: bytes | None, handle: Callable[[], None]) -> None:
        """Handles one message; turns every error into an answer."""
        try:
            handle()
        except BadMessage as error:
            answer = {"ok": False, "error": str(error)}
        except UserError as error:
            answer = {"ok": False, "error": error.message, "remedy": error.remedy}
        except Exception:
            self._log(f"internal error while handling a message; the session continues\n{traceback.format_exc()}")
            answer = INTERNAL
        else:
            return
        logger.info("refused: %s", answer["error"])
        if client is not None:
            if client.decode(errors="replace") in NAMES:  # a stage does not read answers: log it for the user
                self._log(f"{answer['error']}{' (' + str(answer['remedy']) + ')' if answer.get('remedy') else ''}")
            self._answer(client, answer)

    def _take(self, client: bytes, parts: list[bytes]) -> None:
        if len(parts) != 1:
            raise BadMessage(f"a message has {len(parts)} parts; one is allowed")
        message = control.decode(parts[0])
        logger.log(logging.DEBUG if message.get("cmd") in ASKED_OFTEN else logging.INFO, "request %.500s", message)
        self._carry_out(client, message, respond(self._store.state, message, now_ns()))

    def _checked(self, checking: _Checking) -> None:
        result = checking.checker.result()
        self._carry_out(checking.client, checking.message, respond_checked(self._store.state, checking.message, result, now_ns()))

    def _carry_out(self, client: bytes, message: dict[str, Any], reply: Reply) -> None:
        """Carries out a reply, and answers now or when it is done."""
        if reply.check is not None:
            if any(each.message["cmd"] == message["cmd"] for each in self._checking):
                raise UserError(f"another {message['cmd']} is running", "wait until it is done")
            self._checking.append(_Checking(client, message, FileChecker(reply.check, self._store.state.config)))
            return
        answer = {"ok": True, **reply.answer, **(self._stages() if reply.with_stages else {})}
        if reply.broadcast is not None:
            self.broadcast(control.encode(reply.broadcast))
        rev = self._store.state.rev
        if reply.state is not None:
            self._store.apply(reply.state)
            if reply.state.rev != rev:
                self._waiting.append(_Waiting(client, answer, reply.state.rev, now_ns() + APPLY_NS))
                return
        self._answer(client, answer)
        if reply.stop:
            self._stop()

    def _answer_applied(self) -> None:
        """Answers the clients whose change has been applied, or has taken too long."""
        while self._waiting:
            waiting = self._waiting[0]
            done = self._applied(waiting.rev)
            if not done and now_ns() <= waiting.until_ns:
                return
            self._waiting.popleft()
            self._answer(waiting.client, {**waiting.answer, "applied": done})

    def _answer(self, client: bytes, message: dict[str, Any]) -> None:
        short = {key: _shortened(value) for key, value in message.items()} if not message["ok"] else message
        try:
            data = control.encode({"rev": self._store.state.rev, **short})
        except BadMessage as error:
            data = control.encode({"rev": self._store.state.rev, "ok": False, "error": f"the answer cannot be sent: {error}"})
        with contextlib.suppress(zmq.ZMQError):  # a client that has disconnected or does not read
            self._ctl.send_multipart([client, data], zmq.NOBLOCK)

    def _pass_on(self, parts: list[bytes]) -> None:
        if len(parts) != 1:
            return
        with contextlib.suppress(BadMessage):
            message = control.decode(parts[0])
            self._tap.send(parts[0], zmq.NOBLOCK)
            self._hear(message)


def _shortened(value: object) -> object:
    """Limits a text to the size of an answer: parts of it came from outside."""
    return value if not isinstance(value, str) or len(value) <= MAX_ERROR_CHARS else f"{value[:MAX_ERROR_CHARS]} ..."
