"""The closed loop: the real window on an X server, a camera that sees that screen, and the written
result.
"""

import json
import re
import tomllib
from pathlib import Path

import pytest

from tests.display.screen_camera import Optics, stamp_offset_ms
from tests.support.world import World
from tests.support.xvfb_screen import Screen

SMALL = ("--set", "camera.width_px=160", "--set", "camera.height_px=120")


def calibrated(world: World, screen: Screen, node: Path, **optics: object) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a calibration with that camera."""
    node.write_text(json.dumps({"buffer": str(screen.buffer), **optics}))
    world.module = "tests.display.screen_camera"
    world.env["DISPLAY"] = screen.name
    process = world.start("calibrate", "--latency", "--camera", f"camera:{node}", *SMALL)
    out, err = process.communicate(timeout=100)
    return process.returncode, out, err


@pytest.mark.alone
@pytest.mark.native("Video4Linux")
def test_calibrate_latency_finds_a_made_delay(world: World, screen: Screen, tmp_path: Path) -> None:
    node = tmp_path / "video0"
    optics = {"screen_ms": 25.0, "camera_ms": 30.0, "exposure_ms": 12.0}
    code, out, err = calibrated(world, screen, node, **optics)
    assert code == 0, err
    truth_ms = optics["screen_ms"] + stamp_offset_ms(Optics("", **optics))
    written = tomllib.loads((world.root / "settings" / "lfpipe" / "config.toml").read_text())[
        "render"
    ]
    low_ms, high_ms = map(float, re.findall(r"90 %: ([\d.]+) to ([\d.]+) ms", out)[0])
    assert (
        abs(written["device_latency_ms"] - truth_ms) < 4.0  # a quarter of a refresh
        and low_ms < written["device_latency_ms"] < high_ms
    ), (
        out,
        truth_ms,
    )
    assert (
        str(node) in written["device_latency_measured"]
        and "160x120" in written["device_latency_measured"]
    )
    assert "90 %" in out and "next session" in out


def test_calibrate_latency_refuses_a_source_without_stamps(world: World, screen: Screen) -> None:
    world.env["DISPLAY"] = screen.name
    refused = world.refused("calibrate", "--latency", "--camera", "demo")
    assert "does not stamp" in refused and "remedy" in refused
    del world.env["DISPLAY"]
    assert "needs a screen" in world.refused("calibrate", "--latency", "--camera", "demo")
    assert not (world.root / "settings" / "lfpipe").exists()
