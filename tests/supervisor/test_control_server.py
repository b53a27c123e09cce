"""The control sockets of a real session: it survives any message."""

import os
import random
import socket
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zmq
from hypothesis import HealthCheck, given, settings

from lfpipe.supervisor import server_limits
from lfpipe.supervisor.server_limits import ConnectionLimit
from lfpipe.transport import control
from lfpipe.transport.session import PREFIX
from tests.faults.hostile import hostile
from tests.supervisor.holder import ROOT
from tests.supervisor.states import messages
from tests.world import World, raw_address

CAMERA = ("--camera", "demo", "--display", "none")


def run_dir(world: World) -> Path:
    return world.run_dir / f"{PREFIX}{world.name}"


@pytest.fixture
def client(world: World, scene: Path) -> Iterator[zmq.Socket[bytes]]:
    """A client of a session that runs, with which nothing is wrong afterwards."""
    process = world.up(scene, *CAMERA)
    world.pictures(5)
    with control.context() as ctx, ctx.socket(zmq.DEALER) as socket:
        control.connect(socket, run_dir(world), "ctl")
        yield socket
        count = len(world.lines())
        assert ask(socket, {"v": 1, "cmd": "status"})["ok"]
        world.pictures(count + 3)
        assert ask(socket, {"v": 1, "cmd": "stop"})["ok"]
    _, err = process.communicate(timeout=120)
    assert process.returncode == 0 and "Traceback" not in err, err
    assert not world.left()


def ask(socket: zmq.Socket[bytes], message: dict[str, Any]) -> dict[str, Any]:
    socket.send(msgpack.packb(message, unicode_errors="surrogatepass"))
    assert socket.poll(20_000), f"no answer to {message!r:.200}"
    data = socket.recv()
    assert len(data) <= control.MAX_BYTES
    return control.decode(data)


def test_every_shape_of_request_is_answered_and_the_session_goes_on(client: zmq.Socket[bytes], tmp_path: Path) -> None:
    before = ask(client, {"v": 1, "cmd": "hello"})

    @settings(max_examples=200, suppress_health_check=list(HealthCheck))
    @given(messages)
    def attack(message: dict[str, Any]) -> None:
        if message["cmd"] not in ("stop", "load", "record", "trace"):  # what these may do to a session is tested elsewhere
            answer = ask(client, message)
            assert answer["ok"] in (True, False) and (answer["ok"] or answer["error"])

    attack()
    for sets in ({"render": {}}, {"render": {"method": {}}}, {f"x{i}": 1 for i in range(3626)}):
        assert ask(client, {"v": 1, "cmd": "set", "set": sets})["ok"] is False
    rng = random.Random(7)
    for count in range(1000):
        client.send(hostile(rng))
        if count % 20 == 19:
            for _ in range(20):
                assert client.poll(20_000) and control.decode(client.recv())["ok"] is False
    client.send_multipart([b"stop", b"stop"])
    assert client.poll(20_000) and control.decode(client.recv())["ok"] is False
    assert ask(client, {"v": 1, "cmd": "status", "why": "x" * (control.MAX_BYTES + 1)})["ok"] is False
    for path in ("/\udcff", "/tmp/\x1b[2J", f"{tmp_path}/{'x' * 300}", "/dev/zero", "/proc/self/mem"):
        assert ask(client, {"v": 1, "cmd": "load", "scene": path})["ok"] is False
    assert ask(client, {"v": 1, "cmd": "resume"})["ok"]
    after = ask(client, {"v": 1, "cmd": "hello"})
    assert {**after["config"], "render": 0} == {**before["config"], "render": 0}


def test_a_flood_keeps_neither_frames_nor_other_clients_waiting(client: zmq.Socket[bytes], world: World) -> None:
    """Only a limited part of a flood is read per unit of time, from each client in turn."""
    with control.context() as ctx, ctx.socket(zmq.DEALER) as flood, ctx.socket(zmq.DEALER) as stranger:
        for socket in (flood, stranger):
            control.connect(socket, run_dir(world), "ctl")
        stranger.send(msgpack.packb({"v": 1, "cmd": "stop", "why": "x" * (3 * control.MAX_BYTES)}))  # is not even read
        flood.set_hwm(100_000)
        message = control.encode({"cmd": "set", "set": {"render.alpha_px": 12.0}})
        for _ in range(20_000):
            flood.send(message)
        begin, count = time.monotonic(), len(world.lines())
        for _ in range(10):
            assert ask(client, {"v": 1, "cmd": "status"})["ok"], "a flood shuts others out"
        took_s, answered = time.monotonic() - begin, 0
        while flood.poll(0):
            flood.recv()
            answered += 1
        assert answered < 20_000, "the flood was over before it was looked at: this test shows nothing"
        assert answered < 2000 * took_s + 200, "no more is read than in the server's slices"
        world.pictures(count + 10)
        assert not any(stage["restarts"] for stage in world.monitor()["stages"].values())


def test_telemetry_of_any_shape_ends_nothing(client: zmq.Socket[bytes], world: World) -> None:
    with control.context() as ctx, ctx.socket(zmq.PUSH) as bus:
        control.connect(bus, run_dir(world), "bus")
        shapes: list[Any] = [5, None, [5], {"a": 1}, "text", [["deep"]], "\x1b[2J"]
        for topic in ("notice", "source", "parallax", "level", 5, None, ["notice"]):
            for shape in shapes:
                bus.send(msgpack.packb({"v": 1, "topic": topic, "notes": shape, "text": shape}))
        bus.send_multipart([b"two", b"parts"])
        bus.send(b"\xc1garbage")
        time.sleep(0.3)


def test_a_load_of_a_fifo_among_the_views_is_answered_and_the_next_load_too(
    client: zmq.Socket[bytes], tmp_path: Path, scene: Path
) -> None:
    os.mkfifo(tmp_path / "view_00_00.png")
    assert ask(client, {"v": 1, "cmd": "load", "scene": str(tmp_path)})["ok"] is False
    assert ask(client, {"v": 1, "cmd": "load", "scene": str(scene)})["ok"] is True


def hold_connections(run_dir: Path, count: int) -> subprocess.Popen[str]:
    """A process with count silent connections."""
    program = """
        import pathlib, resource, socket, sys, time
        from tests.world import raw_address
        family, address = raw_address(pathlib.Path(sys.argv[1]), "ctl")
        hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
        held = []
        end = time.monotonic() + 60
        while len(held) < int(sys.argv[2]) and time.monotonic() < end:
            one = socket.socket(family)
            one.settimeout(1)
            try:
                one.connect(address)
            except OSError:  # the queue of new connections is full, or nobody listens
                time.sleep(0.01)
                continue
            held.append(one)
        print(len(held), flush=True)
        time.sleep(100)
    """
    command = [sys.executable, "-c", textwrap.dedent(program), str(run_dir), str(count)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)


def test_idle_connections_end_no_session_and_the_next_client_is_served_when_they_have_left(
    client: zmq.Socket[bytes], world: World
) -> None:
    holder = hold_connections(run_dir(world), 1200)
    assert holder.stdout is not None and int(holder.stdout.readline()) > server_limits.MOST_CONNECTIONS
    assert ask(client, {"v": 1, "cmd": "status"})["ok"], "who is connected is served"
    holder.kill()
    holder.wait()
    world.wait_for(lambda: not world.run("ctl", "--session", world.name, "status").returncode, "service for new clients")


def test_connections_beyond_the_limit_are_closed_and_those_before_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server_limits, "MOST_CONNECTIONS", 8)
    said: list[str] = []
    with control.context() as ctx, ctx.socket(zmq.ROUTER) as ctl:
        limit = ConnectionLimit([ctl], said.append)
        control.bind(ctl, tmp_path, "ctl")

        def connect() -> socket.socket:
            """A connection; what libzmq greets it with is taken."""
            family, address = raw_address(tmp_path, "ctl")
            made = socket.socket(family)
            made.settimeout(10)
            made.connect(address)
            assert made.recv(64)
            limit.serve()
            return made

        def closed(connection: socket.socket) -> bool:
            connection.settimeout(0.2)
            try:
                return not connection.recv(64)
            except TimeoutError:
                return False
            except ConnectionResetError:
                return True

        held = [connect() for _ in range(8)]
        late = connect()
        assert closed(late) and not any(closed(one) for one in held) and len(said) == 1
        for one in held[:3]:
            one.close()
        end = time.monotonic() + 10
        while closed(late := connect()):
            assert time.monotonic() < end, "there is room again"
        limit.close()
