"""The overlay of the window: what keys, clicks and touches on it mean, at any size of window."""

import math
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import attrs
import numpy as np
import pygame
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.render.display.display import NO_EVENT, Event, Item, Menu, Notice, Overlay
from lfpipe.render.display.window import TEXT_PX
from lfpipe.render.ui.calibration import Distance, calibration_page
from lfpipe.render.ui.keys import ACTION_OF, DEPTH, HELP, KEYS, bar_items
from lfpipe.render.ui.look import NO_HIGHLIGHT
from lfpipe.render.ui.overlay_view import (
    BAR_S,
    EDGE_PX,
    ItemPanel,
    OverlayView,
    bar_panel,
    menu_panel,
)
from lfpipe.render.ui.pages import glasses_menu
from lfpipe.render.ui.scenes import Content, folder_menu
from tests.display.test_window import GREY, becomes, pressed, window  # noqa: F401  (fixture)
from tests.support.examples import examples

SIZES = [(320, 240), (640, 480), (1920, 1080), (3840, 2160)]
BAR = bar_items(0.0, False, False)
CONTENT = Content(Path("/home"), ["views"], ["film.mp4"], 25)
WITH_BUTTON = Notice("A face", (Item("Use it", Event("x")),))
TURNS = Item("◀", Event("previous")), Item("▶", Event("next"))
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

    def draw(self) -> ItemPanel:
        return next(
            panel for panel in self.panels(self.size, max(22, self.size[1] // 50)) if panel.cells
        )

    @property
    def bar_top_px(self) -> int:
        return bar_panel(BAR, NO_HIGHLIGHT, self.size, max(22, self.size[1] // 50)).top_px

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
    assert bar.bottom_px == size[1] - EDGE_PX and abs(2 * bar.at[0] + width - size[0]) <= 1
    # the smallest window needs two rows
    assert width < size[0] and height <= (0.47 if size == SIZES[0] else 0.14) * size[1]
    assert {event and event.name for event in screened.clicked()} == {
        None,
        *(item.event.name for item in BAR),
    }


def test_bar_items_show_their_keys() -> None:
    assert all(ACTION_OF[item.key] == item.event.name for item in BAR if item.slider is None)
    assert len(ACTION_OF) == sum(len(row.keys.split()) for row in KEYS), "no key twice"


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


def test_bar_entry_that_the_session_lacks_does_nothing() -> None:
    screened = Screened(
        (1920, 1080), Overlay(bar=bar_items(0.0, False, False, (("record", "no camera"),)))
    )
    bar = screened.draw()
    by_name = {item.event.name: rect.move(bar.at).center for item, rect in bar.cells}
    assert screened.click(*by_name["record"]) == NO_EVENT
    assert screened.click(*by_name["screenshot"]) == Event("screenshot")


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
    assert small or all(panel.bottom_px <= top_px for panel in others)


@pytest.mark.parametrize("size", [(640, 480), (512, 512), (800, 600), (1280, 800)])
def test_help_shows_every_key_above_the_bar(size: tuple[int, int]) -> None:
    screened = Screened(size, Overlay(title="Keys", lines=HELP, bar=BAR))
    panel = screened.draw()
    area = pygame.Rect(0, 0, size[0], screened.bar_top_px)
    assert area.contains(panel.surface.get_rect(topleft=panel.at))


SOURCES = {"white": 255, "black": 0, "noise": None}


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("lit", [False, True])
def test_letters_contrast_with_any_picture(source: str, lit: bool) -> None:
    """At least 4.5 : 1 between the lightest and the usual luminance of each panel."""
    size = (1280, 800)
    picture = np.full((*size[::-1], 3), SOURCES[source] or 0, np.uint8)
    if source == "noise":
        picture = np.random.default_rng(1).integers(0, 256, picture.shape).astype(np.uint8)
    for overlay in (
        Overlay(
            title="Keys", lines=HELP, bar=BAR, scene="still life", step="measuring depth, 40 %"
        ),
        Overlay(
            menu=glasses_menu("mono"),
            bar=BAR,
            notices=(Notice("Camera lost"), Notice("A face", (Item("Use it", Event("x")),))),
        ),
        Overlay(lines=("a line",), items=(Item("Done", Event("glasses"), "g"),), bar=BAR),
        attrs.evolve(calibration_page(Distance(60), True, True, False), bar=BAR),
        Overlay(menu=folder_menu(CONTENT, {}), bar=BAR),
    ):
        screened = Screened(size, overlay)
        panels = screened.panels(size, TEXT_PX)
        for panel in panels:
            for _, rect in panel.cells[: 1 if lit else 0]:
                screened.move(pygame.MOUSEBUTTONDOWN, *rect.move(panel.at).center)
        screen = pygame.image.frombuffer(picture.tobytes(), size, "RGB")
        shown = screened.panels(size, TEXT_PX)
        screen.blits([(panel.surface, panel.at) for panel in shown])
        pixels = np.asarray(pygame.surfarray.array3d(screen), float) / 255
        linear = np.where(pixels <= 0.04045, pixels / 12.92, ((pixels + 0.055) / 1.055) ** 2.4)
        light = linear @ (0.2126, 0.7152, 0.0722)
        for panel in shown:
            left, top = panel.at
            width, height = panel.surface.get_size()
            inside = light[left + 9 : left + width - 9, top + 9 : top + height - 9]
            back = np.quantile(inside, 0.75)  # letters cover less
            assert (inside.max() + 0.05) / (back + 0.05) >= 4.5


def test_bar_goes_by_itself_but_not_while_the_slider_is_held(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    screened = Screened((1920, 1080), Overlay(bar=BAR))
    _, rect = next(cell for cell in screened.draw().cells if cell[0].event.name == DEPTH)
    rect = rect.move(screened.draw().at)
    y = rect.centery
    values = [screened.move(pygame.MOUSEBUTTONDOWN, rect.left + 1, y)]
    monkeypatch.setattr("time.monotonic", lambda now=pygame.time.get_ticks: 1e9 + now())
    assert screened.draw(), "held"
    values += [screened.move(pygame.MOUSEMOTION, x, y) for x in range(rect.left, 1920, 10)]
    numbers = [event.value for event in values if event is not None and event.name == DEPTH]
    assert (
        len(numbers) == len(values)
        and numbers == sorted(numbers)
        and numbers[0] == 0.0
        and numbers[-1] == 1.0
    )
    assert screened.move(pygame.MOUSEBUTTONUP, 0, 0) is None
    monkeypatch.setattr("time.monotonic", lambda: 1e12)
    assert screened.panels((1920, 1080), 22) == []


def test_entry_under_a_resting_pointer_is_lit_when_the_bar_comes() -> None:
    size = (1280, 800)
    screened = Screened(size, Overlay(bar=BAR))
    bar = screened.draw()
    _, rect = next(cell for cell in bar.cells if cell[0].event.name == "record")
    screened._bar_from_s = math.inf
    screened.panels(size, 22)
    screened._over = None
    screened.move(pygame.MOUSEMOTION, *rect.move(bar.at).center)
    screened.panels(size, 22)
    assert screened._lit.event == Event("record")


def test_bar_stays_under_the_pointer_and_goes_when_it_leaves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    screened = Screened((1280, 800), Overlay(bar=BAR))
    _, rect = next(cell for cell in screened.draw().cells if cell[0].event.name == "record")
    place = rect.move(screened.draw().at).center
    screened.move(pygame.MOUSEMOTION, *place)
    clock = iter(range(10**9, 10**10))
    monkeypatch.setattr("time.monotonic", lambda: next(clock))  # a second at each look
    for _ in range(60):
        assert screened.draw(), "a click there is for an entry"
    assert screened.click(*place) == Event("record")
    screened.move(pygame.MOUSEMOTION, 5, 5)
    for _ in range(round(BAR_S) + 1):
        next(clock)
    assert not screened.panels((1280, 800), 22)


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
    st.lists(st.sampled_from(ARROWS), max_size=30),
)
def test_menu_shows_the_selected_item(count: int, size: tuple[int, int], keys: list[str]) -> None:
    items = tuple(
        Item(f"scene {k}", Event("load", f"/{k}"), picture=np.zeros((6, 8, 3), np.uint8))
        for k in range(count)
    )
    screened = Screened(size, Overlay(menu=Menu("", items, count // 2)))
    for key in keys:
        assert screened.key(key) is None
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


def test_tile_shows_both_ends_of_a_long_name() -> None:
    def drawn(name: str) -> bytes:
        tiles = Menu("title", (Item(name, Event("load", name), icon="file"),), 0)
        return bytes(pygame.image.tobytes(menu_panel(tiles, 0, (640, 480), 14).surface, "RGB"))

    stem = "IMG_20260101_120000_" + "burst_" * 60
    first, other, late = drawn(f"{stem}a.jpg"), drawn(f"{stem}b.jpg"), drawn(f"J{stem}a.jpg")
    assert len({first, other, late}) == 3
