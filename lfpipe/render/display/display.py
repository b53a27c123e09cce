"""The base class of displays, the overlay as data, how the value of `--display` is parsed, checked
and opened, and the keys of the window: one table of keys, actions, help, and entries of the bar.

The session sets an `Overlay`; the display draws it, and reports keys, clicks and touches as
`Event`.
"""

import contextlib
import os
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import lru_cache
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.config.session_options import Nothing, Plugin, Target, VideoFile, Window
from lfpipe.errors import UserError
from lfpipe.host.presentation import Presented
from lfpipe.host.worker import has_desktop
from lfpipe.plugins import DISPLAYS, make, plugins

Picture = NDArray[np.uint8]  # (height, width, 3) BGR


@attrs.frozen
class Event:
    """What a person did."""

    name: str
    """An action of the session, as "recentre"."""
    text: str = ""
    """A path for "load"; the kind of glasses for "wear"."""
    value: float = 0.0
    """Position of a slider, 0 to 1."""


NO_EVENT = Event("")
PICTURE_MM = 530.0  # width of a screen of 24 inches, for monitors that report no size


@attrs.frozen
class Item:
    """Something to see, and perhaps to click."""

    label: str
    event: Event = NO_EVENT
    """Reported for a click; without a name: nothing happens."""
    key: str = ""
    """The key that does the same, shown below the label."""
    icon: str = ""
    """Of `lfpipe.render.display.look.ICONS`, shown above the label."""
    picture: NDArray[np.uint8] | None = attrs.field(default=None, eq=id)
    """Shown above the label: uint8 (height, width, 3 or 4) RGB or RGBA."""
    slider: float | None = None
    """Position of a slider, 0 to 1; its event carries the new one."""
    warns: bool = False
    """Whether the label is red; in a menu, its second line."""
    off: bool = False
    """Whether it keeps its place without an effect."""
    more: str = ""
    """A second line in a menu; in the bar, why it is off."""
    row: bool = False
    """Whether it is a row of a menu; without an event, a heading."""
    main: bool = False
    """Whether most people choose it."""


@attrs.frozen
class Menu:
    """A choice: arrows and Enter, or a click, select an item's event. A menu of the same title
    replaces the one on the screen and keeps its selection.
    """

    title: str
    items: tuple[Item, ...]
    at: int = 0
    """The item selected at first."""


@attrs.frozen
class Notice:
    """A line or a few over the picture."""

    text: str
    items: tuple[Item, ...] = ()
    """What can be done about it; then it is at the top."""


@attrs.frozen(kw_only=True)
class Overlay:
    """The overlay. Esc, and the × button of text panels and menus, emit "close"."""

    title: str = ""
    """Of the lines."""
    lines: tuple[str, ...] = ()
    """At the top left; in the middle if they have a title. KEY\tTEXT is a key, NAME\tTEXT\tSHARE
    a value with a bar, and a line before such ones a heading."""
    items: tuple[Item, ...] = ()
    """Entries below the lines, which then are at the bottom."""
    inset: NDArray[np.uint8] | None = attrs.field(default=None, eq=id)
    """A small picture below the lines, uint8 (height, width, 3) BGR."""
    notices: tuple[Notice, ...] = ()
    """Each in a panel of its own, the newest next to the picture's edge."""
    scene: str = ""
    """Its name at the top left, with the bar or a progress."""
    step: str = ""
    """What is being done with the scene."""
    progress: float | None = None
    """Share of the step that is done."""
    viewer: str = ""
    """Who looks, at the top right, with the bar."""
    menu: Menu | None = None
    bar: tuple[Item, ...] = ()
    """At the bottom, while the pointer is there or rests: its entries keep their places."""
    recording: str = ""
    """Text beside a red dot at the top right."""
    caption: tuple[str, ...] = ()
    """A title and lines in large letters at the bottom left, with the items at the right."""
    elapsed: float | None = None
    """Share of the time of the scene, as a bar along the bottom."""


@attrs.frozen
class Pointer:
    """The mouse over the window."""

    x: float = 0.5
    """Share of the width, from the left edge."""
    y: float = 0.5
    """Share of the height, from the top edge."""
    left: bool = False
    """Whether the left button is held."""
    right: bool = False
    """Whether the right button is held."""
    wheel: int = 0
    """Steps away from the person since the last events."""


@attrs.frozen
class DisplayNotice:
    """A notice for the user."""

    text: str
    lost: bool
    """The display's file ended early, because of a full disk or the like."""


class Display:
    """Accepts pictures and shows nothing."""

    pointer = Pointer()
    """The pointer, updated by `events`."""
    knows_rows = True
    """Whether it knows the screen rows of its pictures."""
    waiting: Callable[[], AbstractContextManager[None]] = nullcontext
    """Entered for calls in which the window system may keep the stage waiting."""
    vblank_source = ""
    """What reports presentations: x_present; empty for nothing."""
    fds: Sequence[int] | None = ()
    """Descriptors that can be read when `events` has news; None if it must be asked at every
    refresh, or needs a picture then."""
    notice: DisplayNotice | None = None
    """For the user, who has not read it yet."""

    def show(
        self, picture: Picture, pair: tuple[Picture, Picture] | None = None, how: str = ""
    ) -> int:
        """Shows uint8 (height, width, 3) BGR, scaled to fit; returns the submission time, monotonic
        ns.

        pair: the left and right view that picture consists of, and "side-by-side" or
        "row-interleaved": for a screen that must show them in its own pixels.
        """
        return time.monotonic_ns()

    def presented(self) -> list[Presented]:
        """The vblanks that showed pictures, reported since the last call. serial: the
        picture's number, 1 for the first call of `show`.
        """
        return []

    def events(self) -> list[Event]:
        """User input since the last call: actions of keys, events of overlay items, "load" for a
        dropped file. Call it often: it keeps a window responsive.
        """
        return []

    def overlay(self, overlay: Overlay) -> None:
        """Sets the overlay of this and the following pictures."""

    def title(self, name: str) -> None:
        """Sets the name of the current scene."""

    def shown_px(self, picture_px: tuple[int, int]) -> tuple[int, int]:
        """The pixels that a picture covers now; both sizes are (width, height). A smaller picture
        than picture_px is enough then.
        """
        return picture_px

    def width_mm(self) -> float | None:
        """Current width of the picture on the screen; None if the size of a pixel is unknown."""
        return None

    def close(self) -> None:
        """Closes the display and completes a file."""


HINT = "h shows the keys, g tests your glasses"
FORMS = "window, fullscreen, none or file:OUT.mkv (or .mp4)"


def _sockets() -> Iterator[tuple[socket.AddressFamily, str | tuple[str, int]]]:
    """Addresses of the display servers that the environment names."""
    if wayland := os.environ.get("WAYLAND_DISPLAY"):
        yield socket.AF_UNIX, str(Path(os.environ.get("XDG_RUNTIME_DIR", "")) / wayland)
    host, colon, rest = os.environ.get("DISPLAY", "").rpartition(":")
    number = rest.partition(".")[0]
    if colon and number.isdigit() and host in ("", "unix"):
        path = f"/tmp/.X11-unix/X{number}"
        yield from ((socket.AF_UNIX, path), (socket.AF_UNIX, "\0" + path))
    elif colon and number.isdigit():
        yield socket.AF_INET, (host, 6000 + int(number))


def has_display() -> bool:
    """Whether a window can be opened: the environment names a display server, and it answers."""
    if has_desktop() or os.environ.get("SDL_VIDEODRIVER") in ("dummy", "offscreen"):
        return True
    for family, address in _sockets():
        with contextlib.suppress(OSError), socket.socket(family) as probe:
            probe.settimeout(1.0)
            probe.connect(address)
            return True
    return False


def parse_display(text: str) -> Target:
    """The display named by `--display`. Raises UserError for an unknown one."""
    name, _, argument = text.partition(":")
    match name:
        case "window" | "fullscreen" if text == name:
            return Window(fullscreen=name == "fullscreen")
        case "none" if text == name:
            return Nothing()
        case "file" if argument:
            return VideoFile(Path(argument).expanduser())
        case _ if name in plugins(DISPLAYS):
            return Plugin(name, argument)
        case _:
            plugged = "".join(f", or {name}:ARGUMENT" for name in plugins(DISPLAYS))
            raise UserError(f"--display {text!r}: not a display", f"use one of {FORMS}{plugged}")


def check_display(target: Target) -> None:
    """Raises UserError if target needs a missing screen or is an unwritable file."""
    match target:
        case Window():
            if not has_display():
                named = os.environ.get("WAYLAND_DISPLAY") or os.environ.get("DISPLAY")
                why = (
                    f"{named} does not answer"
                    if named
                    else "neither WAYLAND_DISPLAY nor DISPLAY is set"
                )
                raise UserError(
                    f"--display {target}: no screen here ({why})",
                    "use --display none or --display file:OUT.mkv, or run on a desktop",
                )
        case VideoFile(path):
            from lfpipe.render.display.file_display import check_file

            check_file(path)


def open_display(
    target: Target,
    size_px: tuple[int, int],
    title: str,
    rate_hz: float,
    monitor: str = "",
    restarts: int = 0,
) -> Display:
    """Opens a display that `check_display` has accepted.

    size_px: (width, height) of the pictures; rate_hz: their highest rate, and the rate of a video;
    monitor: `screen.monitor`; restarts: how often the process that writes a video was restarted,
    which makes the next file. Raises UserError if it cannot be opened.
    """
    match target:
        case Window(fullscreen=fullscreen, lock_code=code):
            from lfpipe.render.display.window import ScreenWindow

            title = title if code else f"{title} ({HINT})"
            return ScreenWindow(size_px, title, fullscreen, monitor, code)
        case VideoFile(path):
            from lfpipe.render.display.file_display import FileDisplay

            if restarts:
                path = path.with_stem(f"{path.stem}.{restarts + 1}")
            return FileDisplay(path, size_px, rate_hz)
        case Plugin(name, argument):
            display: Display = make(DISPLAYS, name, argument, size_px, title, rate_hz)
            display.fds = None
            return display
        case Nothing():
            return Display()


@attrs.frozen
class Key:
    """A row of related keys."""

    keys: str
    """The keys, separated by spaces."""
    actions: str
    """Names of actions (`lfpipe.render.ui.controller.ACTIONS`), one for each key."""
    help: str
    label: str = ""
    """Label of the entry in the bar, and after "|" its other one; empty: no entry."""


VIEWERS = {"camera": "Camera", "mouse": "Mouse", "demo": "Recorded face"}
DEPTH = "depth"  # the slider of the bar: 0 for comfort to 1 for true depth
GROUPS = {
    "Scene": (
        Key("Tab", "choose", "Choose a scene", "Scenes"),
        Key("l", "open", "Open a folder or file", "Open"),
        Key("PgDn PgUp", "next previous", "Next, previous (→ ←)"),
    ),
    "View": (
        Key("e", "which", "Choose your glasses", "Glasses"),
        Key("v", "who", "Camera, mouse or recorded face", "Viewer"),
        Key("+ -", "alpha+ alpha-", "More, less depth", "Depth"),
        Key("d", "invert-depth", "Swap near and far", "Near/far"),
        Key("k", "calibrate", "Calibrate the camera", "Calibrate"),
        Key("c", "recentre", "Centre on you", "Centre"),
        Key("p", "freeze", "Pause, resume (Space)", "Pause|Resume"),
        Key("f", "fullscreen", "Full screen (F11)", "Full screen"),
        Key("] [", "depth+ depth-", "Scene back, forward"),
        Key("a", "automatic", "Automatic depth"),
        Key("m", "mode", "Next colour mode"),
        Key("g", "glasses", "Test the glasses"),
        Key("x", "swap", "Swap the eyes"),
    ),
    "Record": (
        Key("r", "record", "Record the camera", "Record|Stop"),
        Key("s", "screenshot", "Save the picture", "Save"),
    ),
    "Help": (
        Key("o", "overlay", "Rates and latency", "Metrics"),
        Key("h", "help", "This page", "Help"),
        Key("q", "quit", "Quit"),
    ),
}
MOUSE = ("Mouse", "Wheel\tZoom", "Drag\tMove the zoomed picture", "Double\tClick: whole picture")
KEYS = tuple(row for rows in GROUPS.values() for row in rows)
ACTION_OF = {
    key: action
    for row in KEYS
    for key, action in zip(row.keys.split(), row.actions.split(), strict=True)
}
HELP = (
    *(
        line
        for group, rows in GROUPS.items()
        for line in (group, *(f"{row.keys}\t{row.help}" for row in rows), "")
    ),
    *MOUSE,
)
CLOSE = Item("×", Event("close"))
# of the bar's entries: row, group and its labels
_EVENTS = {row: DEPTH if row.label == "Depth" else row.actions for row in KEYS if row.label}
GROUP_OF = {_EVENTS[row]: group for group, rows in GROUPS.items() for row in rows if row.label}
LABELS = {event: tuple(row.label.split("|")) for row, event in _EVENTS.items()}
USED = (  # the bar's entries, the most used first: theirs are the last words to go
    "choose",
    "open",
    "which",
    "help",
    "freeze",
    "record",
    DEPTH,
    "who",
    "recentre",
    "fullscreen",
    "screenshot",
    "calibrate",
    "invert-depth",
    "overlay",
)
# entries of the bar that close a page; the others open another one
CLOSING = set(LABELS) - {"choose", "open", "which", "who", "calibrate", "help", "overlay"}


@lru_cache(2)
def bar_items(
    depth: float, recording: bool, paused: bool, without: tuple[tuple[str, str], ...] = ()
) -> tuple[Item, ...]:
    """The bar. depth: position of the slider. without: actions that the session does not have, and
    why.
    """
    second = {"record": recording, "freeze": paused}
    off = dict(without)
    return tuple(
        Item(
            LABELS[event][second.get(event, False)],
            Event(event),
            "" if event == DEPTH else row.keys,
            slider=depth if event == DEPTH else None,
            warns=event == "record" and recording,
            off=event in off,
            more=off.get(event, ""),
        )
        for row, event in _EVENTS.items()
    )
