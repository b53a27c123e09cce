"""No client makes the supervisor of a session silent, large, or end."""

import multiprocessing
import resource
import select
import signal
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from itertools import count
from pathlib import Path

import psutil
import pytest

from lfpipe.transport import control
from tests.supervisor.raw_bytes import GREETING, PUSHING, READY, ready
from tests.support.world import World, connected

FILES = 256  # descriptors of the session: some systems allow no more
LARGEST_MB = 150
FLOOD_S = 1.0
# goal: 1 s. Far less on an idle machine, but the flood takes one core, and the tests beside this
# one others
ANSWER_S = 3.0


def _frame(body: bytes, flags: int = 0) -> bytes:
    return bytes([flags | 2]) + len(body).to_bytes(8) + body


def _connected(path: Path, hello: bytes) -> socket.socket:
    client = socket.socket(socket.AF_UNIX)
    client.connect(str(path))
    client.sendall(GREETING + hello)
    client.setblocking(False)
    return client


def _send_forever(path: Path, hello: bytes, data: Callable[[int], bytes], connections: int) -> None:
    """Sends data on so many connections, on a new one where the session ends one."""
    clients: dict[socket.socket, bytes] = {}
    for number in count():
        while len(clients) < connections:
            with suppress(OSError):
                clients[_connected(path, hello)] = b""
        for client in select.select([], list(clients), [], 0.1)[1]:
            rest = clients[client] or data(number)
            try:
                clients[client] = rest[client.send(rest) :]
            except BlockingIOError:
                pass
            except OSError:
                del clients[client]


def _open_forever(path: Path, held: int) -> None:
    """Opens connections that say nothing, and holds so many."""
    clients: list[socket.socket] = []
    while True:
        client = socket.socket(socket.AF_UNIX)
        with suppress(OSError):
            client.connect(str(path))
        clients = [*clients, client][-held:] if held else []


LARGE = "x" * 60_000
DEEP = control.encode({"cmd": "set", "set": {f"k{n}": [[[[[n]]]]] for n in range(4000)}})
FLOODS: dict[str, tuple[str, Callable[[Path], None]]] = {
    "connections": ("ctl", partial(_open_forever, held=900)),
    "connections that end": ("ctl", partial(_open_forever, held=0)),
    "subscriptions": (
        "tap",
        partial(
            _send_forever,
            hello=ready(b"SUB"),
            data=lambda n: b"".join(_frame(b"\1%d" % (1000 * n + i)) for i in range(1000)),
            connections=4,
        ),
    ),
    "requests without a reader": (
        "ctl",
        partial(
            _send_forever,
            hello=READY,
            data=lambda _: 100 * _frame(control.encode({"cmd": "hello"})),
            connections=30,
        ),
    ),
    "large requests": (
        "ctl",
        partial(_send_forever, hello=READY, data=lambda _: _frame(DEEP), connections=30),
    ),
    "telemetry": (
        "bus",
        partial(
            _send_forever,
            hello=PUSHING,
            data=lambda _: _frame(control.encode({"topic": "notice", "text": LARGE})),
            connections=30,
        ),
    ),
    "parts": (
        "ctl",
        partial(
            _send_forever,
            hello=READY,
            data=lambda _: 10 * _frame(LARGE.encode(), flags=1),
            connections=30,
        ),
    ),
}


@pytest.mark.live
@pytest.mark.native("sockets with a path")
def test_supervisor_answers_others_during_a_flood(
    world: World, scene: Path, record_property: Callable[[str, object], None]
) -> None:
    process = world.shows(
        scene,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (FILES, FILES)),
    )
    fork = multiprocessing.get_context("fork")  # the floods are no part of a module
    for name, (place, flood) in FLOODS.items():
        attacker = fork.Process(target=flood, args=(world.session_dir / place,), daemon=True)
        attacker.start()
        longest_s = largest_mb = 0.0
        end = time.monotonic() + FLOOD_S
        while time.monotonic() < end:
            began = time.monotonic()
            with connected(world.session_dir) as client:
                client.send(control.encode({"cmd": "status"}))
                assert client.poll(60_000), f"{name}: no answer"
                assert control.decode(client.recv())["ok"]
            longest_s = max(longest_s, time.monotonic() - began)
            largest_mb = max(largest_mb, psutil.Process(process.pid).memory_info().rss / 1e6)
        attacker.kill()
        attacker.join()
        record_property(name, f"{longest_s:.2f} s, {largest_mb:.0f} MB")
        assert longest_s < ANSWER_S, f"{name}: silent for {longest_s:.1f} s"
        assert largest_mb < LARGEST_MB, f"{name}: {largest_mb:.0f} MB"
    world.more_pictures(5)
    assert not any(stage["restarts"] for stage in world.monitor()["stages"].values())
    said = world.ended(process, signal.SIGINT)
    assert "has too many connections: some are closed" in said
