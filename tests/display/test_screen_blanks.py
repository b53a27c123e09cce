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
picture, answers = np.zeros((64, 64, 3), np.uint8), []
for k in range(61):
    picture[:] = k % 200
    if k < 60:
        window.show(picture)
    time.sleep(0.004 if k < 60 else 0.1)
    window.events()
    answers += [(p.serial, p.t_ns) for p in window.presented()]
print(json.dumps([window.blanks_by, window.nominal_hz(), type(window._painter).__name__, answers]))
window.close()
"""


@pytest.fixture(scope="module")
def wayland() -> Iterator[str]:
    if shutil.which("sway") is None:
        pytest.skip("sway is not installed (apt-get install sway)")
    with sway(1280, 800, 75) as name:
        yield name


def shown(env: dict[str, str]) -> tuple[str, float, str, np.ndarray]:
    """Protocol, rate and painter of a window, and the times at which it showed pictures: each is answered."""
    done = subprocess.run([sys.executable, "-c", SHOW], env=env, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stderr) == (0, "")
    protocol, rate_hz, painter, answers = json.loads(done.stdout.splitlines()[-1])
    serials, times_ns = np.array(answers).T
    assert len(set(serials.tolist())) >= 58
    times_ns = times_ns[times_ns > 0]
    assert len(times_ns) > 5 and (np.diff(times_ns) > 0).all(), "no two pictures at one blank"
    return protocol, rate_hz, painter, times_ns


def test_wayland_presents_through_the_renderer_and_reports_each_picture(wayland: str) -> None:
    env = os.environ | {"WAYLAND_DISPLAY": wayland, "SDL_VIDEODRIVER": "wayland"}
    env.pop("DISPLAY", None)
    protocol, rate_hz, painter, _ = shown(env)
    assert painter == "RendererPainter" and rate_hz == 75
    assert protocol in ("wp_presentation", "wl_surface.frame"), "which of them depends on the version of wlroots"


def test_x_reports_blanks_by_present(screen: Screen) -> None:
    protocol, _, _, times_ns = shown(os.environ | {"DISPLAY": screen.name})
    steps = np.diff(times_ns) / (1e9 / 60)
    assert protocol == "x_present" and np.median(np.abs(steps - np.round(steps))) < 0.15, "on a grid of 60 Hz"


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
