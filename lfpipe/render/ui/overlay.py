"""What lies over the picture, as data: the keys with their help and their entries in the bar,
menus, and lines of text.

The session sets an `Overlay`; the window draws it, and reports keys, clicks and touches as the same
events.
"""

from functools import lru_cache

import attrs
import numpy as np
from numpy.typing import NDArray


@attrs.frozen
class Key:
    """keys: what a person presses. events: what the window reports, one for each key. help: for
    people. label: of the entry in the bar, "" for none.
    """

    keys: str
    events: str
    help: str
    label: str = ""


DEPTH = "depth"  # event of the slider: "depth S", S from 0 for comfort to 1 for true depth
KEYS = (
    Key("Tab", "choose", "choose a scene by its picture", "Scene"),
    Key("l", "open", "open a folder of views", "Open folder"),
    Key("i", "open-file", "open a light field in one file", "Open file"),
    Key("e", "which", "which glasses do you have?", "Glasses"),
    Key("+ -", "alpha+ alpha-", "more, less head movement from view to view", "Depth"),
    Key("d", "invert-depth", "exchange near and far", "Near/far"),
    Key("c", "recentre", "look straight ahead from where you are now", "Straight ahead"),
    Key("p", "freeze", "pause or resume (space)", "Pause"),
    Key("o", "overlay", "rate, latency and the views on show, on and off", "Figures"),
    Key("r", "record", "record the camera, or end it", "Record camera"),
    Key("s", "screenshot", "save the picture", "Save picture"),
    Key(
        "f",
        "fullscreen",
        "full screen on and off (F11); Esc closes the overlay, then leaves it",
        "Full screen",
    ),
    Key("h", "help", "this help on and off (?)", "Help"),
    Key("] [", "depth+ depth-", "the scene goes back, comes forward", ""),
    Key("a", "automatic", "depth and head movement automatic again"),
    Key("m", "mode", "another way to give each eye its view"),
    Key("g", "glasses", "glasses test: does each eye see its own?"),
    Key("x", "swap", "swap the eyes"),
    Key("PgDn PgUp", "next previous", "the next scene of the list, the previous one"),
    Key("q", "quit", "quit"),
)
EVENTS = {
    key: event
    for row in KEYS
    for key, event in zip(row.keys.split(), row.events.split(), strict=True)
}
HELP = tuple(f"{row.keys}\t{row.help}" for row in KEYS)


@attrs.frozen
class Item:
    """Something to see; a click on it is its event, "" for none. key: shown below the label.
    picture: above it, uint8 (height, width, 3 or 4) RGB or RGBA. slider: its position, 0 to 1,
    which its event repeats. warns: red.
    """

    label: str
    event: str = ""
    key: str = ""
    picture: NDArray[np.uint8] | None = attrs.field(default=None, eq=id)
    slider: float | None = None
    warns: bool = False


@attrs.frozen
class Menu:
    """A choice: arrows and Enter, or a click, cause an item's event; Delete causes "delete EVENT",
    Esc "close". at: the item selected at first. A menu of the same title replaces the one on the
    screen, and keeps its selection.
    """

    title: str
    hint: str
    items: tuple[Item, ...]
    at: int = 0


@attrs.frozen(kw_only=True)
class Overlay:
    """What lies over the picture. Esc, and the cross of lines and menu, cause "close"."""

    # at the top left; text after a tab forms a second column
    lines: tuple[str, ...] = ()
    # a row of entries below the lines, which then are at the bottom
    items: tuple[Item, ...] = ()
    # a small picture below the lines, uint8 (h, w, 3) BGR
    inset: NDArray[np.uint8] | None = attrs.field(default=None, eq=id)
    # each in a panel of its own at the bottom, the first on top
    notices: tuple[str, ...] = ()
    # length of a thin line along the bottom, as a share of the width; None without
    progress: float | None = None
    menu: Menu | None = None
    # at the bottom, while the mouse is there or rests
    bar: tuple[Item, ...] = ()
    # beside a red dot at the top right; "" for none
    recording: str = ""


CLOSE = Item("×", "close")
TURNS = (Item("◀", "previous"), Item("▶", "next"))  # the pages of a menu that has several
# entries of the bar that close a page; the others open another one
CLOSING = {DEPTH} | {row.events for row in KEYS if row.label} - {
    "choose",
    "which",
    "help",
    "overlay",
}


@lru_cache(2)
def bar_items(
    depth: float, recording: bool, paused: bool, without: frozenset[str]
) -> tuple[Item, ...]:
    """The bar. depth: of the slider. without: events that the session does not have."""
    entries = {row.events: Item(row.label, row.events, row.keys) for row in KEYS if row.label}
    entries["alpha+ alpha-"] = Item("comfort    Depth    true", DEPTH, slider=depth)
    if recording:
        entries["record"] = Item("Stop recording", "record", "r", warns=True)
    if paused:
        entries["freeze"] = Item("Resume", "freeze", "p")
    return tuple(item for item in entries.values() if item.event not in without)


@attrs.frozen
class Pointer:
    """The mouse over the window. x, y: share of the window, from its top left corner. left, right:
    buttons held. wheel: steps away from the person, since the events before.
    """

    x: float = 0.5
    y: float = 0.5
    left: bool = False
    right: bool = False
    wheel: int = 0
