"""What the window asks the supervisor for: settings that stay, and the desktop's file dialog."""

import os
from pathlib import Path

import pytest
import zmq

from lfpipe.transport import control
from tests.support.world import World, answer_of, connected, write_scene


@pytest.mark.live
def test_supervisor_keeps_settings_and_loads_the_dialog_choice(
    world: World, scene: Path, tmp_path: Path
) -> None:
    other = write_scene(tmp_path / "other", 1, 5)
    zenity = tmp_path / "bin" / "zenity"
    zenity.parent.mkdir()
    zenity.write_text(f"#!/bin/sh\necho {other}\n")
    zenity.chmod(0o755)
    world.env["PATH"] = f"{zenity.parent}:{os.environ['PATH']}"
    world.shows(scene)
    keep = {"v": 1, "cmd": "keep", "section": "render", "values": {"swap_eyes": True}}
    with connected(world.session_dir) as client:
        assert "only the window" in answer_of(client, keep)["error"]
    with control.context() as ctx, ctx.socket(zmq.DEALER) as window:
        window.setsockopt(zmq.IDENTITY, b"render")  # in place of the stage
        control.connect(window, world.session_dir, "ctl")

        def answer(message: dict[str, object], command: str) -> dict[str, object]:
            window.send(control.encode(message))
            while True:
                assert window.poll(60_000), message
                heard = control.decode(window.recv())
                if heard["cmd"] == command and "ok" in heard:
                    return heard

        assert answer(keep, "keep")["values"] == {"swap_eyes": True}
        settings = world.root / "settings" / "lfpipe" / "config.toml"
        assert settings.read_text() == "[render]\nswap_eyes = true\n"
        wrong = answer({**keep, "values": {"swap_eyes": 5}}, "keep")
        assert not wrong["ok"] and "swap_eyes" in str(wrong["error"])
        assert "pack" in answer({"cmd": "dialog", "folder": True}, "dialog")
    assert world.ask(cmd="hello")["options"]["scene"]["name"] == "other"
