"""Requests of valid structure with wrong values, to the supervisor of a live session."""

import copy
import itertools
import os
import random
from pathlib import Path
from typing import Any

import msgpack
import zmq

from lfpipe.config import options
from lfpipe.supervisor.process_table import NAMES
from lfpipe.supervisor.requests import commands
from lfpipe.transport import control
from tests.support.world import World, answer_of, connected

Message = dict[str, Any]
COUNT = int(os.environ.get("LFPIPE_FUZZ", "200"))
AS_STAGE = COUNT // 20  # requests from clients with the name of a stage
LEFT_OUT = ("stop",)  # it does what it is asked, whatever else it says
NUMBERS = [0, 1, -1, 2**63 - 1, -(2**63), 2**64 - 1, 1e-300, 1e308, 0.5]
NOT_FINITE = [float("nan"), float("inf"), float("-inf")]
TEXTS = ["", "\0", "/", "//", "a" * 5000, "\x1b[2J", "\udcff", "auto", "warp", "60", "x" * 65_000]
PATHS = ["/dev/null", "/dev/zero", "/proc/self/mem", "../x", "/nowhere/x", "\n"]
NESTED: list[Any] = [[], {}, [[]], [None], {"": {}}, [1] * 1000, {"x": [{"y": []}]}, b"\xff"]
VALUES = [None, True, False, *NUMBERS, *NOT_FINITE, *TEXTS, *PATHS, *NESTED]
RESERVED = ["ok", "error", "config", "options", "number", "rev", "stage", "id", "v", "cmd"]
KEYS = [*options()]


def valid(scene: Path) -> list[Message]:
    """A request of each command."""
    sets = [{"cmd": "set", "set": {key: value}} for key, value in SOME_SETTINGS.items()]
    return [
        *sets,
        {"cmd": "hello"},
        {"cmd": "status"},
        {"cmd": "pause"},
        {"cmd": "resume"},
        {"cmd": "recentre"},
        {"cmd": "look", "x": 0.5, "y": 0.5},
        {"cmd": "action", "name": "glasses"},
        {"cmd": "load", "scene": str(scene), "layout": "auto", "grid": ""},
        {"cmd": "load", "at": 0},
        {"cmd": "load", "step": 1},
        {"cmd": "pictures", "lease_s": 1.0},
        {"cmd": "trace", "path": ""},
        {"cmd": "record", "path": ""},
        {"cmd": "keep", "section": "render", "values": {"swap_eyes": False}},
        {"cmd": "keep", "depth": "asked"},
        {"cmd": "keep", "focal_px": 600.0},
        {"cmd": "costs", "ns_per_px": {"warp": 7.0}, "picture_px": 512, "cores": 2},
        {"cmd": "executed", "number": 1, "ok": True, "error": "", "path": "/x"},
        {"cmd": "share", "start": "osc:127.0.0.1:9", "stop": ""},
    ]


SOME_SETTINGS = {"render.alpha_px": 12.0, "render.method": "nearest", "track.filter": "mean"}


def mutated(message: Message, chance: random.Random) -> Message:
    """The message with one to three other values, keys or a command."""
    message = copy.deepcopy(message)
    for _ in range(chance.randint(1, 3)):
        place: Any = message
        while True:
            key = chance.choice([*place, chance.choice(RESERVED), chance.choice(KEYS)])
            inner = place.get(key)
            if isinstance(inner, dict) and inner and chance.random() < 0.7:
                place = inner
                continue
            break
        if key == "cmd" and place is message:
            message["cmd"] = chance.choice([c for c in commands() if c not in LEFT_OUT])
        elif chance.random() < 0.15:
            place.pop(key, None)
        elif isinstance(inner, int | float) and chance.random() < 0.4:
            place[key] = chance.choice([inner // 2, inner * 1e6, inner + 0.5, str(inner)])
        elif isinstance(inner, str) and chance.random() < 0.3:
            place[key] = chance.choice([inner * 50, inner[1:], inner.upper(), [inner]])
        else:
            place[key] = copy.deepcopy(chance.choice(VALUES))
    message.setdefault("v", 2)
    return message


def send_telemetry_of_any_shape(world: World) -> None:
    with connected(world.session_dir, zmq.PUSH, "bus") as bus, world.tap() as received:
        shapes: list[Any] = [5, None, [5], {"a": 1}, "text", [["deep"]], "\x1b[2J"]
        for topic, shape in itertools.product(
            ("notice", "source", "parallax", "level", 5, None, ["notice"]), shapes
        ):
            bus.send(msgpack.packb({"v": 2, "topic": topic, "notes": shape, "text": shape}))
        bus.send_multipart([b"two", b"parts"])
        bus.send(b"\xc1garbage")
        bus.send(control.encode({"topic": "last"}))
        world.wait_for(lambda: received("last"), "the last message")


def test_mutated_requests_end_no_session_and_leave_nothing(world: World, scene: Path) -> None:
    process = world.shows(scene, "--set", "governor.quality=fixed")
    before = {path.name for path in world.root.iterdir()}
    chance = random.Random(55)
    requests = valid(scene)
    with control.context() as ctx, ctx.socket(zmq.DEALER) as client:
        control.connect(client, world.session_dir, "ctl")
        for _ in range(COUNT):
            message = mutated(chance.choice(requests), chance)
            if message.get("cmd") in LEFT_OUT or message.get("path") == str(scene):
                continue
            data = msgpack.packb(message, unicode_errors="surrogateescape")
            if len(data) > 2 * control.MAX_BYTES:
                continue  # its client is disconnected
            client.send(data)
            assert client.poll(60_000), message
            answer = control.decode(client.recv())
            assert answer["ok"] in (True, False) and (answer["ok"] or answer["error"]), message
            assert not client.poll(0), f"a second answer to {message!r:.300}"
            assert answer.get("error") != "internal error", message
        client.send_multipart([b"stop", b"stop"])
        assert client.poll(60_000) and control.decode(client.recv())["ok"] is False
        large = {"v": 2, "cmd": "status", "why": "x" * (control.MAX_BYTES + 1)}
        assert answer_of(client, large)["ok"] is False
    send_telemetry_of_any_shape(world)
    world.ask(cmd="resume")
    # the trace may have been stopped
    shown = world.monitor()["stages"]["render"]["count"]
    world.wait_for(
        lambda: world.monitor()["stages"]["render"]["count"] > shown + 5, "further pictures"
    )
    assert not [one for one in world.monitor()["stages"].values() if one["restarts"]]
    assert {path.name for path in world.root.iterdir()} <= before | {"settings", "cache", "state"}
    with control.context() as ctx:
        for _ in range(AS_STAGE):  # last: the stages have lost their names
            message = mutated(chance.choice(requests), chance)
            if message.get("cmd") not in LEFT_OUT:
                data = msgpack.packb(message, unicode_errors="surrogateescape")
                _as_stage(ctx, world, chance.choice(NAMES), data[: control.MAX_BYTES])
    assert world.ask(cmd="stop")["ok"]
    said = world.ended(process)
    assert "internal error" not in said


def _as_stage(ctx: zmq.Context[zmq.Socket[bytes]], world: World, name: str, data: bytes) -> None:
    """Sends a message as a client with the name of a stage, until it has been read."""
    with ctx.socket(zmq.DEALER) as client:
        client.setsockopt(zmq.IDENTITY, name.encode())
        control.connect(client, world.session_dir, "ctl")
        client.send(data)
        client.send(control.encode({"cmd": "hello", "id": "last"}))
        while True:
            assert client.poll(60_000)
            if control.decode(client.recv()).get("id") == "last":
                return
