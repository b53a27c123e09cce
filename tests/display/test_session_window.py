"""A whole session in a real window: the picture on the screen comes from the views in the trace."""

import functools
import tomllib
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.scene.made import read
from tests.support.world import World, write_scene
from tests.support.xvfb_screen import Screen, needs_xdotool, outline

PLAIN = (
    "render.method=nearest",
    "render.alpha_px=20",
    "render.anaglyph=colour",
    "render.light=gamma",
    "render.clock=camera",
    "governor.quality=fixed",  # a busy machine would draw otherwise
)
GRID_MIDDLE = [13, 13, 37]  # BGR of the middle view


def expected(line: dict[str, dict[str, list[float]]]) -> list[int]:
    """BGR of the picture, from how `write_scene` colours its views: red of the left one, green and
    blue of the right one.
    """
    (left_row, left_col), (right_row, right_col) = line["view"]["left"], line["view"]["right"]
    return [int(8 * right_row + 5), int(8 * right_col + 5), int(8 * (3 * left_row + left_col) + 5)]


@pytest.mark.everyday
@needs_xdotool
def test_session_window_shows_the_views_of_the_trace(
    world: World, scene: Path, screen: Screen
) -> None:
    world.env["DISPLAY"] = screen.name
    second = write_scene(world.root / "second", 2, 2)
    process = world.shows(scene, second, *(f"--set={text}" for text in PLAIN), display="window")
    press = functools.partial(world.xdotool, "key")
    press("y")  # takes the hint away, which else goes by itself
    for _ in range(10):
        world.ask(cmd="pause")
        world.wait_for(
            lambda: _steady(world, screen) == expected(world.lines()[-1]),
            "the picture that the trace names",
        )
        line = world.lines()[-1]
        if line["view"]["left"] != line["view"]["right"]:
            break
        world.ask(cmd="resume")  # both eyes beyond the edge see the same view
    else:
        pytest.fail("the eyes see the same view: this test shows nothing")
    _exchange_near_and_far(world, screen, functools.partial(press, "d"))
    world.ask(cmd="resume")
    for key, changed in (("plus", 22.0), ("minus", 20.0)):
        press(key)
        world.wait_for(
            lambda changed=changed: world.monitor()["config"]["render"]["alpha_px"] == changed,
            f"alpha of {changed}",
        )
        world.more_pictures(2)  # the next key changes what the window knows
    press("o")
    world.wait_for(
        lambda: bool((screen.picture() == 255).all(axis=-1).any()), "white letters of the overlay"
    )
    press("o", "g", "x", "x", "x", "g")  # faster than each is applied
    kept = world.root / "settings" / "lfpipe" / "config.toml"
    world.wait_for(
        lambda: (
            kept.exists() and tomllib.loads(kept.read_text()) == {"render": {"swap_eyes": True}}
        ),
        "settings kept",
    )
    _choose(world, screen)
    press("q")
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0 and "the window was closed" in err, out
    assert not world.left()


def _exchange_near_and_far(world: World, screen: Screen, press_d: Callable[[], object]) -> None:
    """In a paused session that is resumed for it; the same viewpoints then show the opposite views.

    Back again.
    """
    for word, last in (("yes", 2.0), ("no", 0.0)):
        press_d()
        world.wait_for(
            lambda word=word: world.monitor()["config"]["scene"]["invert_depth"] == word, word
        )
        world.ask(cmd="resume")
        world.more_pictures(2)
        world.ask(cmd="pause")

        def turned(last: float = last) -> list[int]:
            eyes = world.lines()[-1]["view"]
            return expected(
                {"view": {eye: [abs(last - at) for at in place] for eye, place in eyes.items()}}
            )

        world.wait_for(
            lambda turned=turned: _steady(world, screen) == turned(),
            f"the picture with invert_depth={word}",
        )
        assert [
            file.read_text() for file in (world.root / "state" / "lfpipe" / "depth_order").iterdir()
        ] == [word]


def _steady(world: World, screen: Screen) -> list[int] | None:
    """The one colour of the window, once the trace stands still and the window shows one colour
    above "paused".
    """
    before = len(world.lines())
    shown = screen.shown()
    shown = shown[len(shown) // 8 : len(shown) // 2]
    same = (shown == shown[0, 0]).all()
    return np.asarray(shown[0, 0]).tolist() if same and len(world.lines()) == before else None


def _choose(world: World, screen: Screen) -> None:
    """Keys go to the next scene and back.

    Thumbnails appear over the picture; arrow and Enter, or a click, choose one.
    """
    for key, name in (("Page_Down", "second"), ("Page_Up", "grid")):
        world.xdotool("key", key)
        world.wait_for(
            lambda name=name: outline(f"lfpipe: {name}", screen.name), f"the title of {name}"
        )
    second = read(world.root / "second" / "view_01_01.png", cv2.IMREAD_COLOR)[0, 0].tolist()
    world.xdotool("key", "Tab")
    world.wait_for(lambda: _count(screen, GRID_MIDDLE) > 5000, "the thumbnail of the scene shown")
    world.xdotool("key", "Right", "Return")
    world.wait_for(
        lambda: outline("lfpipe: second", screen.name), "the title of the scene that was chosen"
    )
    world.xdotool("key", "Tab")
    world.wait_for(
        lambda: _count(screen, GRID_MIDDLE) > 5000 and _count(screen, second) > 5000,
        "both thumbnails",
    )
    rows, cols = np.nonzero((screen.picture() == GRID_MIDDLE).all(axis=-1))
    # both have this colour; the first one is on the left
    world.xdotool("mousemove", int(cols.min()) + 9, int(rows.mean()), "click", 1)
    world.wait_for(
        lambda: outline("lfpipe: grid", screen.name), "the title of the scene that was clicked"
    )


def _count(screen: Screen, colour: list[int]) -> int:
    """How many pixels of the screen have a BGR colour."""
    return int((screen.picture() == colour).all(axis=-1).sum())


def test_presented_by_names_the_source_of_vblanks(
    world: World, scene: Path, screen: Screen
) -> None:
    world.env["DISPLAY"] = screen.name
    world.shows(scene, display="window", pictures=60)

    def reported() -> list[dict[str, Any]]:
        """The last pictures, once most of them have a report: on a busy machine that takes long."""
        last = world.lines()[-60:]
        handed_over = sum(line["presented_by"] == "handover" for line in last)
        return last if handed_over < len(last) / 2 else []

    lines = world.wait_for(reported, "reports of most pictures")
    assert {line["presented_by"] for line in lines} <= {"x_present", "handover", "replaced"}
    assert all(b["seq"] == a["seq"] + 1 for a, b in pairwise(lines)), "in their order, each of them"
    seen = [line for line in lines if line["composed"] and line["presented_by"] != "replaced"]
    assert all(-20e6 <= line["t_presented_ns"] - line["t_composed_ns"] < 1e9 for line in seen)
    assert not any(line["t_presented_ns"] for line in lines if line["presented_by"] == "replaced")
    vblanks = [line["t_presented_ns"] for line in seen if line["presented_by"] == "x_present"]
    assert all(a < b for a, b in pairwise(vblanks)), "no two pictures at one vblank"
    monitor = world.monitor()
    assert monitor["judder"]["planned"] > 0 and 0 <= monitor["judder"]["percent"] <= 100
