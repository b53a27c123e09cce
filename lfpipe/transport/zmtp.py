"""The listening side of ZeroMQ's protocol, ZMTP 3.0 (rfc.zeromq.org/spec/23), on Unix sockets.

Clients use libzmq. A listener does not: libzmq aborts the process when it may open no more files,
and reads subscriptions, and messages of many parts, for as long as a client sends them. Here each
client may hold a few connections, and is read only as fast as its messages are used.
"""

import contextlib
import logging
import selectors
import socket
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path

import attrs

from lfpipe.host.limits import free_files
from lfpipe.host.processes import is_child
from lfpipe.host.unix_sockets import listening, peer_pid
from lfpipe.transport.clock import MS_NS, SECOND_NS, now_ns

logger = logging.getLogger(__name__)
MAX_PER_PROGRAM = 16  # a page or a monitor has three; each may hold 1 MB here
# connections of all programs, as far as descriptors allow: half of the free ones, because the
# session opens others for stages and scenes
MAX_OPEN = 256
MAX_OUT_BYTES = 1 << 20  # that wait for one client: a page of previews; more are dropped
# frames per interval, of all clients in turn: at most 15 % of a core
SLICE = 32
SLICE_NS = 20 * MS_NS
ACCEPT_NS = SLICE_NS // 4  # per turn, so that a storm of connections hides no messages
HANDSHAKE_NS = 2 * SECOND_NS  # a connection that has not said what it is by then is closed
REPORT_NS = 10 * SECOND_NS  # between two lines for the user: a flood is no reason for another one

MORE, LONG, COMMAND = 1, 2, 4  # flags of a frame
MECHANISM = b"NULL".ljust(20, b"\0")
GREETING = b"\xff" + bytes(8) + b"\x7f" + b"\3\0" + MECHANISM + bytes(32)
MAX_COMMAND_BYTES = 512  # a handshake names the client in at most 255
READY, PING, PONG = b"\5READY", b"\4PING", b"\4PONG"
XPUB, SUBSCRIBE_ALL, UNSUBSCRIBE_ALL = b"XPUB", b"\1", b"\0"
HEAD_BYTES = 9  # of a long frame


class _Refused(Exception):
    """The client does not speak the protocol."""


@attrs.frozen
class Place:
    """A socket to connect to: the name of its file, its ZeroMQ type, those of its clients, and the
    longest message that they may send.
    """

    name: str
    kind: bytes
    clients: Collection[bytes]
    max_bytes: int


@attrs.define(eq=False, kw_only=True)
class Connection:
    """A client's connection."""

    number: int
    """Never used again, in contrast to a descriptor."""
    place: Place
    socket: socket.socket
    pid: int
    """Of the client, 0 if unknown."""
    until_ns: int
    """The end of the handshake."""
    state: str = "greeting"
    """Then "handshake", "ready", and "closed"."""
    name: bytes = b""
    """Its own, which another connection may have taken; b"" if it has none."""
    identity: bytes = b""
    """The name, or a made one."""
    subscribed: bool = False
    received: bytearray = attrs.field(factory=bytearray)
    parts: list[bytes] = attrs.field(factory=list)
    """Of a message that is not complete: two at most, which tells that there are more."""
    waiting: deque[bytes] = attrs.field(factory=deque)
    """Frames to send."""
    waiting_bytes: int = 0


class Server:
    """The sockets in a folder. warn: for the user. Raises OSError if one cannot be made."""

    def __init__(self, folder: Path, places: Sequence[Place], warn: Callable[[str], None]) -> None:
        self._warn = warn
        self._selector = selectors.DefaultSelector()
        self._open: dict[int, Connection] = {}  # by number, so oldest first
        self._by_identity: dict[bytes, Connection] = {}
        self._programs = Counter[int]()  # pid -> open connections
        self._most = max(MAX_PER_PROGRAM, min(MAX_OPEN, free_files() // 2))
        self._count = 0
        self._used_ns = Counter[int]()  # pid -> time for its messages in this second
        self._rests_until_ns = self._report_ns = self._used_since_ns = 0
        self._buffered: dict[int, Connection] = {}  # with a whole frame in `received`
        with contextlib.ExitStack() as undo:  # in case of an error
            undo.callback(self._selector.close)
            for place in places:
                listener = undo.enter_context(listening(folder / place.name))
                undo.callback((folder / place.name).unlink, missing_ok=True)
                self._selector.register(listener, selectors.EVENT_READ, (listener, place))
            self._cleanup = undo.pop_all()

    def close(self) -> None:
        """Closes all connections and removes the files."""
        for connection in list(self._open.values()):
            self._close(connection)
        self._cleanup.close()

    @property
    def fds(self) -> list[int]:
        """Descriptors that wake the process when there is something to do."""
        return [] if self.rest_ns() else [self._selector.fileno()]

    def rest_ns(self) -> int:
        """Time until more may be read, or 0."""
        return max(0, self._rests_until_ns - now_ns())

    @property
    def pending(self) -> bool:
        """Whether there are frames to take without waiting."""
        return bool(self._buffered) and not self.rest_ns()

    def numbers(self) -> Collection[int]:
        """The open connections."""
        return self._open.keys()

    def messages(self) -> Iterator[tuple[Connection, list[bytes]]]:
        """The messages that have arrived, one of each client in turn, as their parts; of more than
        two parts, only two. After SLICE frames, the sockets rest: a flood delays nothing else, and
        waits in its sender.
        """
        t_ns = now_ns()
        if self._rests_until_ns > t_ns:
            return
        if t_ns > self._used_since_ns + SECOND_NS:
            self._used_since_ns = t_ns
            self._used_ns.clear()
        count = 0
        while count < SLICE and now_ns() < t_ns + SLICE_NS:
            ready = self._ready()
            if not ready:  # after all that has arrived was read
                self._end_handshakes(t_ns)
                return
            for at, connection in enumerate(ready):
                began_ns = now_ns()
                if began_ns > t_ns + SLICE_NS:
                    self._buffered |= {one.number: one for one in ready[at:]}
                    break
                if frame := self._frame(connection):
                    count += 1
                    if parts := self._message(connection, *frame):
                        yield connection, parts
                self._used_ns[connection.pid] += now_ns() - began_ns
        if count >= SLICE:
            self._rests_until_ns = now_ns() + SLICE_NS

    def send(self, identity: bytes, data: bytes) -> None:
        """Sends a message. It is lost if the client has gone or does not read."""
        if connection := self._by_identity.get(identity):
            self._send(connection, _encoded(data))

    def publish(self, data: bytes) -> None:
        """Sends a message to every subscriber."""
        frame = _encoded(data)
        for connection in [one for one in self._open.values() if one.subscribed]:
            self._send(connection, frame)

    def _ready(self) -> list[Connection]:
        """The connections with something to take, those of programs that have used little time
        first. Accepts new ones, and sends what waits.
        """
        ready = self._buffered
        self._buffered = {}
        for key, events in self._selector.select(0):
            if not isinstance(connection := key.data, Connection):
                self._accept(*key.data)
                continue
            if events & selectors.EVENT_WRITE:
                self._flush(connection)
            if events & selectors.EVENT_READ:
                ready[connection.number] = connection
        living = [one for one in ready.values() if one.state != "closed"]
        return sorted(living, key=lambda one: self._used_ns[one.pid])

    def _accept(self, listener: socket.socket, place: Place) -> None:
        until_ns = now_ns() + ACCEPT_NS
        while now_ns() < until_ns:
            try:
                client, _ = listener.accept()
            except BlockingIOError:
                return
            except OSError as error:  # no descriptor is free
                logger.warning("%s: %s", place.name, error.strerror)
                self._rests_until_ns = now_ns() + SLICE_NS
                return
            pid = peer_pid(client)
            if pid and self._programs[pid] >= MAX_PER_PROGRAM:
                client.close()
                self._report(pid)
                continue
            client.setblocking(False)
            with contextlib.suppress(OSError):  # it has gone
                client.send(GREETING + _ready(place.kind))
            self._count += 1
            connection = Connection(
                number=self._count,
                place=place,
                socket=client,
                pid=pid,
                until_ns=now_ns() + HANDSHAKE_NS,
            )
            self._open[connection.number] = connection
            self._programs[pid] += 1
            self._selector.register(client, selectors.EVENT_READ, connection)
            if len(self._open) > self._most:
                self._make_room()

    def _make_room(self) -> None:
        """Closes the oldest connection of the program that has most, but none of a stage."""
        busiest = sorted(self._open.values(), key=lambda one: -self._programs[one.pid])
        excess = next((one for one in busiest if not is_child(one.pid)), busiest[-1])
        self._report(excess.pid)
        self._close(excess)

    def _report(self, pid: int) -> None:
        if (t_ns := now_ns()) >= self._report_ns:
            self._report_ns = t_ns + REPORT_NS
            self._warn(f"process {pid} has too many connections: some are closed")

    def _end_handshakes(self, t_ns: int) -> None:
        for connection in list(self._open.values()):
            if connection.state != "ready" and connection.until_ns < t_ns:
                self._close(connection)

    def _close(self, connection: Connection) -> None:
        if connection.state == "closed":
            return
        connection.state = "closed"
        connection.subscribed = False
        del self._open[connection.number]
        self._programs -= Counter([connection.pid])
        if self._by_identity.get(connection.identity) is connection:
            del self._by_identity[connection.identity]
            if name := connection.name:
                for other in [one for one in self._open.values() if one.name == name][-1:]:
                    self._identify(other, name)
        self._selector.unregister(connection.socket)
        connection.socket.close()

    def _frame(self, connection: Connection) -> tuple[int, bytes] | None:
        """The next frame, if it is complete."""
        received = connection.received
        max_bytes = connection.place.max_bytes if connection.state == "ready" else MAX_COMMAND_BYTES
        try:
            if (frame := _taken(connection, max_bytes)) is None:
                # not more than one frame needs: the rest waits in the kernel
                data = connection.socket.recv(HEAD_BYTES + max_bytes - len(received))
                received += data
                frame = _taken(connection, max_bytes)
                if not data:
                    raise _Refused
        except BlockingIOError:
            return None
        except (OSError, _Refused):
            self._close(connection)
            return None
        if received and frame:
            self._buffered[connection.number] = connection
        return frame

    def _message(self, connection: Connection, flags: int, body: bytes) -> list[bytes]:
        """The parts of a message that a frame completes; nothing for other frames."""
        if connection.state == "handshake":
            self._begin(connection, flags, body)
        elif flags & COMMAND:
            if body.startswith(PING):
                self._send(connection, _encoded(PONG + body[len(PING) + 2 :], COMMAND))
        elif connection.place.kind == XPUB:
            if body in (SUBSCRIBE_ALL, UNSUBSCRIBE_ALL):
                connection.subscribed = body == SUBSCRIBE_ALL
        else:
            connection.parts = [*connection.parts, body][:2]
            if not flags & MORE:
                parts, connection.parts = connection.parts, []
                return parts
        return []

    def _begin(self, connection: Connection, flags: int, body: bytes) -> None:
        """Ends the handshake. A name that another connection has goes to this one, until it ends: a
        restarted stage has its old name.
        """
        about = _properties(body) if flags == COMMAND else {}
        if about.get(b"socket-type") not in connection.place.clients:
            self._close(connection)
            return
        connection.state = "ready"
        connection.name = about.get(b"identity", b"")
        if connection.name and (earlier := self._by_identity.get(connection.name)):
            self._identify(earlier, b"")
        self._identify(connection, connection.name)

    def _identify(self, connection: Connection, name: bytes) -> None:
        connection.identity = name or b"\0%d" % connection.number
        self._by_identity[connection.identity] = connection

    def _send(self, connection: Connection, frame: bytes) -> None:
        if connection.waiting_bytes + len(frame) > MAX_OUT_BYTES:
            return
        connection.waiting.append(frame)
        connection.waiting_bytes += len(frame)
        if len(connection.waiting) == 1:
            self._flush(connection)

    def _flush(self, connection: Connection) -> None:
        waiting = connection.waiting
        try:
            while waiting:
                sent = connection.socket.send(waiting[0])
                connection.waiting_bytes -= sent
                if sent < len(waiting[0]):
                    waiting[0] = waiting[0][sent:]
                else:
                    waiting.popleft()
        except BlockingIOError:
            pass
        except OSError:
            self._close(connection)
            return
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if waiting else 0)
        if self._selector.get_key(connection.socket).events != events:
            self._selector.modify(connection.socket, events, connection)


def _encoded(body: bytes, flags: int = 0) -> bytes:
    """A frame."""
    if len(body) < 256:
        return bytes([flags, len(body)]) + body
    return bytes([flags | LONG]) + len(body).to_bytes(8) + body


def _taken(connection: Connection, max_bytes: int) -> tuple[int, bytes] | None:
    """The flags and the body of the first frame, if it is complete, which is removed. Before the
    handshake, removes the greeting. Raises _Refused.
    """
    received = connection.received
    if connection.state == "greeting":
        # those of older protocols are shorter
        if received[:1] not in (b"", GREETING[:1]) or received[9:10] not in (b"", GREETING[9:10]):
            raise _Refused
        if len(received) < len(GREETING):
            return None
        if received[10] < GREETING[10] or received[12:32] != MECHANISM:
            raise _Refused
        del received[: len(GREETING)]
        connection.state = "handshake"
    head_bytes = HEAD_BYTES if received[:1] and received[0] & LONG else 2
    if len(received) < head_bytes:
        return None
    body_bytes = int.from_bytes(received[1:head_bytes])
    if body_bytes > max_bytes or received[0] & ~(MORE | LONG | COMMAND):
        raise _Refused
    if len(received) < head_bytes + body_bytes:
        return None
    frame = received[0], bytes(received[head_bytes : head_bytes + body_bytes])
    del received[: head_bytes + body_bytes]
    return frame


def _ready(kind: bytes) -> bytes:
    """The handshake of a socket of that type."""
    return _encoded(READY + b"\x0bSocket-Type" + len(kind).to_bytes(4) + kind, COMMAND)


def _properties(body: bytes) -> dict[bytes, bytes]:
    """What a client's handshake says, by its name in lower case; nothing if it is damaged."""
    found = {}
    rest = body.removeprefix(READY) if body.startswith(READY) else b""
    while rest:
        name, rest = rest[1 : 1 + rest[0]], rest[1 + rest[0] :]
        size = int.from_bytes(rest[:4])
        value, rest = rest[4 : 4 + size], rest[4 + size :]
        found[name.lower()] = value
    return found
