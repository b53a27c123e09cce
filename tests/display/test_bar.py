"""The bar of the window and the question about the glasses: what a click means, at any size of window."""

from collections.abc import Callable

import numpy as np
import pygame
import pytest

from lfpipe.config import choices
from lfpipe.render.bar import ENTRIES, HIGH, Bar
from lfpipe.render.display import KEYS, BarState, Display
from lfpipe.render.glasses_question import KINDS, GlassesQuestion
from tests.display.test_window import becomes, press, pressed, window  # noqa: F401  (fixtures)
from tests.xvfb_screen import Screen

SIZES = [(320, 240), (640, 480), (1920, 1080), (3840, 2160)]


@pytest.fixture(autouse=True)
def fonts() -> None:
    pygame.font.init()


def events(bar: Bar, size: tuple[int, int]) -> set[str]:
    return {bar.press(x, y) for x in range(2, size[0], 5) for y in range(2, size[1], 5)}


@pytest.mark.parametrize("size", SIZES)
def test_every_entry_can_be_clicked_and_the_middle_is_free(size: tuple[int, int]) -> None:
    bar = Bar()
    surface = bar.draw(size, max(22, size[1] // 50), BarState(), None)
    assert surface.get_width() == size[0] and surface.get_height() <= 1.2 * HIGH * size[1]
    found = {event.partition(" ")[0] for event in events(bar, surface.get_size())}
    assert found >= {event for event, _, _ in ENTRIES}


def test_every_entry_has_its_key() -> None:
    keys = {name: key for key, (name, _) in KEYS.items()}
    assert all(keys.get(event, "+ -") == key for event, _, key in ENTRIES)


def test_the_slider_follows_the_pointer_until_it_is_let_go() -> None:
    bar = Bar()
    width, height = bar.draw((1920, 1080), 22, BarState(), None).get_size()
    x, y = next((x, y) for y in range(height) for x in range(width) if bar.press(x, y).startswith("depth "))
    assert bar.press(x, y) == "depth 0.00"
    values = [float(bar.slide(at).split()[1]) for at in range(x, width, 10)]
    assert values == sorted(values) and values[-1] == 1.0
    bar.release()
    assert bar.slide(width // 2) == ""


def test_what_a_session_does_not_have_is_left_out() -> None:
    bar = Bar()
    size = bar.draw((1000, 500), 22, BarState(without=frozenset({"record", "depth"})), None).get_size()
    assert not {event.partition(" ")[0] for event in events(bar, size)} & {"record", "depth"}


@pytest.mark.parametrize("size", SIZES)
def test_each_kind_of_glasses_can_be_clicked(size: tuple[int, int]) -> None:
    question = GlassesQuestion("mono")
    assert KINDS[question.at].anaglyph == "mono" and {kind.anaglyph for kind in KINDS} <= set(choices("render.anaglyph"))
    width, height = question.draw(size).get_size()
    assert width <= size[0] and height <= size[1]
    answers = [question.answer(f"click {x} {height * 3 // 4}") for x in range(0, width, 4)]
    assert list(dict.fromkeys(answer for answer in answers if answer)) == list(KINDS)
    assert question.answer("more") is None and question.answer("enter") == KINDS[0]


def test_the_bar_comes_with_the_mouse_and_a_click_is_a_key(
    window: Callable[..., Display],  # noqa: F811
    screen: Screen,
) -> None:
    display = window((700, 500))
    grey = np.full((500, 700, 3), 90, np.uint8)
    display.show(grey)
    pygame.event.post(pygame.event.Event(pygame.MOUSEMOTION, pos=(350, 200), rel=(1, 1), buttons=(0, 0, 0)))
    assert becomes(lambda: bool((screen.shown()[470:] == 255).any()), display)
    assert (screen.shown()[:350] == 90).all()
    for name in (pygame.MOUSEMOTION, pygame.MOUSEBUTTONDOWN):
        pygame.event.post(pygame.event.Event(name, pos=(12, 440), rel=(1, 1), buttons=(0, 0, 0), button=1))
    assert pressed(display) == ["choose"] and not display.pointer().left
