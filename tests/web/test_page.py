"""The page of `lfpipe monitor --web`: in a real browser on a real session, and its door."""

from __future__ import annotations

import http.client
import json
import re
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from lfpipe.observe.guard import own_page, owner
from lfpipe.render.view_grid import Gaze, draw_over_eyes, inset
from tests.web.browser import Browser, missing
from tests.world import World


def served(world: World) -> Iterator[int]:
    """Serves the page of the world's session; gives the port."""
    server = world.start("monitor", "--session", world.name, "--web", "--port", "0", stderr=subprocess.STDOUT)
    assert server.stdout is not None
    said = server.stdout.readline()
    found = re.search(r"http://127\.0\.0\.1:(\d+)/", said)
    assert found is not None, said
    yield int(found[1])
    server.terminate()
    server.communicate(timeout=10)


@pytest.fixture
def port(world: World) -> Iterator[int]:
    yield from served(world)


@pytest.fixture(scope="module")
def live_port(live: World) -> Iterator[int]:
    yield from served(live)


def ask(port: int, method: str, path: str, body: Any = None, **headers: str) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    kind = {"Content-Type": "application/json"} if body is not None else {}
    connection.request(method, path, None if body is None else json.dumps(body), {**kind, **headers})
    answer = connection.getresponse()
    data = answer.read()
    connection.close()
    return answer.status, data


def rings(world: World) -> list[str]:
    return world.segments("pictures")


def until(condition: Callable[[], Any], what: str, timeout_s: float = 20) -> Any:
    end = time.monotonic() + timeout_s
    while time.monotonic() < end:
        if found := condition():
            return found
        time.sleep(0.1)
    raise AssertionError(f"no {what} within {timeout_s} s")


def test_the_picture_is_lent_at_full_chroma_and_taken_back(live: World, live_port: int) -> None:
    world, port = live, live_port
    assert rings(world) == [], "nobody asks, no ring"
    until(lambda: ask(port, "GET", "/picture.jpg")[0] == 200, "picture")
    assert len(rings(world)) == 1
    picture = cv2.imdecode(np.frombuffer(ask(port, "GET", "/picture.jpg")[1], np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (48, 64, 3)
    shown = [set(8 * (3 * row + col) + 5 for col in range(3)) for row in range(3)]
    assert min(abs(int(picture[20, 30, 2]) - red) for red in set().union(*shown)) <= 3, "the red plane of a view that is stored"
    data = ask(port, "GET", "/picture.jpg")[1]
    start = data.index(b"\xff\xc0")
    assert data[start + 11] == 0x11, "4:4:4: the first component is sampled as the others"
    camera = cv2.imdecode(np.frombuffer(ask(port, "GET", "/camera.jpg")[1], np.uint8), cv2.IMREAD_COLOR)
    assert camera.shape == (240, 320, 3) and camera.std() > 20
    until(lambda: rings(world) == [], "ring taken back when nobody asks")
    world.pictures(len(world.lines()) + 5)


def test_in_a_browser_charts_move_and_controls_work(world: World, scene: Path, port: int, tmp_path: Path) -> None:
    if why := missing():
        pytest.skip(why)
    world.up(scene)
    world.pictures(5)
    with Browser(tmp_path / "profile") as browser:
        browser.open(f"http://127.0.0.1:{port}/")
        until(lambda: browser.ask("window.lfpipe.latency && window.lfpipe.latency.data[0].length > 4"), "moving chart")
        assert browser.ask("Object.keys(window.lfpipe.hists).join()") == "capture,track,render"
        assert browser.ask("window.lfpipe.hists.track.data[1].reduce((a, b) => a + b)") > 10
        assert "viewer " in until(lambda: browser.ask("document.getElementById('state').textContent"), "state")
        until(lambda: browser.ask("document.getElementById('picture').naturalWidth") == 64, "picture")
        until(lambda: browser.ask("document.getElementById('camera').naturalWidth") == 320, "camera")
        assert browser.ask("document.getElementById('anaglyph').value") == "dubois"
        colours = """(() => { const c = document.createElement('canvas'), i = document.getElementById('picture');
            c.width = i.naturalWidth; c.height = i.naturalHeight; const d = c.getContext('2d'); d.drawImage(i, 0, 0);
            const p = d.getImageData(32, 24, 1, 1).data; return Math.max(p[0], p[1], p[2]) - Math.min(p[0], p[1], p[2]); })()"""
        until(lambda: browser.ask(colours) > 4, "coloured picture")

        def turn(name: str, value: object, event: str) -> None:
            control = f"document.getElementById('{name}')"
            browser.ask(f"(() => {{ {control}.value = '{value}'; {control}.dispatchEvent(new Event('{event}')); }})()")

        turn("anaglyph", "mono", "change")
        until(lambda: world.run("ctl", "--session", world.name, "--json", "status").stdout.count('"mono"'), "other mode")
        before = len(world.lines())
        turn("zero", 1.5, "input")
        until(lambda: browser.ask("window.lfpipe.last.config.render.zero_plane_px") == 1.5, "moved zero plane")
        browser.click("#pause")
        until(lambda: browser.ask("window.lfpipe.last.paused"), "pause")
        browser.click("#pause")
        until(lambda: browser.ask("!window.lfpipe.last.paused"), "going on")
        browser.click("#recentre")
        world.pictures(before + 10)
        world.run("ctl", "--session", world.name, "stop")
        until(lambda: "no session" in browser.ask("document.getElementById('state').textContent"), "word of the end")


def test_a_control_changes_the_picture_that_is_served(live_port: int) -> None:
    port = live_port
    until(lambda: ask(port, "GET", "/picture.jpg")[0] == 200, "picture")

    def spread() -> float:
        picture = cv2.imdecode(np.frombuffer(ask(port, "GET", "/picture.jpg")[1], np.uint8), cv2.IMREAD_COLOR)
        return float(np.ptp(picture.reshape(-1, 3).mean(axis=0)))

    status, data = ask(port, "POST", "/ctl", {"cmd": "set", "set": {"render.anaglyph": "grey", "render.alpha_px": 1000.0}})
    assert status == 200 and json.loads(data)["applied"] is True
    until(lambda: spread() < 4, "grey picture: both eyes see the middle view")
    assert ask(port, "POST", "/ctl", {"cmd": "set", "set": {"render.anaglyph": "colour", "render.alpha_px": 12.0}})[0] == 200
    until(lambda: spread() > 8, "picture in colour")


def test_the_door(world: World, port: int) -> None:
    assert ask(port, "GET", "/picture.jpg")[0] == 503, "no session yet"
    assert ask(port, "GET", "/")[0] == 200 and ask(port, "GET", "/../guard.py")[0] == 404
    assert ask(port, "GET", "/", Host="example.org")[0] == 403, "a name that was pointed here"
    assert ask(port, "POST", "/ctl", {"cmd": "pause"}, Origin="http://example.org")[0] == 403, "another site in the browser"
    for body in ({"cmd": "stop"}, {"cmd": "load", "scene": "/"}, [], "x", {"cmd": ["set"]}):
        assert ask(port, "POST", "/ctl", body)[0] == 400
    assert ask(port, "POST", "/ctl", {"cmd": "set", "x": "y" * 5000})[0] == 413
    assert ask(port, "POST", "/ctl", {"cmd": "pause"}, **{"Content-Type": "text/plain"})[0] == 400
    answer = json.loads(ask(port, "POST", "/ctl", {"cmd": "pause"})[1])
    assert answer["ok"] is False and "no session" in answer["error"]
    busy = world.run("monitor", "--web", "--port", str(port))
    assert busy.returncode == 2 and "another --port" in busy.stderr


def test_the_owner_of_a_connection_comes_from_the_kernel() -> None:
    head = "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode\n"
    line = "   0: 0100007F:1F90 0100007F:C001 01 00000000:00000000 00:00000000 00000000  1234        0 99\n"
    assert owner(("127.0.0.1", 8080), head + line) == 1234
    assert owner(("127.0.0.1", 8081), head + line) is None
    assert owner(("127.0.0.1", 8080), head + line.replace(" 01 ", " 0A ")) is None, "a listener is no peer"
    assert own_page("localhost:80", None, 80) and own_page("127.0.0.1:80", "http://localhost:80", 80)
    assert not own_page("127.0.0.1:81", None, 80) and not own_page("", None, 80)
    assert not own_page("127.0.0.1:80", "null", 80) and not own_page("127.0.0.1:80", "https://127.0.0.1:80", 80)


def test_the_grid_is_where_the_mapping_says() -> None:
    from lfpipe.config import Render
    from lfpipe.render.viewpoint import Mapper

    mapper = Mapper(5, 7, Render(), 20.0, (300.0, 220.0))
    gaze = Gaze(5, 7, 20.0, (300.0, 220.0), ((310.0, 230.0), (270.0, 230.0)), ((2.5, 2.5), (2.5, 4.5)), True)
    for row, col in ((0, 0), (4, 6), (2, 3), (1, 5)):
        place = gaze.place_px(row, col)
        assert mapper.views([place, place])[0] == pytest.approx((row, col))
    picture = np.zeros((480, 640, 3), np.uint8)
    draw_over_eyes(picture, gaze)
    x, y = gaze.place_px(4, 6)
    assert (picture[round(y), round(x)] > 200).all()
    left, right = picture[230, 310], picture[230, 270]
    assert left[2] > 200 > 100 > left[0] and right[0] > 200 > 100 > right[2], "left eye red, right eye cyan"
    small = inset(gaze, 120)
    assert small.shape[1] == 120 and (small[:, :, 0] == small[:, :, 2]).all(), "white: the same behind both glasses"
