"""The keys of the window: one table of keys, actions, help, and entries of the bar."""

from functools import lru_cache

import attrs

from lfpipe.render.display.display import Event, Item


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
