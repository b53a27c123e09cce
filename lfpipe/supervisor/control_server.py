"""The supervisor's sockets: receives requests on ctl, answers them, and forwards telemetry from bus to tap. Never blocks.

No request or message can end the session: an unexpected exception is answered as an internal error, and its stack is logged.
"""

from __future__ import annotations

import contextlib
import logging
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

import attrs
import zmq
from zmq.utils.monitor import parse_monitor_message

from lfpipe.config import SceneSummary
from lfpipe.errors import UserError
from lfpipe.host.worker import Worker
from lfpipe.scene.open_scene import Packing
from lfpipe.supervisor.file_requests import CHECK_S, SHOWN, FileRequest, FileRequests
from lfpipe.supervisor.process_table import NAMES, SHOWN_BY
from lfpipe.supervisor.requests import Reply, respond, respond_checked
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
MAX_ERROR_CHARS = 2000  # of an answer: parts of the text came from outside
HANDSHAKE_MS = 2000  # a connection that is silent for longer is closed
SLICE, SLICE_NS = 32, 20 * MS_NS  # messages per interval and socket: at most 15 % of a core
INTERNAL = {
    "ok": False,
    "error": "internal error",
    "remedy": "the session continues; please report the stack in its log",
}
REPLACED = {
    "ok": False,
    "error": "another scene was requested meanwhile",
    "remedy": "load it again",
    "replaced": True,
}


class Connections:
    """The connections of a socket, from libzmq's events. Create it before the socket is bound. events: for a poller. open: file
    descriptors, as ZMQ_SRCFD of a message names them."""

    def __init__(self, socket: zmq.Socket[bytes]) -> None:
        self.open: set[int] = set()
        self._socket = socket
        socket.setsockopt(zmq.HANDSHAKE_IVL, HANDSHAKE_MS)
        self.events = socket.get_monitor_socket(zmq.EVENT_ACCEPTED | zmq.EVENT_DISCONNECTED)

    def update(self) -> None:
        """Processes the events since the last call."""
        while self.events.poll(0):
            event = parse_monitor_message(self.events.recv_multipart())
            (self.open.add if event["event"] == zmq.EVENT_ACCEPTED else self.open.discard)(
                event["value"]
            )

    def close(self) -> None:
        """Ends the events; does not close the socket."""
        self._socket.disable_monitor()


@attrs.define
class _Waiting:
    """A client whose answer waits until the stages have applied revision rev."""

    client: bytes
    answer: dict[str, Any]
    rev: int
    until_ns: int


class ControlServer:
    """ctl, bus and tap of a session, bound in its run directory. live: the session itself. packing: the packer of its first
    scene, while it works on the disparity. Raises UserError if a socket cannot be bound."""

    def __init__(
        self,
        ctx: zmq.Context[zmq.Socket[bytes]],
        session: Session,
        store: SessionStore,
        live: LiveSession,
        packing: Packing | None,
    ) -> None:
        self._store, self._live = store, live
        self._ctl, self._bus, self._tap = (
            ctx.socket(kind) for kind in (zmq.ROUTER, zmq.PULL, zmq.XPUB)
        )
        self._ctl.setsockopt(
            zmq.ROUTER_HANDOVER, 1
        )  # a restarted stage reconnects under its old name
        self._connections = Connections(self._ctl)
        for name, socket in {"ctl": self._ctl, "bus": self._bus, "tap": self._tap}.items():
            control.bind(socket, session.run_dir, name)
        self._rests_until_ns = 0
        self._waiting: deque[_Waiting] = deque()  # by revision, so by time as well
        self._files = FileRequests(self._report_step)
        if packing is not None:
            self._files.running[SHOWN] = FileRequest(b"", {}, packing)

    def close(self) -> None:
        """Ends the running children and closes the sockets."""
        for command in list(self._files.running):
            self._files.end(command)
        self._connections.close()
        for socket in (self._ctl, self._bus, self._tap):
            socket.close()

    def register(self, poller: zmq.Poller) -> None:
        """Registers what should wake the supervisor now."""
        sockets = () if self._rest_ns() else (self._ctl, self._bus)
        for source in (*sockets, self._connections.events, *self._files.fds):
            poller.register(source, zmq.POLLIN)

    def _rest_ns(self) -> int:
        """Time until more messages may be read."""
        return max(0, self._rests_until_ns - now_ns())

    def wait_ms(self, most_ms: int) -> int:
        """How long the supervisor may sleep, at most most_ms, unless a registered descriptor wakes it."""
        rest_ns = self._rest_ns()
        return min(
            most_ms,
            rest_ns // MS_NS + 1 if rest_ns else most_ms,
            APPLY_POLL_MS if self._waiting else most_ms,
        )

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
        if not self._rest_ns():
            for (client, *parts), connection in self._arrived(self._ctl):
                self._guard(client, partial(self._take, client, parts, connection))
            for parts, _ in self._arrived(self._bus):
                self._guard(None, partial(self._pass_on, parts))
        while self._tap.poll(0):
            self._tap.recv()  # discard subscription messages, which would accumulate
        # After the messages: one from a new connection may have the number of a connection whose end is not processed yet.
        self._connections.update()
        for command in self._files.update(self._connections.open):
            if request := self._files.running.get(command):  # else the command before has ended it
                self._guard(request.client or None, partial(self._served, command, request))
        self.flush()
        self._answer_applied()

    def _arrived(self, socket: zmq.Socket[bytes]) -> Iterator[tuple[list[bytes], int]]:
        """At most SLICE messages, each with the file descriptor of its connection. After so many, the sockets rest: a flood
        delays neither frames nor other clients, whom ZeroMQ serves in turn, and waits in its senders."""
        for _ in range(SLICE):
            if not socket.poll(0):
                return
            frames = socket.recv_multipart(copy=False)
            yield [frame.bytes for frame in frames], int(frames[0].get(zmq.SRCFD))
        self._rests_until_ns = now_ns() + SLICE_NS

    def _report_step(self, news: dict[str, Any]) -> None:
        """Tells the stage that shows pictures how far a scene is loaded, whoever asked for it; step "" is the end."""
        self.send(SHOWN_BY, control.encode({"cmd": "loading", **news}))

    def _served(self, command: str, request: FileRequest) -> None:
        client, worker, state, files = (
            request.client,
            request.worker,
            self._store.state,
            self._files,
        )
        if (
            command == "load"
            and not worker.done
            and isinstance(worker, Packing)
            and worker.views is not None
        ):
            result = attrs.asdict(worker.views)
            files.end(SHOWN)
            files.running[SHOWN] = files.running.pop("load")
            request.client = b""
        else:
            try:
                result = worker.result()
            finally:
                files.end(command)
            if command == SHOWN:  # its packer has finished: the stages open the pack again
                scene = SceneSummary(**result)
                if state.options.scene is not None and state.options.scene.pack == scene.pack:
                    logger.info("%s: disparity is complete, method %s", scene.name, scene.method)
                    self._store.apply(state.loaded(scene))
                return
            if command == "load":
                files.end(SHOWN)
        self._carry_out(
            client, request.message, respond_checked(state, request.message, result, now_ns())
        )

    def refuse_waiting(self, why: str) -> None:
        """Answers every client that waits for a change: it was rolled back."""
        while self._waiting:
            self._answer(self._waiting.popleft().client, {"ok": False, "error": why})

    def _guard(self, client: bytes | None, handle: Callable[[], None]) -> None:
        """Handles one message; turns every error into an answer."""
        try:
            handle()
        except BadMessage as error:
            answer = {"ok": False, "error": str(error)[:MAX_ERROR_CHARS]}
        except UserError as error:
            answer = {
                "ok": False,
                "error": error.message[:MAX_ERROR_CHARS],
                "remedy": error.remedy[:MAX_ERROR_CHARS],
            }
        except Exception:
            self._live.log(
                f"internal error while handling a message; the session continues\n{traceback.format_exc()}"
            )
            answer = INTERNAL
        else:
            return
        logger.info("refused: %s", answer["error"])
        if client is not None:
            if (
                client.decode(errors="replace") in NAMES
            ):  # a stage does not read answers: log it for the user
                self._live.log(
                    f"{answer['error']}{' (' + str(answer['remedy']) + ')' if answer.get('remedy') else ''}"
                )
            self._answer(client, answer)

    def _take(self, client: bytes, parts: list[bytes], connection: int) -> None:
        if len(parts) != 1:
            raise BadMessage(f"a message has {len(parts)} parts; one is allowed")
        message = control.decode(parts[0])
        logger.log(
            logging.DEBUG if message.get("cmd") in ASKED_OFTEN else logging.INFO,
            "request %.500s",
            message,
        )
        self._carry_out(client, message, respond(self._store.state, message, now_ns()), connection)

    def _begin(
        self, client: bytes, message: dict[str, Any], check: dict[str, Any], connection: int
    ) -> None:
        """Starts the child that a request waits for. A load replaces the one that is under way."""
        command, before = message["cmd"], self._files.running.get(message["cmd"])
        worker: Worker
        if check["check"] == "scene":
            if before is not None:
                self._files.end(command)
                self._answer(before.client, REPLACED)
            settings = attrs.evolve(self._store.state.config.scene, **check["settings"])
            worker = Packing([check["path"]], settings, remember=True)
        elif before is not None:
            raise UserError(f"another {command} is running", "wait until it is done")
        else:
            worker = Worker("lfpipe.supervisor.file_requests", check, check["path"], CHECK_S)
        self._files.running[command] = FileRequest(client, message, worker, connection)

    def _carry_out(
        self, client: bytes, message: dict[str, Any], reply: Reply, connection: int = -1
    ) -> None:
        """Carries out a reply, and answers now or when it is done."""
        if reply.check is not None:
            self._begin(client, message, reply.check, connection)
            return
        answer = {
            "ok": True,
            **reply.answer,
            **(self._live.snapshot() if reply.with_stages else {}),
        }
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
        while self._waiting:
            waiting = self._waiting[0]
            done = self._live.applied(waiting.rev)
            if not done and now_ns() <= waiting.until_ns:
                return
            self._waiting.popleft()
            self._answer(waiting.client, {**waiting.answer, "applied": done})

    def _answer(self, client: bytes, message: dict[str, Any]) -> None:
        try:
            data = control.encode({"rev": self._store.state.rev, **message})
        except BadMessage as error:
            data = control.encode(
                {
                    "rev": self._store.state.rev,
                    "ok": False,
                    "error": f"the answer cannot be sent: {error}",
                }
            )
        with contextlib.suppress(zmq.ZMQError):  # a client that has disconnected or does not read
            self._ctl.send_multipart([client, data], zmq.NOBLOCK)

    def _pass_on(self, parts: list[bytes]) -> None:
        if len(parts) != 1:
            return
        with contextlib.suppress(BadMessage):
            message = control.decode(parts[0])
            self._tap.send(parts[0], zmq.NOBLOCK)
            self._live.report(message)
