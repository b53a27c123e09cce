"""The overlay as data, and the events that a display reports.

The session sets an `Overlay`; the display draws it, and reports keys, clicks and touches as
`Event`.
"""

import attrs
import numpy as np
from numpy.typing import NDArray


@attrs.frozen
class Event:
    """What a person did."""

    name: str
    """An action of the session, as "recentre"."""
    text: str = ""
    """A path for "load" and "delete"; the kind of glasses for "wear"."""
    value: float = 0.0
    """Position of a slider, 0 to 1."""


NO_EVENT = Event("")


@attrs.frozen
class Item:
    """Something to see, and perhaps to click."""

    label: str
    event: Event = NO_EVENT
    """Reported for a click; without a name: nothing happens."""
    key: str = ""
    """The key that does the same, shown below the label."""
    icon: str = ""
    """Of `lfpipe.render.ui.look.ICONS`, shown above the label."""
    picture: NDArray[np.uint8] | None = attrs.field(default=None, eq=id)
    """Shown above the label: uint8 (height, width, 3 or 4) RGB or RGBA."""
    slider: float | None = None
    """Position of a slider, 0 to 1; its event carries the new one."""
    warns: bool = False
    """Whether the label is red."""
    off: bool = False
    """Whether it keeps its place without an effect."""


@attrs.frozen
class Menu:
    """A choice: arrows and Enter, or a click, select an item's event; Delete emits "delete" with
    the event's text. A menu of the same title replaces the one on the screen and keeps its
    selection.
    """

    title: str
    hint: str
    items: tuple[Item, ...]
    at: int = 0
    """The item selected at first."""


@attrs.frozen(kw_only=True)
class Overlay:
    """The overlay. Esc, and the × button of text panels and menus, emit "close"."""

    lines: tuple[str, ...] = ()
    """At the top left; in the middle if they name keys, each followed by a tab."""
    items: tuple[Item, ...] = ()
    """Entries below the lines, which then are at the bottom; without lines, below the last
    notice."""
    types: bool = False
    """Whether digits and "backspace" are reported, as the text of a "type"."""
    inset: NDArray[np.uint8] | None = attrs.field(default=None, eq=id)
    """A small picture below the lines, uint8 (height, width, 3) BGR."""
    notices: tuple[str, ...] = ()
    """Each in a panel of its own at the bottom, the first on top."""
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
