"""The window by touch alone: every page and the test of the glasses close by their cross and by
another entry of the bar; a recording is shown as long as it runs.
"""

import tomllib

from lfpipe.config import Render
from lfpipe.render.display.display import Overlay
from lfpipe.render.display.window import TEXT_PX
from lfpipe.render.display.window_system import pygame
from lfpipe.render.ui.keys import HELP
from lfpipe.render.ui.look import RED
from lfpipe.render.ui.overlay_view import ItemPanel, menu_panel, text_panel, top_px
from lfpipe.render.ui.pages import glasses_menu, instructions
from tests.support.finger import Finger
from tests.support.world import World, write_scene
from tests.support.xvfb_screen import Screen, needs_xdotool, outline

HINTS = "(h shows the keys, g tests your glasses)"


@needs_xdotool
def test_touch_closes_pages_by_their_cross_and_by_another_entry(
    world: World, screen: Screen
) -> None:
    world.env["DISPLAY"] = screen.name
    pygame.font.init()
    # its views are dark: white is in panels alone
    scene = write_scene(world.root / "grid", 3, 3)
    process = world.start("up", scene, "--camera", "demo", "--session", world.name)
    finger = Finger(world, screen, f"lfpipe: grid {HINTS}")
    world.wait_for(lambda: outline(finger.title, screen.name), "window")
    width, height = finger.size_px
    area = width, finger.bar().at[1]
    question = menu_panel(glasses_menu("dubois"), 0, area, TEXT_PX)
    test = text_panel(instructions(Render()), area[1], (width, height), TEXT_PX)
    keys = Overlay(title="Keys and mouse", lines=HELP)
    help_page = text_panel(keys, area[1], (width, height), TEXT_PX, top_px(TEXT_PX))

    def comes(panel: ItemPanel) -> None:
        world.wait_for(lambda: finger.dark(panel), "the panel")

    def goes(panel: ItemPanel) -> None:
        world.wait_for(lambda: not finger.dark(panel), "the picture alone")

    comes(question)
    finger.touch(question, "wear", "dubois")
    settings = world.root / "settings" / "lfpipe" / "config.toml"
    world.wait_for(lambda: settings.exists() and "dubois" in settings.read_text(), "an answer")
    comes(test)
    finger.touch(test, "swap")
    world.wait_for(lambda: world.monitor()["config"]["render"]["swap_eyes"], "eyes swapped")
    finger.touch(test, "close")
    world.wait_for(
        lambda: tomllib.loads(settings.read_text())["render"].get("swap_eyes"), "changes kept"
    )
    goes(help_page)
    for event, panel in (("help", help_page), ("which", question)):
        finger.use_bar(event)
        comes(panel)
        finger.touch(panel, "close")
        goes(panel)
        finger.use_bar(event)
        comes(panel)
        finger.use_bar("recentre")
        goes(panel)
    for paused in (False, True):
        finger.use_bar("freeze", paused=paused)
        world.wait_for(lambda paused=paused: world.monitor()["paused"] is not paused, "a pause")
    finger.use_bar("record")

    def red() -> bool:
        return bool((screen.picture()[:400] == RED[::-1]).all(axis=-1).any())

    world.wait_for(red, "a red dot")
    world.wait_for(
        lambda: [file for file in world.root.rglob("frames.bin") if file.stat().st_size], "frames"
    )
    finger.use_bar("record", recording=True)
    world.wait_for(lambda: not red(), "no red dot")
    world.xdotool("key", "q")
    assert "the window was closed" in world.ended(process)
    (recorded,) = world.root.rglob("lfpipe-recording-*")
    assert (recorded / "manifest.json").exists()
