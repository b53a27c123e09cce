"""Pages over the picture, at most one at a time: help, metrics, who looks, the question about the
viewer's glasses (key e, and at the first start), and their test (key g). The page of scenes is in
`lfpipe.render.ui.scenes`.
"""

from collections.abc import Callable
from functools import lru_cache

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Render
from lfpipe.render.display.display import Event, Item, Menu, Overlay
from lfpipe.render.presenter import Drawing, Presenter, draw_scene
from lfpipe.render.synthesis.anaglyph import MATRICES, encode
from lfpipe.render.synthesis.compositor import Key, recipe_for
from lfpipe.render.synthesis.pair_layout import Pair, arrange_stereo_pair
from lfpipe.render.ui.notices import VIEWERS, metrics
from lfpipe.render.ui.settings import Settings
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.transport.clock import SECOND_NS
from lfpipe.transport.context import Context

Colour = tuple[int, int, int]
# label, more about it, colours of the left and right lens (RGB), value of render.anaglyph
KINDS: tuple[tuple[str, str, tuple[Colour, Colour] | None, str], ...] = (
    ("Red / cyan", "the usual ones", ((220, 30, 30), (0, 190, 200)), "dubois"),
    ("Green / magenta", "", ((20, 170, 40), (210, 40, 200)), "dubois-green-magenta"),
    ("Amber / blue", "", ((240, 170, 0), (30, 40, 190)), "dubois-amber-blue"),
    ("3D television", "side by side", ((60, 60, 60), (60, 60, 60)), "side-by-side"),
    ("No glasses", "a flat picture that moves", None, "mono"),
)
ICON_PX = 480, 240  # width, height: larger than on any screen, so that it is only scaled down
# of the test: both values leave headroom for ghost compensation
GREY, DARK, LIGHT = 128, 60, 235
LETTER_AT = 0.38  # of the height: the middle of the letters
GHOST = "ghost"  # the slider of the test
LOOKS = {"camera": "follows your eyes", "mouse": "move it to look", "demo": "a demonstration"}
FONT = cv2.FONT_HERSHEY_DUPLEX


def _icon(lenses: tuple[Colour, Colour] | None) -> NDArray[np.uint8]:
    """Glasses, or a crossed circle for none: RGBA."""
    picture = np.zeros((ICON_PX[1], ICON_PX[0], 4), np.uint8)
    frame = (200, 200, 200, 255)
    line = 14
    middle, y = ICON_PX[0] // 2, ICON_PX[1] // 2
    if lenses is None:
        cv2.circle(picture, (middle, y), 100, frame, line, cv2.LINE_AA)
        cv2.line(picture, (middle - 70, y + 70), (middle + 70, y - 70), frame, line, cv2.LINE_AA)
    for x, colour in zip((middle - 115, middle + 115), lenses or (), strict=False):
        cv2.ellipse(picture, (x, y), (95, 70), 0, 0, 360, (*colour, 255), -1, cv2.LINE_AA)
        cv2.ellipse(picture, (x, y), (95, 70), 0, 0, 360, frame, line, cv2.LINE_AA)
    return picture


@lru_cache(1)
def glasses_menu(anaglyph: str) -> Menu:
    """The question. anaglyph: the current setting."""
    items = tuple(
        Item(label, Event("wear", value), picture=_icon(lenses), more=more, row=True)
        for label, more, lenses, value in KINDS
    )
    at = next((k for k, (*_, value) in enumerate(KINDS) if value == anaglyph), 0)
    return Menu("Which glasses do you have?", items, at)


def _eye_picture(left: bool, size_px: tuple[int, int]) -> NDArray[np.uint8]:
    """The test picture for one eye, uint8 BGR: its letter in its half, and a frame for both.
    size_px: (width, height).
    """
    width, height = size_px
    picture = np.full((height, width, 3), GREY, np.uint8)
    line = max(2, min(size_px) // 100)
    cv2.rectangle(picture, (line, line), (width - 1 - line, height - 1 - line), (LIGHT,) * 3, line)
    patch = (
        slice(width // 16, width // 2 - width // 32)
        if left
        else slice(width // 2 + width // 32, width - width // 16)
    )
    picture[height // 8 : height - height // 8, patch] = DARK
    letter = "L" if left else "R"
    scale = min(width / 2, height) / 40
    (wide, high), _ = cv2.getTextSize(letter, FONT, scale, line)
    # above the middle: the lines of the test lie below
    at = (patch.start + patch.stop - wide) // 2, round(LETTER_AT * height) + high // 2
    cv2.putText(picture, letter, at, FONT, scale, (LIGHT,) * 3, 2 * line, cv2.LINE_AA)
    return picture


@lru_cache(1)
def glasses_test(render: Render, size_px: tuple[int, int]) -> tuple[NDArray[np.uint8], Pair | None]:
    """A picture with an L for the left eye and an R for the right one, composed like every other
    picture.

    Returns uint8 (height, width, 3) BGR, and its two views where the mode shows two.
    """
    pair = _eye_picture(True, size_px), _eye_picture(False, size_px)
    if render.swap_eyes:
        pair = pair[::-1]
    if render.anaglyph in MATRICES:
        return encode(*pair, recipe_for(render)), None
    if render.anaglyph == "mono":
        return np.maximum(*pair), None
    return arrange_stereo_pair(pair, render.anaglyph, size_px), pair


def instructions(render: Render) -> Overlay:
    """The running test."""
    swap = Item("Swap the eyes", Event("swap"), "x")
    ghosts = Item(
        f"Ghosts {render.ghost_compensation:.0f} %",
        Event(GHOST),
        slider=render.ghost_compensation / 100,
    )
    others = Item("Other glasses", Event("which"), "e"), Item("Done", Event("glasses"), main=True)
    if render.anaglyph == "mono":
        return Overlay(lines=("No glasses: both eyes see the same.",), items=others)
    if render.anaglyph not in MATRICES:
        return Overlay(lines=("Close your left eye: only R?",), items=(swap, *others))
    lines = "Close your left eye: only R?", "Faint L: raise the slider."
    return Overlay(lines=lines, items=(swap, ghosts, *others))


UPDATE_NS = SECOND_NS // 2  # between two updates of the metrics
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
            self._lines = metrics(self._context, self._viewer)
            self._due_ns = t_ns + UPDATE_NS
            self._presenter.redraw()
        return Overlay(lines=self._lines)


@lru_cache(1)
def viewer_menu(kind: str) -> Menu:
    """The choice of who looks. kind: as `viewer_kind`."""
    items = tuple(
        Item(label, Event("look", word), icon=word, more=LOOKS[word], row=True)
        for word, label in VIEWERS.items()
    )
    return Menu("Viewer", items, list(VIEWERS).index(kind) if kind in VIEWERS else 0)


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
        return instructions(self._context.config.render)
