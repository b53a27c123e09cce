"""Calibration: the saved settings, and a complete run on the demo's face."""

import json
import shutil
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.config.user_files import write_keys
from lfpipe.errors import UserError
from lfpipe.render.display.overlay import Event
from lfpipe.render.ui.calibration import (
    MEASURED_FRAMES,
    NEAREST_MM,
    SLIDER_MM,
    SPREAD,
    Distance,
    StillEyes,
)
from tests.capture.made_files import video
from tests.support.world import World
from tests.support.xvfb_screen import Screen, outline


@pytest.mark.parametrize(
    "before",
    [
        "",
        "[camera]\nfocal_px = 1.0 # mine\nfov_deg = 60\n",
        "# c\n[camera]\nfov_deg = 60\n[render]\nfocal_px = 9\n",
        "camera = { fov_deg = 60 } # one line\n",
    ],
)
def test_write_keys_changes_one_key_alone(before: str, tmp_path: Path) -> None:
    expected = tomllib.loads(before)
    expected.setdefault("camera", {})["focal_px"] = 612.5
    path = tmp_path / "new" / "config.toml"
    write_keys(path, "camera", {"focal_px": 1.5})
    path.write_text(before)
    write_keys(path, "camera", {"focal_px": 612.5})
    assert tomllib.loads(path.read_text()) == expected and len(list(path.parent.iterdir())) == 1
    comments = [
        [line.partition("#")[2] for line in text.splitlines() if "#" in line]
        for text in (before, path.read_text())
    ]
    assert comments[0] == comments[1]
    for damaged in ("camera = 3\n", "[camera\n"):
        path.write_text(damaged)
        with pytest.raises(UserError, match="focal_px not saved"):
            write_keys(path, "camera", {"focal_px": 612.5})
        assert path.read_text() == damaged


@given(
    st.floats(20, 200),
    st.lists(st.floats(-0.4, 0.4), min_size=MEASURED_FRAMES, max_size=MEASURED_FRAMES),
    st.lists(st.integers(0, 3), min_size=MEASURED_FRAMES, max_size=MEASURED_FRAMES),
)
def test_still_eyes_are_measured_whatever_frames_lack_a_face(
    px: float, noise: list[float], gaps: list[int]
) -> None:
    """noise: in shares of the spread that counts as still. gaps: frames without a face."""
    eyes = StillEyes()
    for at, (share, gap) in enumerate(zip(noise, gaps, strict=True)):
        assert eyes.share == pytest.approx(at / MEASURED_FRAMES)
        for _ in range(gap):
            eyes.add(None)
            assert not eyes.has_face
        eyes.add(px * (1 + share * SPREAD))
        assert eyes.has_face
    assert eyes.share == 1.0 and eyes.restless == 0
    assert eyes.median_px == pytest.approx(px, rel=0.4 * SPREAD)


@given(st.floats(20, 200), st.floats(0.01, 0.2), st.booleans())
def test_moving_eyes_are_not_measured(px: float, step: float, nearer: bool) -> None:
    """step: of a frame, as a share of the distance."""
    eyes = StillEyes()
    for _ in range(2 * MEASURED_FRAMES):
        px *= 1 + step if nearer else 1 / (1 + step)
        eyes.add(px)
        assert eyes.share < 1.0
    assert eyes.seen and eyes.restless == 2 * MEASURED_FRAMES


def test_calibrate_without_a_screen_measures_the_demo(world: World) -> None:
    done = world.done("calibrate", "--camera", "demo", "--distance", "600")
    settings = world.root / "settings" / "lfpipe"
    written = tomllib.loads((settings / "cameras.toml").read_text())["demo"]
    assert (
        300 < written["focal_px"] < 1200
        and str(written["focal_px"]) in done.stdout
        and written["width_px"] == 640
    )
    assert not (settings / "config.toml").exists()
    # the face fills as much as one would at 600 mm
    far = world.refused("calibrate", "--camera", "demo", "--distance", "1600")
    assert "not stored" in far and "measure the distance" in far
    assert tomllib.loads((settings / "cameras.toml").read_text()) == {"demo": written}
    video(world.root / "wall.avi", "MJPG", [np.full((480, 640, 3), 120, np.uint8)] * 30)
    assert "no face was detected" in world.refused("calibrate", "--camera", "file:wall.avi")


def test_focal_length_is_that_of_each_camera(world: World, scene: Path, clip: Path) -> None:
    settings = world.root / "settings" / "lfpipe"
    settings.mkdir(parents=True)
    (settings / "cameras.toml").write_text(
        f'[demo]\nfocal_px = 400\nwidth_px = 320\n["file:{clip}"]\nfocal_px = 5\n'
    )
    world.shows(scene, pictures=3)
    # at 640
    assert json.loads(world.ctl("status", "--json"))["config"]["camera"]["focal_px"] == 800
    world.ctl("stop")
    damaged = world.refused(
        "up", scene, "--camera", f"file:{clip}", "--display", "none", "--duration", "1"
    )
    assert "cameras.toml" in damaged and "width_px" in damaged


FOCAL_PX = 620.0
CARD_AT_MM = 450.0
CARD_PX = (180.0, 337.0)
CARD_MM = (85.60, 53.98)


def held_up(path: Path) -> tuple[float, float]:
    """A video of a card held flat at CARD_AT_MM by a pinhole camera of FOCAL_PX; the card's width
    and height in px.
    """
    fine = 8
    large = np.full((480 * fine, 640 * fine, 3), 90, np.uint8)
    width, height = (size_mm * FOCAL_PX / CARD_AT_MM for size_mm in CARD_MM)
    corner = [round(fine * value) for value in CARD_PX]
    cv2.rectangle(
        large,
        corner,
        [corner[0] + round(fine * width), corner[1] + round(fine * height)],
        (150, 90, 30),
        -1,
    )
    video(path, "MJPG", [cv2.resize(large, (640, 480), interpolation=cv2.INTER_AREA)] * 30)
    return width, height


@pytest.mark.skipif(
    not all(map(shutil.which, ("xdotool", "xwininfo"))), reason="apt-get install xdotool x11-utils"
)
def test_calibrate_by_card_in_a_real_window(world: World, screen: Screen, tmp_path: Path) -> None:
    width_px, height_px = held_up(tmp_path / "card.avi")
    world.env["DISPLAY"] = screen.name
    settings = world.root / "settings" / "lfpipe" / "config.toml"
    settings.parent.mkdir(parents=True)
    settings.write_text(
        '# mine\n[camera]\nrate_hz = 25.0  # slow\nfocal_px = 999.0\n[render]\nmethod = "warp"\n'
    )
    process = world.start(
        "calibrate",
        "--by",
        "card",
        "--camera",
        "file:card.avi?loop=1",
        "--distance",
        str(CARD_AT_MM),
    )
    x0, y0, width, _ = world.wait_for(lambda: outline("lfpipe calibrate", screen.name), "window")
    world.wait_for(lambda: len(screen.shown()), "picture")

    def drawn(*words: object) -> None:
        before = screen.picture()
        world.xdotool(*words)
        world.wait_for(lambda: not np.array_equal(screen.picture(), before), "other picture")

    drawn("key", "Return")
    middle = CARD_PX[1] + height_px / 2
    # two slips, then the edges
    for x, y in ((30, 30), (90, 40), (CARD_PX[0], middle), (CARD_PX[0] + width_px, middle)):
        drawn("mousemove", round(x0 + x * width / 640), round(y0 + y * width / 640), "click", 1)
    world.xdotool("key", "Return")
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    cameras = settings.with_name("cameras.toml")
    measured = tomllib.loads(cameras.read_text())[f"file:{world.root / 'card.avi'}"]
    # a click falls on a pixel
    assert measured == {"focal_px": pytest.approx(FOCAL_PX, rel=0.01), "width_px": 640}
    # without the focal length that was set for every camera
    written = tomllib.loads(settings.read_text())
    assert (
        written == {"camera": {"rate_hz": 25.0}, "render": {"method": "warp"}}
        and "# mine" in settings.read_text()
    )
    assert str(settings) in out and str(cameras) in out


def typed(distance: Distance, *keys: str) -> float:
    for key in keys:
        assert distance.take(Event("type", key))
    return distance.mm


def test_distance_is_typed_stepped_and_slid() -> None:
    distance = Distance("600")
    assert typed(distance, *"750") == 750 and typed(distance, "backspace") == 75
    assert [Distance(text).is_possible for text in ("", "75", "750", "7500")] == [0, 0, 1, 0]
    assert typed(distance, "0") == 750
    distance.take(Event("alpha+"))
    assert distance.mm == 760
    assert typed(distance, *"123456") == 1234, "digits begin a new number, of four at most"
    assert typed(Distance("600"), *["backspace"] * 5) == 0
    for value, mm in zip((0.0, 1.0), SLIDER_MM, strict=True):
        distance.take(Event("distance", value=value))
        assert distance.mm == mm
    for _ in range(1000):
        distance.take(Event("less"))
    assert distance.mm == NEAREST_MM
    assert not distance.take(Event("enter")), "what is not its own is for others"
