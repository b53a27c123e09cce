"""Strangers at the control socket: nothing they send changes the session, ends it or costs a frame."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import zmq

from lfpipe.transport import control
from tests.faults.hostile import hostile
from tests.world import World

MESSAGES = 8000  # profiling/control_fuzz.py sends 10^5


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
        for i in range(MESSAGES):
            socket.send(hostile(rng))
            if i % 20 == 19:  # as fast as it answers: a flood that fills the socket is another test
                while answers <= i and socket.poll(2000):
                    assert control.decode(socket.recv())["ok"] is False
                    answers += 1
        socket.send_multipart([b"stop", b"stop"])
        assert socket.poll(2000) and control.decode(socket.recv())["ok"] is False
        socket.send(control.encode({"cmd": "status", "why": "x" * (control.MAX_BYTES + 1)}))
        assert socket.poll(2000) and "bytes" in control.decode(socket.recv())["error"]
    assert answers == MESSAGES, "every message is answered"
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
