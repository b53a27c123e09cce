"""Strangers at the control socket: nothing they send changes the session, ends it or costs a frame."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import msgpack
import zmq

from lfpipe.transport import control
from tests.world import World

WORDS = ["config", "SET", "", "stop\0", 7, None, ["stop"], {"stop": 1}]


def hostile(rng: random.Random) -> bytes:
    """Random bytes, valid msgpack of another shape, commands with wrong contents, too much, too deep, cut short."""
    kind = rng.randrange(7)
    if kind == 0:
        return rng.randbytes(rng.randrange(200))
    if kind == 1:
        others = [None, 5, "stop", [1, 2], {"cmd": "stop"}, {"v": 99, "cmd": "stop"}, {1: 2}]
        return bytes(msgpack.packb(rng.choice(others)))
    if kind == 2:
        return control.encode({"cmd": rng.choice(WORDS), "set": {"render.alpha_px": 3}})
    if kind == 3:
        keys = [{"": 1}, {"render.alpha_px": "x"}, {"a.b.c": 1}, {"render": 5}, {"camera.width_px": 32}]
        sets: list[Any] = [None, 5, "x", [], {}, *keys]
        return control.encode({"cmd": "set", "set": rng.choice(sets)})
    if kind == 4:
        return control.encode({"cmd": "load", "scene": rng.choice([None, 5, "", "a\0b", ["x"]])})
    if kind == 5:
        deep: Any = "stop"
        for _ in range(rng.randrange(10, 600)):
            deep = [deep]
        return bytes(msgpack.packb({"v": 1, "cmd": deep})) if rng.random() < 0.5 else b"\x91" * rng.randrange(60_000)
    whole = control.encode({"cmd": "stop", "why": "x" * rng.randrange(100)})
    return whole[: rng.randrange(len(whole) - 1)]


def test_hostile_messages_change_nothing_and_cost_no_frame(world: World, scene: Path) -> None:
    world.up(scene, "--set", "render.clock=camera", "--set", "render.method=nearest")
    world.pictures(10)
    before = world.monitor()
    config = _config(world)
    rng = random.Random(7)
    run_dir = next(world.run_dir.glob("lfpipe-*"))
    answers = 0
    with control.context() as ctx, ctx.socket(zmq.DEALER) as socket:
        socket.connect(control.address(run_dir, "ctl"))
        for i in range(3000):
            socket.send(hostile(rng))
            if i % 20 == 19:  # as fast as it answers: a flood that fills the socket is another test
                while answers <= i and socket.poll(2000):
                    assert control.decode(socket.recv())["ok"] is False
                    answers += 1
        socket.send_multipart([b"stop", b"stop"])
        assert socket.poll(2000) and control.decode(socket.recv())["ok"] is False
        socket.send(control.encode({"cmd": "status", "why": "x" * (control.MAX_BYTES + 1)}))
        assert socket.poll(2000) and "bytes" in control.decode(socket.recv())["error"]
    assert answers == 3000, "every message is answered"
    after = world.monitor()
    assert _config(world) == config
    for name, stage in after["stages"].items():
        if stage["state"] != "NONE":
            assert (stage["pid"], stage["restarts"]) == (before["stages"][name]["pid"], 0)
    seqs = [line["source_seq"] for line in world.pictures(len(world.lines()) + 5)]
    assert len(seqs) == len(set(seqs)) and after["stages"]["render"]["dropped"] == before["stages"]["render"]["dropped"]


def _config(world: World) -> Any:
    done = world.run("ctl", "status", "--session", world.name, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)["config"]
