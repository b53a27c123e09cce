"""The supervisor's sockets: receives requests on ctl, answers them, and forwards telemetry from bus to tap. Never blocks.

No request or message can end the session: an unexpected exception is answered as an internal error, and its stack is logged.
"""

from __future__ import annotations

import contextlib
import logging
import traceback
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import attrs
import zmq

from lfpipe.config import SceneSummary
from lfpipe.errors import UserError
from lfpipe.host.worker import Worker
from lfpipe.scene.open_scene import Packing
from lfpipe.supervisor.file_requests import FileRequest, FileRequests
from lfpipe.supervisor.process_table import NAMES, SHOWN_BY
from lfpipe.supervisor.requests import Reply, respond, respond_checked
from lfpipe.supervisor.server_limits import Connections, ThrottledSocket
from lfpipe.supervisor.session_store import SessionStore
from lfpipe.transport import control
from lfpipe.transport.clock import MS_NS, SECOND_NS, now_ns
from lfpipe.transport.control import BadMessage
from lfpipe.transport.session import Session

if TYPE_CHECKING:
    from lfpipe.supervisor.live_session import LiveSession

logger = logging.getLogger(__name__)
APPLY_NS = SECOND_NS  # time limit for the stages to apply a change before the answer
APPLY_POLL_MS = 4  # polling period meanwhile
ASKED_OFTEN = ("hello", "status", "pictures")  # requests that change nothing
MAX_ERROR_CHARS = 2000
CHECK_S = 10.0  # time limit of a check of paths: a network drive or name server may be dead
INTERNAL = {"ok": False, "error": "internal error", "remedy": "the session continues; please report the stack in its log"}
REPLACED = {"ok": False, "error": "another scene was requested meanwhile", "remedy": "load it again", "replaced": True}


@attrs.define
class _Waiting:
    """A client whose answer waits until the stages have applied revision rev."""

    client: bytes
    answer: dict[str, Any]
    rev: int
    until_ns: int


class ControlServer:
    """ctl, bus and tap of a session, bound in its run directory. live: the session itself. Raises UserError if a socket cannot be
    bound."""

    def __init__(self, ctx: zmq.Context[zmq.Socket[bytes]], session: Session, store: SessionStore, live: LiveSession) -> None:
        self._store, self._live = store, live
        self._ctl, self._bus, self._tap = (ctx.socket(kind) for kind in (zmq.ROUTER, zmq.PULL, zmq.XPUB))
        self._ctl.setsockopt(zmq.ROUTER_HANDOVER, 1)  # a restarted stage reconnects under its old name
        self._clients = Connections(self._ctl)
        for name, socket in {"ctl": self._ctl, "bus": self._bus, "tap": self._tap}.items():
            control.limit(socket)
            control.bind(socket, session.run_dir, name)
        self._requests, self._telemetry = ThrottledSocket(self._ctl), ThrottledSocket(self._bus)
        self._waiting: deque[_Waiting] = deque()  # by revision, so by time as well
        self._files = FileRequests(self._report_step)

    def close(self) -> None:
        """Ends the running checks and closes the sockets."""
        self._files.close()
        self._clients.close()
        for socket in (self._ctl, self._bus, self._tap):
            socket.close()

    def register(self, poller: zmq.Poller) -> None:
        """Registers what should wake the supervisor now."""
        for intake in (self._requests, self._telemetry):
            if not intake.rest_ns():
                poller.register(intake.socket, zmq.POLLIN)
        for source in (self._clients.events, *self._files.fds):
            poller.register(source, zmq.POLLIN)

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
        for (client, *parts), connection in self._requests.messages():
            self._guard(client, partial(self._take, client, parts, connection))
        for parts, _ in self._telemetry.messages():
            self._guard(None, partial(self._pass_on, parts))
        while self._tap.poll(0):
            self._tap.recv()  # discard subscription messages, which would accumulate
        # After the messages: one from a new connection may have the number of a connection whose end is not processed yet.
        self._clients.update()
        self._files.cancel_abandoned(self._clients.open)
        for request in self._files.serve():
            self._guard(request.client or None, partial(self._served, request))
        self.flush()
        self._answer_applied()

    def _report_step(self, news: dict[str, Any]) -> None:
        """Tells the stage that shows pictures how far a scene is loaded, whoever asked for it; step "" is the end."""
        self.send(SHOWN_BY, control.encode({"cmd": "loading", **news}))

    def follow(self, packing: Packing) -> None:
        """Goes on with the packer of the scene that the session begins with."""
        self._files.add(FileRequest(b"", {"cmd": "load"}, packing, shown=True))

    def _served(self, request: FileRequest) -> None:
        """Carries out a request whose child has news."""
        worker = request.worker
        if not worker.done:
            assert isinstance(worker, Packing) and worker.views is not None
            self._files.end_shown()
            request.shown = True
            result = attrs.asdict(worker.views)
        else:
            try:
                result = worker.result()
            finally:
                self._files.end(request)
            if request.message["cmd"] == "load":
                if request.shown:
                    self._completed(SceneSummary(**result))
                    return
                self._files.end_shown()
        self._carry_out(request.client, request.message, respond_checked(self._store.state, request.message, result, now_ns()))

    def _completed(self, scene: SceneSummary) -> None:
        """The packer has finished the scene on the screen: the stages open its pack again."""
        state = self._store.state
        if state.options.scene is not None and state.options.scene.pack == scene.pack:
            logger.info("%s: disparity is complete, method %s", scene.name, scene.method)
            self._store.apply(state.loaded(scene))

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
            self._live.log(f"internal error while handling a message; the session continues\n{traceback.format_exc()}")
            answer = INTERNAL
        else:
            return
        logger.info("refused: %s", answer["error"])
        if client is not None:
            if client.decode(errors="replace") in NAMES:  # a stage does not read answers: log it for the user
                self._live.log(f"{answer['error']}{' (' + str(answer['remedy']) + ')' if answer.get('remedy') else ''}")
            self._answer(client, answer)

    def _take(self, client: bytes, parts: list[bytes], connection: int) -> None:
        if len(parts) != 1:
            raise BadMessage(f"a message has {len(parts)} parts; one is allowed")
        message = control.decode(parts[0])
        logger.log(logging.DEBUG if message.get("cmd") in ASKED_OFTEN else logging.INFO, "request %.500s", message)
        self._carry_out(client, message, respond(self._store.state, message, now_ns()), connection)

    def _begin(self, client: bytes, message: dict[str, Any], check: dict[str, Any], connection: int) -> None:
        """Starts the child that a request waits for. A load replaces the one that is under way."""
        worker: Worker
        if check["check"] == "scene":
            for request in self._files.running("load"):
                self._files.end(request)
                self._answer(request.client, REPLACED)
            settings = attrs.evolve(self._store.state.config.scene, **check["settings"])
            worker = Packing([check["path"]], settings, remember=True)
        elif self._files.running(message["cmd"]):
            raise UserError(f"another {message['cmd']} is running", "wait until it is done")
        else:
            worker = Worker("lfpipe.supervisor.file_check", check, check["path"], CHECK_S)
        self._files.add(FileRequest(client, message, worker, connection))

    def _carry_out(self, client: bytes, message: dict[str, Any], reply: Reply, connection: int = -1) -> None:
        """Carries out a reply, and answers now or when it is done."""
        if reply.check is not None:
            self._begin(client, message, reply.check, connection)
            return
        answer = {"ok": True, **reply.answer, **(self._live.snapshot() if reply.with_stages else {})}
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
            self._live.stop()

    def _answer_applied(self) -> None:
        """Answers the clients whose change has been applied, or has taken too long."""
        while self._waiting:
            waiting = self._waiting[0]
            done = self._live.applied(waiting.rev)
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
            self._live.report(message)


def _shortened(value: object) -> object:
    """Limits a text to the size of an answer: parts of it came from outside."""
    return value if not isinstance(value, str) or len(value) <= MAX_ERROR_CHARS else f"{value[:MAX_ERROR_CHARS]} ..."
