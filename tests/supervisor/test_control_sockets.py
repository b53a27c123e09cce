"""The control sockets of a real session: it survives any message."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import msgpack
import zmq

from lfpipe.supervisor.control_sockets import ControlSockets, Request
from lfpipe.transport import control
from lfpipe.transport.control import BadMessage
from tests.supervisor.raw_bytes import byte_strings, send_raw
from tests.support.world import World, connected


def test_control_sockets_let_no_escape_sequence_through(
    world: World, scene: Path, tmp_path: Path
) -> None:
    process = world.shows(scene)
    with world.tap() as heard, connected(world.session_dir, zmq.PUSH, "bus") as bus:
        bus.send(control.encode({"topic": "notice", "text": "\x1b[2J\x1b]0;owned\x07 of the bus"}))
        world.wait_for(lambda: heard("notice"), "notice")
    out = tmp_path / "\x1b[2J"
    printed = world.ctl("record", "start", out) + world.ctl("record", "stop")
    assert "\\x1b[2J" in printed and "\x1b" not in printed
    assert world.ask(cmd="stop")["ok"]
    err = world.ended(process)
    assert "of the bus" in err and "\x1b" not in err


def test_control_sockets_answer_after_thousands_of_byte_strings(
    tmp_path: Path,
) -> None:
    with (
        ThreadPoolExecutor(1) as attacker,
        closing(ControlSockets(tmp_path)) as sockets,
    ):
        attack = attacker.submit(_attack, tmp_path)
        while not attack.done():
            _serve_once(sockets)
        assert attack.result() == 9_000
        with connected(tmp_path) as client:
            client.send(control.encode({"cmd": "status", "id": 7}))
            while not client.poll(1):
                _serve_once(sockets)
            answer = control.decode(client.recv())
    assert answer == {"v": 2, "cmd": "status", "id": 7, "rev": 5, "ok": True}


IDS = [None, True, 7, -1, 2**64 - 1, 1.5, "", "é" * 32, b"", bytes(64), "\udcff"]
WRONG_IDS = ["x" * 65, "é" * 33, bytes(65), [1], {"a": 1}]


def test_answer_repeats_the_id_and_the_command_of_its_request(tmp_path: Path) -> None:
    with (
        closing(ControlSockets(tmp_path)) as sockets,
        connected(tmp_path) as client,
    ):

        def answered(message: dict[str, Any]) -> dict[str, Any]:
            client.send(msgpack.packb(message, unicode_errors="surrogateescape"))
            while not client.poll(1):
                _serve_once(sockets)
            return control.decode(client.recv())

        for one in IDS:
            answer = answered({"v": 2, "cmd": "status", "id": one})
            assert answer["ok"] and answer["cmd"] == "status"
            assert answer["id"] == one and type(answer["id"]) is type(one)
            refused = answered({"v": 1, "cmd": "status", "id": one})
            assert not refused["ok"] and refused["id"] == one
        assert "id" not in answered({"v": 2, "cmd": "status"})
        for wrong in WRONG_IDS:
            refused = answered({"v": 2, "cmd": "status", "id": wrong})
            assert "an id is" in refused["error"] and "id" not in refused


def _attack(folder: Path) -> int:
    return sum(send_raw(folder / name, byte_strings(3_000)) for name in ("ctl", "bus", "tap"))


def _serve_once(sockets: ControlSockets) -> None:
    for request in sockets.messages():
        if not isinstance(request, Request):
            continue
        try:
            request.decode()
            sockets.answer(request, 5, {"ok": True})
        except BadMessage as error:
            sockets.answer(request, 5, {"ok": False, "error": str(error)})
    zmq.select(sockets.fds, [], [], 0.01)
