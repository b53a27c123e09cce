"""Strangers at the control socket: none of their messages changes the session, ends it or costs a frame."""

import random
import time
from collections.abc import Iterator

import msgpack
import pytest
import zmq

from lfpipe.transport import control
from tests.faults.hostile import pester
from tests.faults.session import STAGES, WatchedSession
from tests.world import World

pytestmark = pytest.mark.live

MANY = pytest.param(100_000, marks=(pytest.mark.soak, pytest.mark.timeout(1200)))


@pytest.fixture
def session(world: World, monkeypatch: pytest.MonkeyPatch) -> Iterator[WatchedSession]:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(world.run_dir))
    made = WatchedSession(world, size_px=(320, 240))
    yield made
    made.end()


@pytest.mark.parametrize("count", [3000, MANY])
def test_hostile_messages_change_nothing_and_delay_no_frames(session: WatchedSession, count: int) -> None:
    before, config, pids = session.books(), session.told(), [session.pid(name) for name in STAGES]
    assert pester(session.run_dir, random.Random(7), count) == count, "every message is answered"
    with control.context() as ctx, ctx.socket(zmq.DEALER) as socket:
        control.connect(socket, session.run_dir, "ctl")
        socket.send_multipart([b"stop", b"stop"])
        assert socket.poll(2000) and control.decode(socket.recv())["ok"] is False
        socket.send(msgpack.packb({"v": 1, "cmd": "status", "why": "x" * (control.MAX_BYTES + 1)}))
        assert socket.poll(2000) and "bytes" in control.decode(socket.recv())["error"]
        socket.send(msgpack.packb({"v": 1, "cmd": "stop", "why": "x" * (3 * control.MAX_BYTES)}))
        assert not socket.poll(300), "that much is not even read"
    after = session.books()
    assert session.told() == config
    assert [session.pid(name) for name in STAGES] == pids and not any(session.restarts(name) for name in STAGES)
    assert after.frames > before.frames and not any(after.errors().values())
    lost = after.track_drops + after.render_drops - before.track_drops - before.render_drops
    assert lost <= (after.frames - before.frames) / 2, "other programs may cost frames here; the script has the exact figure"


def test_a_flood_keeps_neither_frames_nor_other_clients_waiting(session: WatchedSession) -> None:
    """Only a limited part of a flood is read per unit of time, from each client in turn."""
    with control.context() as ctx, ctx.socket(zmq.DEALER) as flood, ctx.socket(zmq.DEALER) as other:
        for socket in (flood, other):
            control.connect(socket, session.run_dir, "ctl")
        flood.set_hwm(100_000)
        message = control.encode({"cmd": "set", "set": {"render.alpha_px": 12.0}})
        for _ in range(20_000):
            flood.send(message)
        begin, waits = time.monotonic(), []
        rev = int(session.watcher.table.rows["render"]["config_rev"])
        for _ in range(10):
            asked = time.monotonic()
            other.send(control.encode({"cmd": "status"}))
            assert other.poll(5000), "a flood shuts others out"
            assert control.decode(other.recv())["ok"]
            waits.append(time.monotonic() - asked)
        took_s, answered = time.monotonic() - begin, 0
        while flood.poll(0):
            flood.recv()
            answered += 1
        assert answered < 20_000, "the flood was over before it was looked at: this test shows nothing"
        assert answered < 2000 * took_s + 200, "no more is taken than in the desk's slices"
        session.pictures_again()
        assert int(session.watcher.table.rows["render"]["config_rev"]) > rev, "and it is obeyed"
    assert not any(session.restarts(name) for name in STAGES)
