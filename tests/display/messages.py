"""Refusals of displays. The tests of this package run without a screen unless they ask for one."""

import sys
from functools import partial
from pathlib import Path

import pytest

from lfpipe.host.worker import install_command
from lfpipe.render.display.display import check_display, parse_display
from lfpipe.render.display.window_system import Monitor, find_monitor
from tests.test_messages import Cause

FORMS = "use one of window, fullscreen, none or file:OUT.mkv (or .mp4)"
ELSEWHERE = "use --display none or --display file:OUT.mkv, or run on a desktop"
DESK = [
    Monitor(number=0, name="eDP-1", x=0, y=0, width=1920, height=1200, pixel_mm=None),
    Monitor(number=1, name="DP-1", x=1920, y=0, width=1920, height=1080, pixel_mm=None),
]
LIST = (
    "use the number or part of the name of one of: 0 eDP-1 1920x1200+0+0; 1 DP-1 1920x1080+1920+0"
)


def on_screen(name: str, spec: str, _: Path) -> None:
    """Checks a display where the environment names that screen."""
    with pytest.MonkeyPatch.context() as patch:
        for variable in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
            patch.delenv(variable, raising=False)
        if name:
            patch.setenv("DISPLAY", name)
        check_display(parse_display(spec))


def no_encoder(here: Path) -> None:
    """Checks a video in a format that needs PyAV, without it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "av", None)
        check_display(parse_display(f"file:{here}/a.mp4"))


def displayed(spec: str) -> Cause:
    return lambda _: check_display(parse_display(spec))


MESSAGES: dict[str, tuple[Cause, str]] = {
    "no screen": (
        partial(on_screen, "", "fullscreen"),
        (
            "--display fullscreen: no screen here (neither WAYLAND_DISPLAY nor DISPLAY is set)\n "
            f" remedy: {ELSEWHERE}"
        ),
    ),
    **{
        f"dead screen {name}": (
            partial(on_screen, name, "window"),
            f"--display window: no screen here ({name} does not answer)\n  remedy: {ELSEWHERE}",
        )
        for name in (":97", "unix:97", "localhost:97.0", "rubbish", ":")
    },
    **{
        f"display {spec}": (
            displayed(spec),
            f"--display {spec!r}: not a display\n  remedy: {FORMS}",
        )
        for spec in ("windw", "none:", "file", "file:")
    },
    "kind of video": (
        lambda here: check_display(parse_display("file:out.webm")),
        (
            "--display file:out.webm: not .mkv, .avi or .mp4\n  remedy: use for example"
            " file:out.mkv, which is lossless; .mp4 and .avi are small and play everywhere"
        ),
    ),
    "no encoder": (
        no_encoder,
        (
            "--display file:/here/a.mp4: no H.264 encoder: PyAV of PyPI is not installed\n"
            f"  remedy: {install_command('av')}; .avi, .mkv and .gif do not need it"
        ),
    ),
    "no such monitor": (
        lambda here: find_monitor("3", DESK),
        f"screen.monitor '3': no such monitor\n  remedy: {LIST}",
    ),
    "two monitors": (
        lambda here: find_monitor("DP", DESK),
        f"screen.monitor 'DP': several monitors are called that\n  remedy: {LIST}",
    ),
}
