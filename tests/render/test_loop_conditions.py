"""Reasons to distrust the measured delay of the loop, in words."""

import attrs
import pytest

from lfpipe import config
from lfpipe.cli.startup_summary import loop_lines
from lfpipe.render.monitors import Monitor, loop_conditions, loop_doubt

DESK = [Monitor(0, "eDP-1", 0, 0, 1920, 1200, 0.18, 60.0), Monitor(1, "DP-1; 24", 1920, 0, 1920, 1080, None, 144.0)]
CAMERA = "HD Webcam; C920"


def measured(**changes: object) -> config.Config:
    """A configuration in which the loop was measured on the second monitor; then something changed."""
    here = loop_conditions("2026-11-21", CAMERA, config.Camera(), DESK[1])
    sets = {"render.loop_ms": 61.5, "render.loop_measured": here}
    return config.updated(config.updated(config.Config(), sets), changes)


@pytest.mark.parametrize(
    ("camera", "changes", "desk", "said"),
    [
        (CAMERA, {}, DESK, ""),
        (CAMERA, {"screen.monitor": 1}, DESK, ""),
        ("another", {}, DESK, "the camera is another, not HD Webcam, C920"),
        (CAMERA, {"camera.format": "MJPG"}, DESK, "its mode is 640x480 MJPG 30 Hz, not 640x480 auto 30 Hz"),
        (CAMERA, {"camera.rate_hz": 60}, DESK, "60 Hz, not"),
        (CAMERA, {"screen.monitor": "eDP"}, DESK, "the monitor is eDP-1, not DP-1, 24"),
        (CAMERA, {}, DESK[:1], "the monitor is eDP-1"),
        (CAMERA, {}, [], "the monitor is unknown"),
        (CAMERA, {}, [DESK[0], attrs.evolve(DESK[1], rate_hz=120.0)], "the screen's rate is 120 Hz, not 144 Hz"),
        (CAMERA, {"render.loop_measured": ""}, DESK, "set by hand"),
    ],
)
def test_what_changed_is_said(camera: str, changes: dict[str, object], desk: list[Monitor], said: str) -> None:
    doubt = loop_doubt(measured(**changes), camera, desk)
    assert said in doubt if said else not doubt


def test_up_says_whether_the_delay_is_trusted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfpipe.cli.startup_summary.detect_monitors", lambda: ("x11", DESK))
    here = loop_conditions("2026-11-21", "demo", config.Camera(), DESK[1])
    sets = {"render.loop_ms": 61.5, "render.loop_measured": here}
    known = config.updated(config.Config(), sets)
    assert loop_lines(known, "demo", "window") == ["loop    61.5 ms delay of camera and display"]
    changed = config.updated(known, {"camera.rate_hz": 60})
    (line,) = loop_lines(changed, "demo", "window")
    assert "doubtful: its mode is" in line and "calibrate --latency" in line
    assert loop_lines(changed, "demo", "none") == [] and loop_lines(config.Config(), "demo", "window") == []
