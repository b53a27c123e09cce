"""The sockets of a session: requests on ctl and their answers, telemetry from bus to tap. They do
not interpret requests. Nothing here blocks, whatever bytes arrive.
"""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import attrs
import zmq
from zmq.utils.monitor import parse_monitor_message

from lfpipe.transport import control
from lfpipe.transport.clock import MS_NS, now_ns
from lfpipe.transport.control import BadMessage, Message

HANDSHAKE_MS = 2000  # a connection that is silent for longer is closed
# messages per interval and socket: at most 15 % of a core
SLICE = 32
SLICE_NS = 20 * MS_NS


@attrs.define
class Request:
    """A message of a client, not checked before `decode`."""

    client: bytes
    """The identity of its socket; a stage's is the stage's name."""
    connection: int = -1
    """Descriptor of its connection, -1 if unknown."""
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


def _connection(frame: zmq.Frame) -> int:
    """The descriptor of the connection that a message came from; -1 if it is unknown: a client of
    an old protocol, or a connection that has ended.
    """
    try:
        return int(frame.get(zmq.SRCFD))
    except zmq.ZMQError:
        return -1


class ControlSockets:
    """ctl, bus and tap, bound in a run directory. Raises UserError if a path is too long,
    zmq.ZMQError if a socket cannot be bound.
    """

    def __init__(self, ctx: zmq.Context[zmq.Socket[bytes]], run_dir: Path) -> None:
        self._ctl = ctx.socket(zmq.ROUTER)
        self._bus = ctx.socket(zmq.PULL)
        self._tap = ctx.socket(zmq.XPUB)
        self._ctl.setsockopt(zmq.ROUTER_HANDOVER, 1)  # a restarted stage has its old name
        self._ctl.setsockopt(zmq.HANDSHAKE_IVL, HANDSHAKE_MS)
        # of connections; from before the socket is bound
        self._events = self._ctl.get_monitor_socket(zmq.EVENT_ACCEPTED | zmq.EVENT_DISCONNECTED)
        self._open: set[int] = set()  # descriptors, as ZMQ_SRCFD of a message names them
        for name, socket in {"ctl": self._ctl, "bus": self._bus, "tap": self._tap}.items():
            control.bind(socket, run_dir, name)
        self._rests_until_ns = 0

    def close(self) -> None:
        """Closes the sockets."""
        self._ctl.disable_monitor()
        for socket in (self._ctl, self._bus, self._tap):
            socket.close()

    def pollable(self) -> Sequence[zmq.Socket[bytes]]:
        """The sockets that should wake the supervisor now."""
        return (self._events,) if self.rest_ns() else (self._ctl, self._bus, self._events)

    def rest_ns(self) -> int:
        """Time until more messages may be read."""
        return max(0, self._rests_until_ns - now_ns())

    def requests(self) -> Iterator[Request]:
        """Yields the requests that have arrived, a slice of a flood."""
        for client, *parts in self._arrived(self._ctl):
            yield Request(client.bytes, _connection(client), [part.bytes for part in parts])

    def telemetry(self) -> Iterator[Message]:
        """Yields the valid messages on bus, a slice of a flood, and passes them on to tap."""
        for part, *more in self._arrived(self._bus):
            if more:
                continue
            with contextlib.suppress(BadMessage):
                message = control.decode(part.bytes)
                self._tap.send(part.bytes, zmq.NOBLOCK)
                yield message

    def _arrived(self, socket: zmq.Socket[bytes]) -> Iterator[list[zmq.Frame]]:
        """At most SLICE messages, as their parts. After so many, the sockets rest: a flood delays
        neither frames nor other clients, and waits in its senders.
        """
        if self.rest_ns():
            return
        for _ in range(SLICE):
            if not socket.poll(0):
                return
            yield socket.recv_multipart(copy=False)
        self._rests_until_ns = now_ns() + SLICE_NS

    def connections(self) -> set[int]:
        """The connections that were open at the last call of `update_connections`."""
        return self._open

    def update_connections(self) -> None:
        """Updates the list of open connections. Call it after `requests`: a request may come over a
        connection that reuses the number of one whose end is not processed yet.
        """
        while self._tap.poll(0):
            self._tap.recv()  # subscriptions, which would accumulate
        while self._events.poll(0):
            event = parse_monitor_message(self._events.recv_multipart())
            change = self._open.add if event["event"] == zmq.EVENT_ACCEPTED else self._open.discard
            change(event["value"])

    def answer(self, request: Request, rev: int, answer: Message) -> None:
        """Answers a request; the answer repeats its `id` and `cmd`. rev: of the state."""
        repeated = {"rev": rev, **control.repeated(request.message)}
        try:
            data = control.encode({**answer, **repeated})
        except BadMessage as error:
            why = f"the answer cannot be sent: {error}"
            data = control.encode({"ok": False, "error": why, **repeated})
        self._send(request.client, data)

    def send(self, stage: str, message: Message) -> None:
        """Sends a message to a stage. It is lost if the stage is not connected; the stage will send
        hello later.
        """
        self._send(stage.encode(), control.encode(message))

    def broadcast(self, stages: tuple[str, ...], message: bytes) -> None:
        """Sends an encoded message to several stages."""
        for stage in stages:
            self._send(stage.encode(), message)

    def _send(self, client: bytes, data: bytes) -> None:
        with contextlib.suppress(zmq.ZMQError):  # it has disconnected or does not read
            self._ctl.send_multipart([client, data], zmq.NOBLOCK)

    def publish(self, topic: str, **values: Any) -> None:
        """Sends a message to every subscriber of the tap."""
        self._tap.send(control.encode({"topic": topic, "t_ns": now_ns(), **values}), zmq.NOBLOCK)
