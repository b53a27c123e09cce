"""Sessions in real windows on real servers: who reports the blanks, and what the trace
makes of it.
"""

import shutil
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from tests.support.sway_screen import sway
from tests.support.world import World


@pytest.fixture(scope="module")
def wayland() -> Iterator[str]:
    if shutil.which("sway") is None:
        pytest.skip("sway is not installed (apt-get install sway)")
    with sway(1280, 800, 75) as name:
        yield name


@pytest.mark.parametrize("system", ["x", "wayland"])
def test_presented_by_names_who_reports_blanks(
    system: str, world: World, scene: Path, request: pytest.FixtureRequest
) -> None:
    if system == "x":
        world.env["DISPLAY"] = request.getfixturevalue("screen").name
        reporters = {"x_present"}
    else:  # which of them depends on the version of wlroots
        world.env |= {
            "WAYLAND_DISPLAY": request.getfixturevalue("wayland"),
            "SDL_VIDEODRIVER": "wayland",
        }
        reporters = {"wp_presentation", "wl_surface.frame"}
    world.up(scene, display="window")
    lines = world.pictures(60)
    named = [line["presented_by"] for line in lines]
    assert (
        set(named) <= reporters | {"handover", "replaced"}
        and named.count("handover") < len(named) / 2
    )
    assert all(b["seq"] == a["seq"] + 1 for a, b in pairwise(lines)), "in their order, each of them"
    seen = [line for line in lines if line["composed"] and line["presented_by"] != "replaced"]
    assert all(-20e6 <= line["t_presented_ns"] - line["t_composed_ns"] < 1e9 for line in seen)
    assert not any(line["t_presented_ns"] for line in lines if line["presented_by"] == "replaced")
    blanks = [line["t_presented_ns"] for line in seen if line["presented_by"] in reporters]
    assert all(a < b for a, b in pairwise(blanks)), "no two pictures at one blank"
    monitor = world.monitor()
    assert monitor["judder"]["planned"] > 0 and 0 <= monitor["judder"]["percent"] <= 100
