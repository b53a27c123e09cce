"""The viewer of a running session is exchanged, by its window and by other clients."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from lfpipe.errors import UserError
from lfpipe.render.display.window import TEXT_PX
from lfpipe.render.display.window_system import pygame
from lfpipe.render.ui.overlay_view import text_panel
from lfpipe.render.ui.pages import RECORDED_FACE
from lfpipe.scene.demo import NAME
from tests.support.finger import Finger
from tests.support.world import World, write_scene
from tests.support.xvfb_screen import Screen, needs_xdotool, outline


def _source(world: World) -> str:
    return str(world.ask(cmd="hello")["options"]["viewer"].get("source", "mouse"))


@needs_xdotool
def test_viewer_of_the_demo_is_exchanged_by_mouse_alone_and_by_keys_alone(
    world: World, screen: Screen
) -> None:
    world.env["DISPLAY"] = screen.name
    pygame.font.init()
    # the real one takes half a minute to make
    scene = write_scene(world.root / NAME, 2, 3)
    settings = world.root / "settings" / "lfpipe" / "config.toml"
    settings.parent.mkdir(parents=True)
    settings.write_text('[render]\nanaglyph = "dubois"\n')
    process = world.start(
        "up", scene, "--camera", "demo", "--session", world.name, "--trace", world.trace
    )
    hints = "(h shows the keys, g tests your glasses)"
    finger = Finger(world, screen, f"lfpipe: {NAME} {hints}", frozenset({"choose"}))
    world.wait_for(lambda: outline(finger.title, screen.name), "window")
    offer = text_panel(RECORDED_FACE, finger.bar().at[1], finger.size_px, TEXT_PX)
    world.wait_for(lambda: finger.dark(offer), "the offer")

    def states() -> set[str]:
        stages = world.monitor()["stages"]
        return {stages[name]["state"] for name in ("capture", "track")}

    finger.touch(offer, "look", "mouse")
    world.wait_for(lambda: _source(world) == "mouse", "the mouse as the viewer")
    world.wait_for(lambda: states() == {"FINISHED"}, "no camera and no tracking")
    left, top, width, height = finger.place
    columns = set()
    for x in (left + 5, left + width - 5):
        world.xdotool("mousemove", x, top + height // 2)
        world.more_pictures(30)
        columns.add(world.lines()[-1]["view"]["left"][1])
    assert len(columns) == 2, "the mouse looks around"
    world.xdotool("key", "v", "Right", "Return")  # from the mouse to the recorded face
    world.wait_for(lambda: _source(world) == "demo", "the recorded face")
    world.wait_for(
        lambda: states() == {"RUNNING"} and world.monitor()["stages"]["track"]["face"], "its eyes"
    )
    world.xdotool("key", "q")
    world.ended(process)


def test_viewer_is_exchanged_where_it_can_be(world: World, scene: Path) -> None:
    world.shows(scene)
    missing = str(world.root / "missing.mkv")
    for source, why in ((missing, missing), (3, "viewer needs")):
        with pytest.raises(UserError, match=why):
            world.ask(cmd="viewer", source=source)
    assert _source(world) == "demo"
    grey = world.root / "nobody.avi"
    writer = cv2.VideoWriter(str(grey), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (320, 240))
    for _ in range(30):
        writer.write(np.full((240, 320, 3), 90, np.uint8))
    writer.release()
    assert world.ask(cmd="viewer", source=f"file:{grey}?loop=1")["ok"]
    world.wait_for(lambda: not world.monitor()["stages"]["track"]["face"], "no face")
