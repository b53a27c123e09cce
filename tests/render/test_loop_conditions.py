"""Reasons to distrust the measured delay of the loop."""

import attrs
import pytest

from lfpipe import config
from lfpipe.cli.launch import loop_lines
from lfpipe.render.monitors import Monitor, loop_conditions, loop_doubt

DESK = [Monitor(0, "eDP-1", 0, 0, 1920, 1200, 0.18, 60.0), Monitor(1, "DP-1; 24", 1920, 0, 1920, 1080, None, 144.0)]
CAMERA = "HD Webcam; C920"


def measured(camera: str = CAMERA, **changes: object) -> config.Config:
    """A configuration in which the loop was measured on the second monitor; then something changed."""
    here = loop_conditions("2026-11-21", camera, config.Camera(), DESK[1])
    sets = {"render.loop_ms": 61.5, "render.loop_measured": here}
    return config.updated(config.updated(config.Config(), sets), changes)


@pytest.mark.parametrize(
    ("camera", "changes", "desk", "named"),
    [
        (CAMERA, {}, DESK, ""),
        (CAMERA, {"screen.monitor": 1}, DESK, ""),
        ("another", {}, DESK, "now it is another"),
        (CAMERA, {"camera.rate_hz": 60}, DESK, "640x480 auto 60 Hz"),
        (CAMERA, {"screen.monitor": "eDP"}, DESK, "eDP-1, 60 Hz"),
        (CAMERA, {}, [], "another monitor"),
        (CAMERA, {}, [DESK[0], attrs.evolve(DESK[1], rate_hz=120.0)], "120 Hz"),
        (CAMERA, {"render.loop_measured": ""}, DESK, "set by hand"),
    ],
)
def test_what_changed_is_named(camera: str, changes: dict[str, object], desk: list[Monitor], named: str) -> None:
    doubt = loop_doubt(measured(**changes), camera, desk)
    assert named in doubt if named else not doubt


def test_up_says_whether_the_delay_is_trusted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfpipe.cli.launch.detect_monitors", lambda: ("x11", DESK))
    known = measured("demo")
    assert loop_lines(known, "demo", "window") == ["loop    61.5 ms delay of camera and display"]
    changed = config.updated(known, {"camera.rate_hz": 60})
    (line,) = loop_lines(changed, "demo", "window")
    assert "doubtful: measured with demo" in line and "calibrate --latency" in line
    assert loop_lines(changed, "demo", "none") == [] and loop_lines(config.Config(), "demo", "window") == []
