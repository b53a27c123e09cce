"""The page of `lfpipe monitor --web`: in a real browser on a real session."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.extras.web.server import Server
from tests.support.browser import Browser, missing
from tests.support.world import World, until


@pytest.mark.nightly
def test_page_picture_is_lent_at_full_chroma_and_taken_back(
    live: World, live_server: Server
) -> None:
    assert live.segments("pictures") == [], "nobody asks, no ring"
    jpeg = live_server.jpeg("picture")
    assert len(live.segments("pictures")) == 1
    picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None and picture.shape == (48, 64, 3)
    reds = [8 * (3 * row + col) + 5 for row in range(3) for col in range(3)]
    assert min(abs(int(picture[20, 30, 2]) - red) for red in reds) <= 3, (
        "the red plane of a view that is stored"
    )
    assert jpeg[jpeg.index(b"\xff\xc0") + 11] == 0x11, (
        "4:4:4: the first component is sampled as the others"
    )
    camera = live_server.picture("camera")
    assert camera.shape == (240, 320, 3) and camera.std() > 20
    until(lambda: live.segments("pictures") == [], "ring taken back when nobody asks")
    live.more_pictures(5)

    def spread() -> float:
        return float(np.ptp(live_server.picture().reshape(-1, 3).mean(axis=0)))

    for anaglyph, alpha_px in (("grey", 1000.0), ("colour", 12.0)):
        sets = {"render.anaglyph": anaglyph, "render.alpha_px": alpha_px}
        status, data = live_server.ask("POST", "/ctl", {"cmd": "set", "set": sets})
        assert status == 200 and json.loads(data)["ok"] is True
        until(
            lambda wanted=anaglyph: spread() < 4 if wanted == "grey" else spread() > 8,
            f"{anaglyph} picture",
        )


@pytest.mark.nightly
def test_page_in_a_browser_moves_charts_and_takes_controls(
    world: World, scene: Path, server: Server, tmp_path: Path
) -> None:
    if why := missing():
        pytest.skip(why)
    # nearest views of a busy machine seldom change
    world.shows(scene, "--set=governor.quality=fixed")
    with Browser(tmp_path / "profile") as browser:
        browser.open(server.url)
        until(
            lambda: browser.ask(
                "window.lfpipe.latency && window.lfpipe.latency.data[0].length > 4"
            ),
            "moving chart",
        )
        assert (
            browser.ask("Object.keys(window.lfpipe.last.stages).join()") == "capture,track,render"
        )
        assert browser.ask("document.getElementById('scenes').offsetParent === null"), (
            "one scene is no list"
        )
        assert "viewer " in until(
            lambda: browser.ask("document.getElementById('state').textContent"), "state"
        )
        until(
            lambda: browser.ask("document.getElementById('picture').naturalWidth") == 64, "picture"
        )
        until(
            lambda: browser.ask("document.getElementById('camera').naturalWidth") == 320, "camera"
        )
        assert browser.ask("document.getElementById('anaglyph').value") == "dubois"

        def turn(name: str, value: object, event: str) -> None:
            control = f"document.getElementById('{name}')"
            browser.ask(
                f"(() => {{ {control}.value = '{value}'; {control}.dispatchEvent(new"
                f" Event('{event}')); }})()"
            )

        wear = "document.getElementById('wear')"
        assert browser.ask(f"{wear}.textContent") == "Put on red/cyan glasses, red on the left."
        turn("anaglyph", "mono", "change")
        until(lambda: browser.ask(f"{wear}.hidden"), "nothing to put on")
        assert world.monitor()["config"]["render"]["anaglyph"] == "mono"
        before = len(world.lines())
        turn("zero", 1.5, "input")
        until(
            lambda: browser.ask("window.lfpipe.last.config.render.zero_plane_px") == 1.5,
            "moved zero plane",
        )
        browser.click("#pause")
        until(lambda: browser.ask("window.lfpipe.last.paused"), "pause")
        browser.click("#pause")
        until(lambda: browser.ask("!window.lfpipe.last.paused"), "going on")
        for hidden in (False, True):
            browser.click("#record")
            until(
                lambda hidden=hidden: browser.ask(
                    "document.getElementById('recording').hidden === "
                    f"{json.dumps(hidden)} && document.getElementById('record').ariaBusy"
                    " === 'false'"
                ),
                "dot of a recording, and its end",
            )
        browser.click("#recentre")
        world.pictures(before + 10)
        world.ctl("stop")
        until(
            lambda: "no session" in browser.ask("document.getElementById('state').textContent"),
            "word of the end",
        )
        world.wait_for(lambda: not world.left(), "clean end")
        world.trace.unlink()
        world.up(scene)
        until(
            lambda: browser.ask("window.lfpipe.last && window.lfpipe.last.alive"),
            "session that returned",
        )
        assert server.ask("POST", "/ctl", {"cmd": "recentre"})[0] == 200
