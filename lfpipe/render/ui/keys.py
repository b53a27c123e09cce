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


DEPTH = "depth"  # the slider of the bar: 0 for comfort to 1 for true depth
GROUPS = {
    "Scene": (
        Key("Tab", "choose", "choose a scene", "Scenes"),
        Key("l", "open", "open folder or file", "Open"),
        Key("PgDn PgUp", "next previous", "next, previous"),
    ),
    "View": (
        Key("e", "which", "choose your glasses", "Glasses"),
        Key("v", "who", "choose who looks", "Viewer"),
        Key("+ -", "alpha+ alpha-", "more, less parallax", "Depth"),
        Key("d", "invert-depth", "swap near and far", "Near/far"),
        Key("k", "calibrate", "calibrate camera", "Calibrate"),
        Key("c", "recentre", "centre on you", "Centre"),
        Key("p", "freeze", "pause, resume", "Pause|Resume"),
        Key("f", "fullscreen", "full screen", "Full screen"),
        Key("] [", "depth+ depth-", "scene back, forward"),
        Key("a", "automatic", "automatic depth"),
        Key("m", "mode", "next colour mode"),
        Key("g", "glasses", "test the glasses"),
        Key("x", "swap", "swap the eyes"),
    ),
    "Record": (
        Key("r", "record", "record the camera", "Record|Stop"),
        Key("s", "screenshot", "save the picture", "Save"),
    ),
    "Help": (
        Key("o", "overlay", "rates and latency", "Metrics"),
        Key("h", "help", "these keys", "Help"),
        Key("q", "quit", "quit"),
    ),
}
KEYS = tuple(row for rows in GROUPS.values() for row in rows)
ACTION_OF = {
    key: action
    for row in KEYS
    for key, action in zip(row.keys.split(), row.actions.split(), strict=True)
}
HELP = tuple(
    line
    for group, rows in GROUPS.items()
    for line in (group, *(f"{row.keys}\t{row.help}" for row in rows), "")
)[:-1]
CLOSE = Item("×", Event("close"))
# of the bar's entries: row, group and its labels
_EVENTS = {row: DEPTH if row.label == "Depth" else row.actions for row in KEYS if row.label}
TIPS = {event: row.help for row, event in _EVENTS.items()} | {DEPTH: "from comfort to true depth"}
GROUP_OF = {_EVENTS[row]: group for group, rows in GROUPS.items() for row in rows if row.label}
LABELS = {event: tuple(row.label.split("|")) for row, event in _EVENTS.items()}
# entries of the bar that close a page; the others open another one
CLOSING = set(LABELS) - {"choose", "open", "which", "who", "calibrate", "help", "overlay"}


@lru_cache(2)
def bar_items(
    depth: float, recording: bool, paused: bool, without: frozenset[str]
) -> tuple[Item, ...]:
    """The bar. depth: position of the slider. without: actions that the session does not have."""
    second = {"record": recording, "freeze": paused}
    return tuple(
        Item(
            LABELS[event][second.get(event, False)],
            Event(event),
            "" if event == DEPTH else row.keys,
            slider=depth if event == DEPTH else None,
            warns=event == "record" and recording,
            off=event in without,
        )
        for row, event in _EVENTS.items()
    )
