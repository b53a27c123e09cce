"""Real windows on real servers: the protocol that reports blanks, their grid, and the trace."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.sway_screen import sway
from tests.world import World
from tests.xvfb_screen import Screen

SHOW = """
import json, sys, time
import numpy as np
from lfpipe.render.window import Window
window = Window((64, 64), "a test")
picture, found = np.zeros((64, 64, 3), np.uint8), []
for k in range(int(sys.argv[1])):
    picture[:] = k % 200
    handed = window.show(picture)
    time.sleep(0.004)
    window.events()
    found += [(p.serial, p.t_ns, handed) for p in window.presented()]
time.sleep(0.1)
window.events()
found += [(p.serial, p.t_ns, handed) for p in window.presented()]
print(json.dumps({"by": window.blanks_by, "hz": window.nominal_hz(), "painter": type(window._painter).__name__, "found": found}))
window.close()
"""


@pytest.fixture(scope="module")
def wayland() -> Iterator[str]:
    if shutil.which("sway") is None:
        pytest.skip("sway is not installed (apt-get install sway)")
    with sway(1280, 800, 75) as name:
        yield name


def shown(env: dict[str, str], count: int) -> dict[str, object]:
    done = subprocess.run([sys.executable, "-c", SHOW, str(count)], env=env, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return dict(json.loads(done.stdout.splitlines()[-1]))


def check(report: dict[str, object], count: int) -> np.ndarray:
    """Every picture is answered once, in order; the times of those that were shown."""
    found = np.array(report["found"])
    assert found[:, 0].tolist() == list(range(found[0, 0], count + 1)) or len(set(found[:, 0].tolist())) >= count - 2
    times = found[found[:, 1] > 0][:, 1]
    assert len(times) > 5 and (np.diff(times) > 0).all(), "no two pictures at one blank"
    return times


def test_wayland_presents_through_the_renderer_and_reports_each_picture(wayland: str) -> None:
    env = os.environ | {"WAYLAND_DISPLAY": wayland, "SDL_VIDEODRIVER": "wayland"}
    env.pop("DISPLAY", None)
    report = shown(env, 60)
    assert report["painter"] == "RendererPainter" and report["hz"] == 75
    assert report["by"] in ("wp_presentation", "wl_surface.frame"), "which of them depends on the version of wlroots"
    check(report, 60)


def test_x_reports_blanks_by_present(screen: Screen) -> None:
    report = shown(os.environ | {"DISPLAY": screen.name}, 60)
    assert report["by"] == "x_present"
    times = check(report, 60)
    steps = np.diff(times) / (1e9 / 60)
    assert np.median(np.abs(steps - np.round(steps))) < 0.15, "on a grid of 60 Hz"


@pytest.mark.parametrize("system", ["x", "wayland"])
def test_a_session_names_who_tells_when_its_pictures_were_shown(
    system: str, world: World, scene: Path, request: pytest.FixtureRequest
) -> None:
    if system == "x":
        world.env["DISPLAY"], by = request.getfixturevalue("screen").name, {"x_present", "handover", "replaced"}
    else:
        world.env |= {"WAYLAND_DISPLAY": request.getfixturevalue("wayland"), "SDL_VIDEODRIVER": "wayland"}
        by = {"wp_presentation", "wl_surface.frame", "handover", "replaced"}
    world.start("up", scene, "--camera", "demo", "--trace", world.trace, "--session", world.name, "--display", "window")
    world.pictures(60)
    lines = world.lines()
    named = [line["presented_by"] for line in lines]
    assert set(named) <= by and named.count("handover") < len(named) / 2
    assert [line["seq"] for line in lines] == list(range(lines[0]["seq"], lines[0]["seq"] + len(lines))), "in their order"
    seen = [line for line in lines if line["composed"] and line["presented_by"] != "replaced"]
    assert all(line["t_presented_ns"] >= line["t_composed_ns"] - 20e6 for line in seen)
    assert not any(line["t_presented_ns"] for line in lines if line["presented_by"] == "replaced")
    state = json.loads(world.run("monitor", "--once", "--json", "--session", world.name).stdout)
    assert state["judder"]["planned"] > 0 and 0 <= state["judder"]["percent"] <= 100
    assert world.run("ctl", "--session", world.name, "stop").returncode == 0
