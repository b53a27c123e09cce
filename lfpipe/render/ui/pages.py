"""Pages over the picture, at most one at a time: help, figures, the question about glasses, and
their test. The page of scenes is in `lfpipe.render.ui.scenes`.
"""

from collections.abc import Callable

import attrs

from lfpipe.render.presenter import Presenter, draw_glasses_test, draw_scene
from lfpipe.render.ui.glasses import glasses_menu, instructions
from lfpipe.render.ui.notices import status_lines
from lfpipe.render.ui.overlay import HELP, Overlay
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.transport.clock import SECOND_NS
from lfpipe.transport.context import Context

FIGURES_NS = SECOND_NS // 2  # between two readings: faster ones cannot be read
CHECKED = ("swap_eyes", "ghost_compensation")  # what a test of glasses may change


class Page:
    """A page that is opened, shown and closed, again and again."""

    stays = False
    """Whether it remains when something else in the bar is chosen."""

    def open(self) -> None:
        """Begins it."""

    def close(self) -> None:
        """Ends it."""

    def overlay(self, t_ns: int) -> Overlay:
        """What it shows at t_ns."""
        return Overlay()


class Help(Page):
    """All keys."""

    def overlay(self, t_ns: int) -> Overlay:
        return Overlay(lines=HELP)


class MetricsPage(Page):
    """Rate, latency and viewpoint."""

    stays = True

    def __init__(self, context: Context, viewer: Viewer, presenter: Presenter) -> None:
        self._context = context
        self._viewer = viewer
        self._presenter = presenter
        self._due_ns = 0
        self._lines = tuple[str, ...]()

    def open(self) -> None:
        self._due_ns = 0

    def overlay(self, t_ns: int) -> Overlay:
        if t_ns >= self._due_ns:
            self._lines = status_lines(self._context, self._viewer)
            self._due_ns = t_ns + FIGURES_NS
            self._presenter.redraw()
        return Overlay(lines=self._lines)


class GlassesQuestion(Page):
    """Which glasses does the viewer have?"""

    def __init__(self, context: Context) -> None:
        self._context = context

    def overlay(self, t_ns: int) -> Overlay:
        return Overlay(menu=glasses_menu(self._context.config.render.anaglyph))


class GlassesTest(Page):
    """A letter for each eye in place of the scene. keep: stores the settings that were changed."""

    def __init__(
        self,
        context: Context,
        presenter: Presenter,
        keep: Callable[[dict[str, float | bool | str]], None],
    ) -> None:
        self._context = context
        self._presenter = presenter
        self._keep = keep
        self._before = context.config.render

    def open(self) -> None:
        self._before = self._context.config.render
        self._presenter.draw_by(draw_glasses_test)

    def close(self) -> None:
        self._presenter.draw_by(draw_scene)
        now = attrs.asdict(self._context.config.render)
        self._keep(
            {name: now[name] for name in CHECKED if now[name] != getattr(self._before, name)}
        )

    def overlay(self, t_ns: int) -> Overlay:
        lines, items = instructions(self._context.config.render)
        return Overlay(lines=lines, items=items)
