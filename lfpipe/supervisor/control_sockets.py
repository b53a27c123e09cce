"""The sockets of a session: requests on ctl and their answers, telemetry from bus to tap. They do
not interpret requests. Nothing here blocks, whatever bytes arrive.
"""

import contextlib
import logging
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import attrs

from lfpipe.transport import control
from lfpipe.transport.clock import now_ns
from lfpipe.transport.control import BadMessage, Message
from lfpipe.transport.zmtp import MAX_COMMAND_BYTES, XPUB, Place, Server

logger = logging.getLogger(__name__)


@attrs.define
class Request:
    """A message of a client, not checked before `decode`."""

    client: bytes
    """The identity of its socket; a stage's is the stage's name."""
    connection: int = -1
    """Its connection."""
    parts: list[bytes] = attrs.field(factory=list)
    message: Message = attrs.field(factory=dict)
    """Its readable fields."""

    @property
    def command(self) -> str:
        """The command, "" without one."""
        return str(self.message.get("cmd", ""))

    @property
    def sender(self) -> str:
        """The identity as text: the name of a stage, or a text that is no stage's name."""
        return self.client.decode(errors="replace")

    def decode(self) -> None:
        """Reads the message. Raises BadMessage; the answer then repeats the readable fields."""
        if len(self.parts) != 1:
            raise BadMessage(f"a message has {len(self.parts)} parts; one is allowed")
        self.message = control.unpack(self.parts[0])
        control.check(self.message)


PLACES = (
    # a message of more than MAX_BYTES gets an error answer, one of twice that size none
    Place("ctl", b"ROUTER", (b"DEALER", b"REQ", b"ROUTER"), 2 * control.MAX_BYTES),
    Place("bus", b"PULL", (b"PUSH",), control.MAX_BYTES),
    Place("tap", XPUB, (b"SUB", b"XSUB"), MAX_COMMAND_BYTES),
)


class ControlSockets:
    """ctl, bus and tap in a run directory. warn: for the user. Raises UserError if a path is too
    long, OSError if a socket cannot be made.
    """

    def __init__(self, run_dir: Path, warn: Callable[[str], None] = logger.warning) -> None:
        for place in PLACES:
            control.check_place(run_dir, place.name)
        self._server = Server(run_dir, PLACES, warn)
        self.close = self._server.close
        self.connections = self._server.numbers

    @property
    def fds(self) -> list[int]:
        """Descriptors that should wake the supervisor now."""
        return self._server.fds

    def wait_ns(self) -> int | None:
        """Time until more messages can be read, if that is known."""
        return 0 if self._server.pending else self._server.rest_ns() or None

    def arrived(self) -> Iterator[Request | Message]:
        """Yields the requests and the valid telemetry that have arrived, a slice of a flood, and
        passes the telemetry on to tap.
        """
        for connection, parts in self._server.messages():
            if connection.place.name == "ctl":
                yield Request(connection.identity, connection.number, parts)
            elif len(parts) == 1:
                with contextlib.suppress(BadMessage):
                    message = control.decode(parts[0])
                    self._server.publish(parts[0])
                    yield message

    def answer(self, request: Request, rev: int, answer: Message) -> None:
        """Answers a request; the answer repeats its `id` and `cmd`. rev: of the state."""
        repeated = {"rev": rev, **control.repeated(request.message)}
        try:
            data = control.encode({**answer, **repeated})
        except BadMessage as error:
            why = f"the answer cannot be sent: {error}"
            data = control.encode({"ok": False, "error": why, **repeated})
        self._server.send(request.client, data)

    def send(self, stage: str, message: Message) -> None:
        """Sends a message to a stage. It is lost if the stage is not connected; the stage will send
        hello later.
        """
        self._server.send(stage.encode(), control.encode(message))

    def broadcast(self, stages: tuple[str, ...], message: bytes) -> None:
        """Sends an encoded message to several stages."""
        for stage in stages:
            self._server.send(stage.encode(), message)

    def publish(self, topic: str, **values: Any) -> None:
        """Sends a message to every subscriber of the tap."""
        self._server.publish(control.encode({"topic": topic, "t_ns": now_ns(), **values}))
