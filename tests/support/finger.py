"""A finger on a session's window: it taps where the window draws an item."""

import functools

import attrs
from pygame import surfarray

from lfpipe.render.display.display import Event, bar_items
from lfpipe.render.display.look import NO_HIGHLIGHT
from lfpipe.render.display.panels import Panel, bar_panel
from lfpipe.render.display.window import letters_px
from tests.support.world import World
from tests.support.xvfb_screen import Screen, outline


@attrs.define
class Finger:
    """Taps on a session's window."""

    world: World
    screen: Screen
    title: str

    @functools.cached_property
    def place(self) -> tuple[int, int, int, int]:
        """x, y, width, height of the window."""
        found = outline(self.title, self.screen.name)
        assert found is not None
        return found

    @property
    def size_px(self) -> tuple[int, int]:
        return self.place[2:]

    @property
    def text_px(self) -> int:
        return round(letters_px(self.screen.picture().shape[0]))

    def tap(self, x: int, y: int) -> None:
        left, top, _, _ = self.place
        self.world.xdotool("mousemove", left + x, top + y, "click", 1)

    def touch(self, panel: Panel, event: str, text: str = "") -> None:
        """Taps on the item of that event."""
        wanted = Event(event, text)
        rect = next(rect for item, rect in panel.cells if item.event == wanted)
        self.tap(*rect.move(panel.at).center)

    def bar(self, recording: bool = False, paused: bool = False) -> Panel:
        items = bar_items(0.0, recording, paused)
        return bar_panel(items, NO_HIGHLIGHT, self.size_px, self.text_px)

    def use_bar(self, event: str, recording: bool = False, paused: bool = False) -> None:
        """A tap on the picture brings the bar; another one chooses."""
        self.tap(5, 5)
        self.touch(self.bar(recording, paused), event)

    def dark(self, panel: Panel) -> bool:
        """Whether the panel lies over the picture: most of its white pixels are on the screen."""
        left, top = self.place[0] + panel.at[0], self.place[1] + panel.at[1]
        white = (surfarray.array3d(panel.surface) == 255).all(axis=-1).T
        rows, cols = white.shape
        shown = self.screen.picture()[top : top + rows, left : left + cols]
        return bool((shown == 255).all(axis=-1)[white].mean() > 0.7)
