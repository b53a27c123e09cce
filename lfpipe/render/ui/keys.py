"""The keys of the window: one table of keys, actions, help, and entries of the bar."""

from functools import lru_cache

import attrs

from lfpipe.render.display.overlay import Event, Item


@attrs.frozen
class Key:
    """A row of related keys."""

    keys: str
    """The keys, separated by spaces."""
    actions: str
    """Names of actions (`lfpipe.render.ui.actions.ACTIONS`), one for each key."""
    help: str
    label: str = ""
    """Label of the entry in the bar; empty: no entry."""


DEPTH = "depth"  # the slider of the bar: 0 for comfort to 1 for true depth
KEYS = (
    Key("Tab", "choose", "choose a scene by its picture", "Scene"),
    Key("l", "open", "open a folder of views", "Open folder"),
    Key("i", "open-file", "open a light field in one file", "Open file"),
    Key("e", "which", "choose your glasses", "Glasses"),
    Key("+ -", "alpha+ alpha-", "more, less parallax when you move", "Depth"),
    Key("d", "invert-depth", "invert depth: swap near and far", "Near/far"),
    Key("c", "recentre", "make your current position the centre", "Recentre"),
    Key("p", "freeze", "pause or resume (space)", "Pause"),
    Key("o", "overlay", "show or hide rate, latency and views", "Metrics"),
    Key("r", "record", "start or stop recording the camera", "Record camera"),
    Key("s", "screenshot", "save the picture", "Save picture"),
    Key(
        "f",
        "fullscreen",
        "full screen on and off (F11); Esc closes the overlay, then leaves full screen",
        "Full screen",
    ),
    Key("h", "help", "show or hide this help (?)", "Help"),
    Key("] [", "depth+ depth-", "move the scene back, forward", ""),
    Key("a", "automatic", "depth and parallax automatic again"),
    Key("m", "mode", "next colour mode"),
    Key("g", "glasses", "glasses test: does each eye see its own letter?"),
    Key("x", "swap", "swap the eyes"),
    Key("PgDn PgUp", "next previous", "next, previous scene of the list"),
    Key("q", "quit", "quit"),
)
ACTION_OF = {
    key: action
    for row in KEYS
    for key, action in zip(row.keys.split(), row.actions.split(), strict=True)
}
HELP = tuple(f"{row.keys}\t{row.help}" for row in KEYS)
CLOSE = Item("×", Event("close"))
# entries of the bar that close a page; the others open another one
CLOSING = {DEPTH} | {row.actions for row in KEYS if row.label} - {
    "choose",
    "which",
    "help",
    "overlay",
}


@lru_cache(2)
def bar_items(
    depth: float, recording: bool, paused: bool, without: frozenset[str]
) -> tuple[Item, ...]:
    """The bar. depth: position of the slider. without: actions that the session does not have."""
    entries = {
        row.actions: Item(row.label, Event(row.actions), row.keys) for row in KEYS if row.label
    }
    entries["alpha+ alpha-"] = Item("comfort    Depth    true", Event(DEPTH), slider=depth)
    if recording:
        entries["record"] = Item("Stop recording", Event("record"), "r", warns=True)
    if paused:
        entries["freeze"] = Item("Resume", Event("freeze"), "p")
    return tuple(item for item in entries.values() if item.event.name not in without)
