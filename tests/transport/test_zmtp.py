"""The listening side of ZMTP with clients of libzmq, and with clients that mean no good."""

import os
import resource
import select
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path

import pytest
import zmq

from lfpipe.transport import zmtp
from lfpipe.transport.zmtp import MAX_OUT_BYTES, MAX_PER_PROGRAM, Place, Server
from tests.supervisor.raw_bytes import GREETING, PUSHING, READY, ready
from tests.support.world import connected

MAX_BYTES = 1 << 16
ASKED = Place("ask", b"ROUTER", (b"DEALER", b"REQ"), MAX_BYTES)
TOLD = Place("tell", zmtp.XPUB, (b"SUB",), zmtp.MAX_COMMAND_BYTES)
pytestmark = pytest.mark.native("sockets with a path")


class Echo(Server):
    """Answers every message with its parts in one."""

    def __init__(self, folder: Path) -> None:
        self.warned: list[str] = []
        self.served = 0
        super().__init__(folder, (ASKED, TOLD), self.warned.append)

    def turn(self) -> None:
        for connection, parts in self.messages():
            self.served += 1
            self.send(connection.identity, b"+".join(parts))

    def serve(self, condition: Callable[[], object]) -> None:
        """Serves until condition holds."""
        end = time.monotonic() + 60
        while not condition():
            assert time.monotonic() < end, "nothing comes"
            self.turn()
            select.select(self.fds, [], [], 0 if self.pending else 0.002)


@pytest.fixture
def echo(tmp_path: Path) -> Iterator[Echo]:
    with closing(Echo(tmp_path)) as server:
        yield server
    assert not list(tmp_path.iterdir()), "its files are left"


@contextmanager
def raw(
    folder: Path, hello: bytes = GREETING + READY, name: str = "ask"
) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(os.fspath(folder / name))
        client.sendall(hello)
        client.setblocking(False)
        yield client


def ended(client: socket.socket) -> bool:
    try:
        while client.recv(1 << 16):
            pass
    except BlockingIOError:
        return False
    except ConnectionResetError:
        pass
    return True


def asked(echo: Echo, client: zmq.Socket[bytes], *parts: bytes) -> list[bytes]:
    client.send_multipart(parts)
    echo.serve(lambda: client.poll(0))
    return client.recv_multipart()


def test_server_answers_clients_of_libzmq(echo: Echo, tmp_path: Path) -> None:
    with connected(tmp_path, zmq.DEALER, "ask") as one, connected(tmp_path, place="ask") as two:
        for size in (0, 1, 255, 256, MAX_BYTES):
            assert asked(echo, one, b"x" * size) == [b"x" * size]
        assert asked(echo, two, b"a", b"b", *[b"c"] * 1000) == [b"a+b"], "two parts tell of more"
        for number in range(100):
            one.send(b"%d" % number)
            two.send(b"-%d" % number)
        echo.serve(lambda: echo.served == 206)
        assert [one.recv() for _ in range(100)] == [b"%d" % number for number in range(100)]
        two.send(b"x" * (MAX_BYTES + 1))
        echo.serve(lambda: len(echo.numbers()) == 1)
        assert asked(echo, one, b"still") == [b"still"]


def test_server_answers_the_heartbeats_of_a_client(echo: Echo, tmp_path: Path) -> None:
    with zmq.Context() as ctx, ctx.socket(zmq.DEALER) as client:
        client.setsockopt(zmq.HEARTBEAT_IVL, 20)
        client.setsockopt(zmq.HEARTBEAT_TIMEOUT, 200)
        client.connect(f"ipc://{tmp_path / 'ask'}")
        asked(echo, client, b"x")
        (number,) = echo.numbers()
        end = time.monotonic() + 0.5
        echo.serve(lambda: time.monotonic() > end)
        assert list(echo.numbers()) == [number]
        client.close(0)


def test_publish_reaches_subscribers_of_everything(echo: Echo, tmp_path: Path) -> None:
    with connected(tmp_path, zmq.SUB, "tell") as one, connected(tmp_path, zmq.SUB, "tell") as two:
        one.subscribe(b"")
        two.subscribe(b"part")

        def heard() -> int:
            echo.publish(b"news")
            return one.poll(1)

        echo.serve(heard)
        echo.serve(lambda: len(echo.numbers()) == 2)
        assert one.recv() == b"news" and not two.poll(20)
        one.unsubscribe(b"")

        def silent() -> bool:
            while one.poll(0):
                one.recv()
            echo.publish(b"news")
            return not one.poll(20)

        echo.serve(silent)


def test_name_goes_to_the_client_that_has_taken_it_last(echo: Echo, tmp_path: Path) -> None:
    with zmq.Context() as ctx, ctx.socket(zmq.DEALER) as first, ctx.socket(zmq.DEALER) as client:
        for number, one in enumerate((first, client)):
            one.setsockopt(zmq.IDENTITY, b"stage")
            one.setsockopt(zmq.LINGER, 0)
            one.connect(f"ipc://{tmp_path / 'ask'}")
            assert asked(echo, one, b"%d" % number) == [b"%d" % number]
        echo.send(b"stage", b"for the second")
        echo.send(b"nobody", b"lost")
        assert client.poll(60_000) and client.recv() == b"for the second"
        assert len(echo.numbers()) == 2
        client.close()
        echo.serve(lambda: len(echo.numbers()) == 1)
        assert asked(echo, first, b"again") == [b"again"]
        echo.send(b"stage", b"for the first")
        assert first.poll(60_000) and first.recv() == b"for the first"


@pytest.mark.parametrize(
    "hello",
    [
        b"GET / HTTP/1.1\r\n",
        b"\x01\x00",
        GREETING[:10] + b"\x01" + GREETING[11:],
        GREETING[:12] + b"PLAIN".ljust(20, b"\0") + GREETING[32:],
        GREETING + PUSHING,
        GREETING + b"\x00\x01x",
        GREETING + b"\x04\xff" + bytes(255),
        GREETING + READY[:2] + READY[2:].replace(b"\x0bSock", b"\xffSock"),
        GREETING + b"\x06" + (1 << 20).to_bytes(8, "big"),
        GREETING + READY + b"\x02" + (1 << 62).to_bytes(8, "big"),
        GREETING + READY + b"\x40\x00",
    ],
)
def test_server_disconnects_who_speaks_another_protocol(
    echo: Echo, tmp_path: Path, hello: bytes
) -> None:
    with raw(tmp_path, hello) as client:
        echo.serve(lambda: ended(client))
        assert not echo.numbers()


def test_server_disconnects_who_says_nothing(
    echo: Echo, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(zmtp, "HANDSHAKE_NS", 0)
    with raw(tmp_path, GREETING[:20]) as client, raw(tmp_path, b"") as other:
        echo.serve(lambda: ended(client) and ended(other))


CLIENT = """
import socket, sys
held = []
for _ in range(int(sys.argv[2])):
    held.append(socket.socket(socket.AF_UNIX))
    held[-1].connect(sys.argv[1])
print("held", flush=True)
sys.stdin.read()
"""


@contextmanager
def program(folder: Path, connections: int) -> Iterator[int]:
    """Another program with so many connections; its process."""
    with subprocess.Popen(
        [sys.executable, "-c", CLIENT, folder / "ask", str(connections)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as client:
        assert client.stdout is not None and client.stdout.readline() == b"held\n"
        yield client.pid
        client.kill()


def test_one_program_has_a_few_connections(echo: Echo, tmp_path: Path) -> None:
    with program(tmp_path, 100) as pid, connected(tmp_path, place="ask") as other:
        assert asked(echo, other, b"x") == [b"x"]
        echo.serve(lambda: echo.warned)
        assert len(echo.numbers()) == MAX_PER_PROGRAM + 1
        (line,) = echo.warned
        assert line == f"process {pid} has too many connections: some are closed"


def test_many_programs_share_the_connections(
    echo: Echo, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The oldest connection of the busiest goes, but none of a child of this process."""
    monkeypatch.setattr(zmtp, "is_child", lambda pid: pid == os.getpid())
    echo._most = 8
    with ExitStack() as clients:
        own = [clients.enter_context(raw(tmp_path)) for _ in range(6)]
        echo.serve(lambda: len(echo.numbers()) == 6)
        with program(tmp_path, 5):
            echo.serve(lambda: len(echo.numbers()) == 8 and max(echo.numbers()) == 11)
            with connected(tmp_path, place="ask") as another:
                another.send(b"x")
                echo.serve(lambda: max(echo.numbers()) == 12)
        assert not any(map(ended, own))


def test_server_without_a_free_descriptor_waits_for_one(echo: Echo, tmp_path: Path) -> None:
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    with connected(tmp_path, place="ask") as client, ExitStack() as held:
        used = max(int(fd.name) for fd in Path("/dev/fd").iterdir())
        resource.setrlimit(resource.RLIMIT_NOFILE, (used + 8, before[1]))
        try:
            with pytest.raises(OSError, match="Too many open files"):
                while True:
                    held.callback(os.close, os.dup(0))
            client.send(b"x")
            for _ in range(20):
                echo.turn()
            assert not echo.served
            held.close()
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, before)
        echo.serve(lambda: client.poll(0))


FLOODS = {
    "parts without end": (ASKED, READY, b"\x01\xff" + bytes(255)),
    "one message after the other": (ASKED, READY, b"\x00\xff" + bytes(255)),
    "subscriptions": (TOLD, ready(b"SUB"), b"\x00\x09\x01subjects"),
    "heartbeats": (ASKED, READY, b"\x04\x07\x04PING\0\0"),
}


@pytest.mark.parametrize("name", FLOODS)
def test_flood_of_one_client_waits_in_its_sender(echo: Echo, tmp_path: Path, name: str) -> None:
    place, handshake, frame = FLOODS[name]
    with raw(tmp_path, GREETING + handshake, place.name) as flood:
        sent = 0
        stream = frame * 1000
        began = time.monotonic()
        with connected(tmp_path, place="ask") as client:
            for _ in range(20):
                client.send(b"x")
                while not client.poll(0):
                    with suppress(BlockingIOError):
                        sent += flood.send(stream[sent % len(frame) :])
                    echo.turn()
                client.recv()
        took_s = time.monotonic() - began
        connection = next(one for one in echo._open.values() if one.place is place)
        assert sent > 100_000, "the flood was over before it was looked at"
        assert took_s < 20 * 0.5, "others wait"
        assert len(connection.received) <= place.max_bytes + 9
        assert sum(map(len, connection.parts)) <= 2 * place.max_bytes
        assert connection.waiting_bytes <= MAX_OUT_BYTES


def test_client_that_does_not_read_loses_what_is_too_much(echo: Echo, tmp_path: Path) -> None:
    with raw(tmp_path) as lazy:
        echo.serve(lambda: any(one.state == "ready" for one in echo._open.values()))
        (connection,) = echo._open.values()
        for _ in range(100):
            echo.send(connection.identity, b"x" * MAX_BYTES)
        assert MAX_OUT_BYTES - MAX_BYTES - 9 <= connection.waiting_bytes <= MAX_OUT_BYTES
        with connected(tmp_path, place="ask") as other:
            assert asked(echo, other, b"x") == [b"x"]
        echo.serve(lambda: ended(lazy) or not connection.waiting)
        assert not connection.waiting_bytes
