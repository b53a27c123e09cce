"""Pages over the picture, at most one at a time: help, metrics, the question about glasses, and
their test. The page of scenes is in `lfpipe.render.ui.scenes`.
"""

from collections.abc import Callable
from functools import lru_cache

import attrs

from lfpipe.render.display.overlay import Event, Item, Menu, Overlay
from lfpipe.render.presenter import Drawing, Presenter, draw_scene
from lfpipe.render.synthesis.compositor import Key
from lfpipe.render.ui.glasses import glasses_test, instructions
from lfpipe.render.ui.notices import VIEWERS, status_lines
from lfpipe.render.ui.settings import Settings
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.transport.clock import SECOND_NS
from lfpipe.transport.context import Context

UPDATE_NS = SECOND_NS // 2  # between two updates of the metrics
RECORDED_FACE = Overlay(
    lines=("A recorded face moves this picture.",),
    items=(
        Item("Use my camera", Event("look", "camera")),
        Item("Use the mouse", Event("look", "mouse")),
    ),
)
GHOST_STEPS = {"more": 5.0, "less": -5.0}  # by event, %: the smallest visible change
CHECKED = ("swap_eyes", "ghost_compensation")  # what a test of glasses may change


def draw_glasses_test(viewer: Viewer, key: Key) -> Drawing:
    """The test of the glasses in place of the scene, as large as the scene's pictures."""
    return Drawing(*glasses_test(viewer.config.render, viewer.compositor.size_px))


class Page:
    """A page that can be opened and closed many times. stays: whether it remains when something
    else in the bar is chosen.
    """

    def __init__(self, overlay: Callable[[], Overlay] = Overlay, stays: bool = False) -> None:
        self._made = overlay
        self.stays = stays

    def open(self) -> None:
        """Called when the page opens."""

    def close(self) -> None:
        """Called when the page closes."""

    def take(self, event: Event) -> bool:
        """Handles an event of its own; returns whether it was one."""
        return False

    def overlay(self, t_ns: int) -> Overlay:
        """The overlay at t_ns."""
        return self._made()


class MetricsPage(Page):
    """Rate, latency and viewpoint."""

    def __init__(self, context: Context, viewer: Viewer, presenter: Presenter) -> None:
        super().__init__(stays=True)
        self._context = context
        self._viewer = viewer
        self._presenter = presenter
        self._due_ns = 0
        self._lines = tuple[str, ...]()

    def overlay(self, t_ns: int) -> Overlay:
        if t_ns >= self._due_ns:
            self._lines = status_lines(self._context, self._viewer)
            self._due_ns = t_ns + UPDATE_NS
            self._presenter.redraw()
        return Overlay(lines=self._lines)


@lru_cache(1)
def viewer_menu(kind: str) -> Menu:
    """Who looks? kind: as `viewer_kind`."""
    items = tuple(Item(label, Event("look", word), icon=word) for word, label in VIEWERS.items())
    at = list(VIEWERS).index(kind) if kind in VIEWERS else 0
    return Menu("Who looks?", "Click, or use the arrows and Enter.", items, at)


class GlassesTest(Page):
    """A letter for each eye in place of the scene; keeps the settings that were changed."""

    def __init__(self, context: Context, presenter: Presenter, settings: Settings) -> None:
        super().__init__()
        self._context = context
        self._presenter = presenter
        self._settings = settings
        self._before = context.config.render

    def open(self) -> None:
        self._before = self._settings.render
        self._presenter.draw_by(draw_glasses_test)

    def close(self) -> None:
        self._presenter.draw_by(draw_scene)
        now = attrs.asdict(self._settings.render)
        self._settings.keep(
            {name: now[name] for name in CHECKED if now[name] != getattr(self._before, name)}
        )

    def take(self, event: Event) -> bool:
        """The arrows change ghost compensation."""
        if event.name in GHOST_STEPS:
            ghost = self._settings.render.ghost_compensation + GHOST_STEPS[event.name]
            self._settings.set(ghost_compensation=min(max(ghost, 0.0), 100.0))
        return event.name in GHOST_STEPS

    def overlay(self, t_ns: int) -> Overlay:
        lines, items = instructions(self._context.config.render)
        return Overlay(lines=lines, items=items)
