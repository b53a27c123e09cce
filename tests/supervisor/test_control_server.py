"""The control sockets of a real session: it survives any message."""

import itertools
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zmq
from hypothesis import HealthCheck, given, settings

from lfpipe.supervisor.control_server import Connections
from lfpipe.transport import control
from tests.supervisor.states import messages
from tests.world import World


@pytest.fixture
def client(world: World, scene: Path) -> Iterator[zmq.Socket[bytes]]:
    """A client of a session that runs, with which nothing is wrong afterwards."""
    process = world.up(scene)
    world.pictures(5)
    with control.context() as ctx, ctx.socket(zmq.DEALER) as socket:
        control.connect(socket, world.session_dir, "ctl")
        yield socket
        assert ask(socket, {"v": 1, "cmd": "status"})["ok"]
        world.more_pictures(3)
        assert ask(socket, {"v": 1, "cmd": "stop"})["ok"]
    world.ended(process)


def ask(socket: zmq.Socket[bytes], message: dict[str, Any]) -> dict[str, Any]:
    socket.send(msgpack.packb(message, unicode_errors="surrogatepass"))
    assert socket.poll(60_000), f"no answer to {message!r:.200}"
    data = socket.recv()
    assert len(data) <= control.MAX_BYTES
    return control.decode(data)


def send_telemetry_of_any_shape(world: World) -> None:
    with control.context() as ctx, ctx.socket(zmq.PUSH) as bus:
        control.connect(bus, world.session_dir, "bus")
        shapes: list[Any] = [5, None, [5], {"a": 1}, "text", [["deep"]], "\x1b[2J"]
        for topic, shape in itertools.product(
            ("notice", "source", "parallax", "level", 5, None, ["notice"]), shapes
        ):
            bus.send(msgpack.packb({"v": 1, "topic": topic, "notes": shape, "text": shape}))
        bus.send_multipart([b"two", b"parts"])
        bus.send(b"\xc1garbage")
        time.sleep(0.3)


def test_every_shape_of_request_is_answered_and_the_session_goes_on(
    client: zmq.Socket[bytes], world: World, tmp_path: Path, scene: Path
) -> None:
    before = ask(client, {"v": 1, "cmd": "hello"})

    @settings(max_examples=200, suppress_health_check=list(HealthCheck))
    @given(messages)
    def attack(message: dict[str, Any]) -> None:
        if message["cmd"] not in (
            "stop",
            "load",
            "record",
            "trace",
        ):  # what these may do to a session is tested elsewhere
            answer = ask(client, message)
            assert answer["ok"] in (True, False) and (answer["ok"] or answer["error"])

    attack()
    client.send_multipart([b"stop", b"stop"])
    assert client.poll(60_000) and control.decode(client.recv())["ok"] is False
    assert (
        ask(client, {"v": 1, "cmd": "status", "why": "x" * (control.MAX_BYTES + 1)})["ok"] is False
    )
    for path in (
        "/\udcff",
        "/tmp/\x1b[2J",
        f"{tmp_path}/{'x' * 300}",
        "/dev/zero",
        "/proc/self/mem",
    ):
        assert ask(client, {"v": 1, "cmd": "load", "scene": path})["ok"] is False
    assert ask(client, {"v": 1, "cmd": "resume"})["ok"]
    after = ask(client, {"v": 1, "cmd": "hello"})
    assert {**after["config"], "render": 0} == {**before["config"], "render": 0}
    os.mkfifo(tmp_path / "view_00_00.png")
    assert ask(client, {"v": 1, "cmd": "load", "scene": str(tmp_path)})["ok"] is False
    assert ask(client, {"v": 1, "cmd": "load", "scene": str(scene)})["ok"] is True
    send_telemetry_of_any_shape(world)


def test_a_flood_keeps_neither_frames_nor_other_clients_waiting(
    client: zmq.Socket[bytes], world: World
) -> None:
    """Only a limited part of a flood is read per unit of time, from each client in turn."""
    with (
        control.context() as ctx,
        ctx.socket(zmq.DEALER) as flood,
        ctx.socket(zmq.DEALER) as stranger,
    ):
        for socket in (flood, stranger):
            control.connect(socket, world.session_dir, "ctl")
        stranger.send(
            msgpack.packb({"v": 1, "cmd": "stop", "why": "x" * (3 * control.MAX_BYTES)})
        )  # is not even read
        flood.set_hwm(100_000)
        message = control.encode({"cmd": "set", "set": {"render.alpha_px": 12.0}})
        for _ in range(20_000):
            flood.send(message)
        begin = time.monotonic()
        for _ in range(10):
            assert ask(client, {"v": 1, "cmd": "status"})["ok"], "a flood shuts others out"
        took_s, answered = time.monotonic() - begin, 0
        while flood.poll(0):
            flood.recv()
            answered += 1
        assert answered < 20_000, (
            "the flood was over before it was looked at: this test shows nothing"
        )
        assert answered < 2000 * took_s + 200, "no more is read than in the server's slices"
        world.more_pictures(10)
        assert not any(stage["restarts"] for stage in world.monitor()["stages"].values())


def test_a_client_is_connected_even_if_its_connection_has_the_number_of_one_that_ended_just_before(
    tmp_path: Path,
) -> None:
    """Else the server takes its request for abandoned and never answers."""
    with control.context() as ctx, ctx.socket(zmq.ROUTER) as ctl:
        clients = Connections(ctl)
        control.bind(ctl, tmp_path, "ctl")
        numbers = []
        for _ in range(
            2
        ):  # the end of the first is not processed before the second one's message is read
            with control.context() as other, other.socket(zmq.DEALER) as client:
                control.connect(client, tmp_path, "ctl")
                client.send(b"")
                assert ctl.poll(60_000)
                numbers.append(int(ctl.recv_multipart(copy=False)[0].get(zmq.SRCFD)))
                if len(numbers) == 2:
                    clients.update()
                    assert numbers[1] in clients.open
            assert clients.events.poll(60_000)
        while clients.open:
            assert clients.events.poll(60_000)
            clients.update()
        clients.close()
