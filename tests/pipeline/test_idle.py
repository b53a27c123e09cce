"""A session does little while nothing changes, and reacts at once when something does."""

import itertools
from pathlib import Path

import pytest

from tests.support.world import World
from tests.support.xvfb_screen import Screen, needs_xdotool


def idle(world: World) -> bool:
    return bool(world.ask(cmd="hello")["options"]["idle"])


def rests(world: World) -> bool:
    return bool(world.monitor()["stages"]["render"]["metrics"]["resting"])


@pytest.mark.live
@needs_xdotool
def test_window_rests_while_the_mouse_stands_still(
    world: World, scene: Path, screen: Screen
) -> None:
    world.env["DISPLAY"] = screen.name
    world.start("up", scene, "--camera", "mouse", "--session", world.name)
    world.wait_for(lambda: world.left() and idle(world), "an idle session")
    before = world.monitor()["stages"]["render"]
    assert rests(world)
    world.xdotool("mousemove", 400, 300)
    world.xdotool("mousemove", 700, 400)  # wherever the pointer was, it has moved now
    moved = world.wait_for(
        lambda: (now := world.monitor()["stages"]["render"])["count"] > before["count"] and now,
        "a picture",
    )
    assert moved["missed"] <= before["missed"] + 2, "dozens of refreshes needed no picture"

    def works() -> bool:
        """While the mouse moves: the supervisor looks once a second."""
        world.xdotool("mousemove", *next(places))
        return not idle(world)

    places = itertools.cycle([(400, 300), (700, 400)])  # in the window
    world.wait_for(works, "a session at work")
