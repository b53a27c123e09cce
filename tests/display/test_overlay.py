"""The overlay of the window: what keys, clicks and touches on it mean, at any size of window."""

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import attrs
import numpy as np
import pygame
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.render.display.display import DEPTH, HELP, Event, Item, Menu, Notice, Overlay, bar_items
from lfpipe.render.display.look import NO_HIGHLIGHT
from lfpipe.render.display.overlay_view import OverlayView
from lfpipe.render.display.panels import EDGE_PX, Panel, bar_panel
from lfpipe.render.display.window import TEXT_PX
from lfpipe.render.ui.pages import Distance, calibration_page, glasses_menu
from lfpipe.render.ui.scenes import Content, folder_menu
from tests.support.examples import examples

SIZES = [(320, 240), (640, 480), (1920, 1080), (3840, 2160)]
BAR = bar_items(0.0, False, False)
ARROWS = ["left", "right", "up", "down", "pagedown", "pageup"]


@pytest.fixture(autouse=True, scope="module")
def fonts() -> None:
    pygame.font.init()


class Screened(OverlayView):
    """An overlay in a window of a size."""

    def __init__(self, size: tuple[int, int], overlay: Overlay) -> None:
        super().__init__()
        self.size = size
        self.set(overlay)
        self.move(pygame.MOUSEMOTION, 0, 0)
        self.draw()

    def draw(self) -> Panel:
        return next(
            panel for panel in self.panels(self.size, max(22, self.size[1] // 50)) if panel.cells
        )

    def move(self, kind: int, x: int, y: int) -> Event | None:
        return self.mouse(SimpleNamespace(type=kind, button=1), (x, y))  # type: ignore[arg-type]

    def click(self, x: int, y: int) -> Event | None:
        event = self.move(pygame.MOUSEBUTTONDOWN, x, y)
        self.move(pygame.MOUSEBUTTONUP, x, y)
        return event

    def clicked(self) -> Iterator[Event | None]:
        """What clicks all over the window cause."""
        return (
            self.click(x, y) for x in range(2, self.size[0], 7) for y in range(2, self.size[1], 7)
        )


@pytest.mark.parametrize("size", SIZES[::2])
def test_bar_entries_can_be_clicked(
    size: tuple[int, int],
) -> None:
    screened = Screened(size, Overlay(bar=BAR))
    bar = screened.draw()
    width, height = bar.surface.get_size()
    assert bar.rect.bottom == size[1] - EDGE_PX and abs(2 * bar.at[0] + width - size[0]) <= 1
    # the smallest window needs two rows
    assert width < size[0] and height <= (0.47 if size == SIZES[0] else 0.14) * size[1]
    assert {event and event.name for event in screened.clicked()} == {
        None,
        *(item.event.name for item in BAR),
    }


@pytest.mark.parametrize("size", SIZES)
def test_bar_entries_keep_their_places_in_every_state(size: tuple[int, int]) -> None:
    text_px = max(TEXT_PX, size[1] // 50)
    without = [(), ((DEPTH, "flat"), ("choose", "alone"), ("record", "no camera"))]
    places = {
        tuple((item.event, *rect) for item, rect in panel.cells)
        for items in (
            bar_items(0.0, recording, paused, off)
            for recording in (False, True)
            for paused in (False, True)
            for off in without
        )
        for panel in (bar_panel(items, NO_HIGHLIGHT, size, text_px),)
    }
    assert len(places) == 1


@pytest.mark.parametrize("size", SIZES[1:2])
def test_menu_of_several_pages_is_turned_by_touch(size: tuple[int, int]) -> None:
    items = tuple(Item(f"scene {number}", Event("load", str(number))) for number in range(99))
    screened = Screened(size, Overlay(menu=Menu("Choose a scene", items)))
    reached = set[Event]()
    for turn in ("pagedown", "pageup"):
        for _ in items:
            cells = screened.draw().cells
            reached |= {item.event for item, _ in cells}
            (rect,) = (rect for item, rect in cells if item.event.name == turn)
            assert screened.click(*rect.move(screened.draw().at).center) is None
        assert screened.key("enter") == Event("load", "98" if turn == "pagedown" else "0")
    assert {item.event for item in items} <= reached


@examples(20)
@given(
    st.integers(1, 40),
    st.tuples(st.integers(120, 1400), st.integers(120, 900)),
    st.lists(st.sampled_from([*ARROWS, "draw"]), max_size=30),
)
def test_menu_shows_the_selected_item(count: int, size: tuple[int, int], keys: list[str]) -> None:
    items = tuple(
        Item(f"scene {k}", Event("load", f"/{k}"), picture=np.zeros((6, 8, 3), np.uint8))
        for k in range(count)
    )
    screened = Screened(size, Overlay(menu=Menu("", items, count // 2)))
    for key in keys:  # several may come between two refreshes
        assert key == "draw" or screened.key(key) is None
        if key == "draw":
            screened.draw()
    screened.draw()
    selected = screened.key("enter")
    assert selected in {item.event for item, _ in screened.draw().cells}
    assert selected is not None
    assert screened.key("m") == Event("mode")
    screened.set(Overlay(menu=Menu("", items[:-1] or items, 0)))  # of the same title
    assert screened.key("enter") == selected or selected == items[-1].event
    screened.draw()
    remaining = len(items[:-1] or items)
    assert (
        len({screened.key("right") or screened.key("enter") for _ in range(remaining)}) == remaining
    ), "one key reaches all"


CONTENT = Content(Path("/home"), ["views"], ["film.mp4"], 25)


@pytest.mark.parametrize("size", SIZES[:2])
@pytest.mark.parametrize(
    "page",
    [
        Overlay(menu=glasses_menu("mono")),
        Overlay(title="Keys", lines=HELP),
        Overlay(lines=("30.0 Hz", "age of the picture 21 ms")),
        Overlay(lines=("does each eye see its letter?",), items=(Item("Done", Event("glasses")),)),
        calibration_page(Distance(60), True, True, True),
        Overlay(menu=folder_menu(CONTENT, {})),
    ],
    ids=["menu", "help", "metrics", "test", "calibration", "folder"],
)
def test_notices_and_pages_leave_the_bar_free(size: tuple[int, int], page: Overlay) -> None:
    notices = (Notice("Busy computer: picture quality reduced"),)
    screened = Screened(size, attrs.evolve(page, notices=notices, bar=BAR, scene="still life"))
    screened.move(pygame.MOUSEMOTION, 5, size[1] - 5)
    *others, bar = screened.panels(size, max(TEXT_PX, size[1] // 50))
    top_px = bar.at[1]
    assert {item.event for item, _ in bar.cells} == {item.event for item in BAR}
    small = size == SIZES[0]  # no room for all of them there
    assert small or all(panel.rect.bottom <= top_px for panel in others)
