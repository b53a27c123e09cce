"""Opens the display named by `--display`; imports only the library of that display."""

import difflib
import os
import socket
from pathlib import Path

from lfpipe.errors import UserError
from lfpipe.host.graphics import has_desktop
from lfpipe.render.display import Display

HINT = "h shows the keys, g tests your glasses"
FORMS = "window, fullscreen, none or file:OUT.mkv (or .mp4)"


def _answers(family: int, address: str | tuple[str, int]) -> bool:
    try:
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.settimeout(1.0)
            probe.connect(address)
        return True
    except OSError:
        return False


def _x_answers(display: str) -> bool:
    host, colon, rest = display.rpartition(":")
    number = rest.partition(".")[0]
    if not colon or not number.isdigit():
        return False
    if host in ("", "unix"):
        path = f"/tmp/.X11-unix/X{number}"
        return _answers(socket.AF_UNIX, path) or _answers(socket.AF_UNIX, "\0" + path)
    return _answers(socket.AF_INET, (host, 6000 + int(number)))


def has_display() -> bool:
    """Whether a window can be opened: the environment names a display server, and it answers."""
    if has_desktop() or os.environ.get("SDL_VIDEODRIVER") in ("dummy", "offscreen"):
        return True
    if wayland := os.environ.get("WAYLAND_DISPLAY"):
        where = Path(os.environ.get("XDG_RUNTIME_DIR", "")) / wayland
        if _answers(socket.AF_UNIX, str(where)):
            return True
    return _x_answers(os.environ.get("DISPLAY", ""))


def check_display(spec: str, monitor: str = "") -> None:
    """Raises UserError if spec is no display, needs a missing screen or monitor, or names a file that cannot be written. monitor:
    `screen.monitor`.
    """
    if spec in ("window", "fullscreen"):
        if not has_display():
            named = os.environ.get("WAYLAND_DISPLAY") or os.environ.get("DISPLAY")
            why = f"{named} does not answer" if named else "neither WAYLAND_DISPLAY nor DISPLAY is set"
            remedy = "use --display none or --display file:OUT.mkv, or run on a desktop"
            raise UserError(f"--display {spec}: no screen here ({why})", remedy)
        if monitor:
            from lfpipe.render.monitors import detect_monitors, find_monitor

            find_monitor(monitor, detect_monitors()[1])
    elif spec.startswith("file:") and len(spec) > len("file:"):
        from lfpipe.render.file_display import check_file

        check_file(Path(spec.removeprefix("file:")).expanduser())
    elif spec != "none":
        close = difflib.get_close_matches(spec.partition(":")[0], ["window", "fullscreen", "none", "file"], 1, 0.5)
        hint = f" (did you mean {close[0] + (':OUT.mkv' if close[0] == 'file' else '')!r}?)" if close else ""
        raise UserError(f"--display {spec!r}: not a display{hint}", f"use one of {FORMS}")


def part_of(path: Path, part: int) -> Path:
    """The path of a restarted process's part of a video: earlier parts are not overwritten."""
    return path.with_stem(f"{path.stem}.{part + 1}") if part else path


def open_display(
    spec: str, size_px: tuple[int, int], title: str, rate_hz: float, monitor: str = "", part: int = 0, code: str = ""
) -> Display:
    """The display that spec names: window, fullscreen, none, file:OUT.mkv.

    size_px: (width, height) of the pictures; rate_hz: their highest rate, and the rate of a video; monitor: `screen.monitor`;
    part: how often the process that writes a video was restarted; code: the only keys that a window accepts, to end it. Raises
    UserError as `check_display` does, and if the window cannot be opened.
    """
    check_display(spec)
    if spec == "none":
        from lfpipe.render.null_display import NullDisplay

        return NullDisplay()
    if spec.startswith("file:"):
        from lfpipe.render.file_display import FileDisplay

        return FileDisplay(part_of(Path(spec.removeprefix("file:")).expanduser(), part), size_px, rate_hz)
    from lfpipe.render.key_lock import KeyLock
    from lfpipe.render.window import Window

    if code:
        return Window(size_px, title, spec == "fullscreen", monitor, lock=KeyLock(code))
    return Window(size_px, f"{title} ({HINT})", spec == "fullscreen", monitor, HINT)
