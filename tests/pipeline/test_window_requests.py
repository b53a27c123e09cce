"""What the window asks the supervisor for: settings that stay, the measured camera, and folders."""

from pathlib import Path

import pytest
import zmq

from lfpipe.transport import control
from tests.support.world import World, answer_of, connected


@pytest.mark.live
def test_supervisor_keeps_settings_and_lists_folders(world: World, scene: Path) -> None:
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
        assert answer({"v": 1, "cmd": "keep", "focal_px": 555.5}, "keep")["focal_px"] == 555.5
        assert "[demo]\nfocal_px = 555.5\nwidth_px = 640" in (
            settings.with_name("cameras.toml").read_text()
        )
        assert world.monitor()["config"]["camera"]["focal_px"] == 555.5
        refused = answer({"v": 1, "cmd": "keep", "focal_px": 5.0}, "keep")
        assert not refused["ok"] and "not stored" in str(refused["error"])
        listed = answer({"v": 1, "cmd": "folder", "path": str(scene)}, "folder")
        assert listed["path"] == str(scene) and not listed["folders"]
        names = {path.name for path in scene.glob("*.png")}
        assert isinstance(listed["files"], list) and set(listed["files"]) == names
