"""Choice of the monitor, pixel sizes, windows on an X server with two monitors and on a desktop
that scales; and reasons to distrust a delay of the loop that was measured on another.
"""

import shutil
from contextlib import closing
from typing import Any

import attrs
import numpy as np
import pygame
import pytest

from lfpipe import config
from lfpipe.render.display.window import ScreenWindow
from lfpipe.render.display.window_system import (
    Monitor,
    device_latency_conditions,
    device_latency_doubt,
    monitors,
    pixel_mm,
)
from tests.support.sway_screen import sway

DESK = [
    Monitor(number=0, name="eDP-1", x=0, y=0, width=1920, height=1200, pixel_mm=0.18, rate_hz=60.0),
    Monitor(
        number=1,
        name="DP-1; 24",
        x=1920,
        y=0,
        width=1920,
        height=1080,
        pixel_mm=None,
        rate_hz=144.0,
    ),
    Monitor(number=2, name='DP-2 27"', x=3840, y=0, width=2560, height=1440, pixel_mm=0.23),
]


@pytest.mark.parametrize(
    ("dpi", "size_mm"),
    [
        ((96.0, 96.0), 508 / 1920),
        ((0.0, 0.0), None),
        ((1920 * 25.4 / 160, 1080 * 25.4 / 90), None),  # 160 x 90 mm is an aspect, no size
        ((96.0, 150.0), None),
        ((1920 * 25.4 / 1600, 1080 * 25.4 / 900), None),
        ((1920 * 25.4 / 60, 1080 * 25.4 / 33.75), None),  # 0.03 mm a pixel: finer than any
        ((1920 * 25.4 / 4000, 1080 * 25.4 / 2250), None),  # 2 mm: a projector's picture
        ((1920 * 25.4 / 640, 1080 * 25.4 / 480), None),  # 4:3 in mm, 16:9 in pixels
    ],
)
def test_pixel_mm_does_not_believe_sizes_that_cannot_be(
    dpi: tuple[float, float], size_mm: float | None
) -> None:
    assert pixel_mm(dpi, 1920) == (None if size_mm is None else pytest.approx(size_mm))


@pytest.mark.skipif(
    shutil.which("sway") is None, reason="sway is not installed (apt-get install sway)"
)
def test_screen_window_on_a_scaled_desktop_has_the_screens_pixels(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # as the tests on X have set it
    monkeypatch.delenv("SDL_FRAMEBUFFER_ACCELERATION", raising=False)
    with sway(1280, 800, 60, scale=2) as name:
        monkeypatch.setenv("WAYLAND_DISPLAY", name)
        monkeypatch.setenv("SDL_VIDEODRIVER", "wayland")
        with closing(ScreenWindow((500, 400), "lfpipe: a test")) as window:
            window.show(np.full((400, 500, 3), 90, np.uint8))
            share = window.width_mm() / 530  # type: ignore[operator]
            assert monitors()[0].width == 640 < window._shown_px and share == pytest.approx(
                window._shown_px / 1280, rel=0.01
            )
            assert not window.knows_rows
            pygame.event.post(pygame.event.Event(pygame.KEYDOWN, unicode="f", key=0))
            assert [event.name for event in window.events()] == ["fullscreen"]
            assert window.knows_rows, "in full screen"


CAMERA = "HD Webcam; C920"


def measured(camera: str = CAMERA, **changes: object) -> config.Config:
    """A configuration in which the loop was measured on the second monitor; then something
    changed.
    """
    here = f"2026-11-21; {device_latency_conditions(camera, config.Camera(), DESK[1])}"
    sets = {"render.device_latency_ms": 61.5, "render.device_latency_measured": here}
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
        (CAMERA, {"render.device_latency_measured": ""}, DESK, "set by hand"),
    ],
)
def test_device_latency_doubt_names_the_change(
    camera: str, changes: dict[str, Any], desk: list[Monitor], named: str
) -> None:
    doubt = device_latency_doubt(measured(**changes), camera, desk)
    assert named in doubt if named else not doubt


def test_a_window_whose_monitors_are_all_gone_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """A KVM switch, or a docking station: there was an IndexError."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with closing(ScreenWindow((64, 48), "lfpipe: a test")) as window:
        before = window.monitor
        monkeypatch.setattr("lfpipe.render.display.window.monitors", list)
        pygame.event.post(pygame.Event(pygame.WINDOWDISPLAYCHANGED))
        window.events()
        assert window.monitor == before
