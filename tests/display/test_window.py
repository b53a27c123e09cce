"""A real window on a real X server."""

import os
import subprocess
import time
from collections.abc import Callable, Iterator

import numpy as np
import pygame
import pytest

from lfpipe.render.display.display import ACTION_OF, HINT, Display, open_display, parse_display
from tests.support.world import until
from tests.support.xvfb_screen import Screen, needs_xdotool, outline

WAIT_S = 60.0


@pytest.fixture
def window(screen: Screen) -> Iterator[Callable[..., Display]]:
    opened = []

    def make(size: tuple[int, int], spec: str = "window") -> Display:
        opened.append(open_display(parse_display(spec), size, "lfpipe: a test", 60.0))
        assert becomes(pygame.key.get_focused, opened[-1])
        return opened[-1]

    yield make
    for display in opened:
        display.close()


def becomes(true: Callable[..., object], display: Display) -> bool:
    """Waits until true, keeping the window alive."""

    def done() -> object:
        display.events()
        return true()

    return bool(until(done, "such a window", WAIT_S))


def noise(width: int, height: int, seed: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).integers(1, 256, (height, width, 3), np.uint8)


def test_screen_window_shows_each_picture_to_the_bit(
    window: Callable[..., Display], screen: Screen
) -> None:
    display = window((853, 479))
    for seed in (1, 2, 3):
        picture = noise(853, 479, seed)
        before = time.monotonic_ns()
        assert before < display.show(picture) <= time.monotonic_ns()
        assert becomes(lambda picture=picture: np.array_equal(screen.shown(), picture), display)


LEFT, RIGHT = (10, 20, 200), (220, 120, 30)


def interleaved(screen: Screen) -> bool:
    """Whether even rows of the screen are the left eye's and odd ones the right eye's, once the bar
    that a mouse over the window brings has gone.
    """
    shown = screen.picture()
    rows = np.flatnonzero(shown.any(axis=(1, 2)))
    cols = shown.any(axis=(0, 2))
    colours = np.array([(LEFT, RIGHT)[row % 2] for row in rows])
    return len(rows) > 200 and bool((shown[rows][:, cols] == colours[:, None]).all())


@needs_xdotool
def test_screen_window_moved_interleaves_rows_of_the_screen(
    window: Callable[..., Display], screen: Screen
) -> None:
    """Also above the top of the screen. No new picture comes meanwhile."""
    display = window((70, 50))
    left, right = (np.full((50, 70, 3), colour, np.uint8) for colour in (LEFT, RIGHT))
    display.show(left, (left, right), "row-interleaved")
    env = {**os.environ, "DISPLAY": screen.name}
    title = f"lfpipe: a test ({HINT})"
    for place in ("100 101", "100 100", "100 -101", "100 -100"):
        move = ["getwindowfocus", "windowmove", *place.split()]
        subprocess.run(["xdotool", *move], env=env, check=True)
        top = int(place.split()[1])
        assert becomes(
            lambda top=top: (outline(title, screen.name) or (0, None))[1] == top, display
        )
        assert becomes(lambda: interleaved(screen), display), place


def press(*keys: str) -> None:
    subprocess.run(["xdotool", "key", *keys], check=True)


def pressed(display: Display, count: int = 1) -> list[str]:
    events: list[str] = []

    def enough() -> bool:
        events.extend(" ".join(filter(None, (one.name, one.text))) for one in display.events())
        return len(events) >= count

    until(enough, f"{count} events", WAIT_S)
    return events


@needs_xdotool
def test_screen_window_keys(window: Callable[..., Display]) -> None:
    display = window((640, 480))
    display.show(noise(640, 480))
    keys = {
        "h": "help",
        "question": "help",
        "plus": "alpha+",
        "KP_Add": "alpha+",
        "equal": "alpha+",
        "C": "recentre",
        "bracketright": "depth+",
        "space": "freeze",
        "bracketleft": "depth-",
        "minus": "alpha-",
        "Left": "less",
        "Right": "more",
        "Tab": "choose",
        "Next": "next",
        **{
            key: event
            for key, event in ACTION_OF.items()
            if len(key) == 1 and key.isalpha() and key not in "fh"
        },
    }
    press("y", "F5", "Insert", "Escape", *keys)
    assert pressed(display, len(keys)) == list(keys.values())


@needs_xdotool
def test_screen_window_full_screen_keeps_the_aspect(
    window: Callable[..., Display], screen: Screen
) -> None:
    colour = (10, 120, 230)
    display = window((640, 640))
    display.show(np.full((640, 640, 3), colour, np.uint8))
    for key, side_px in (("f", 800), ("f", 680), ("F11", 800), ("Escape", 680), ("f", 800)):
        press(key)
        assert pressed(display) == ["fullscreen"]
        assert becomes(
            lambda side_px=side_px: screen.shown().shape == (side_px, side_px, 3), display
        )
    assert (screen.shown() == colour).all()
    assert not screen.picture()[:, :240].any() and not screen.picture()[:, 1040:].any()


def _mouse(kind: int, at: tuple[int, int], button: int = 1) -> None:
    pygame.event.post(
        pygame.event.Event(kind, pos=at, rel=(1, 1), buttons=(0, 0, 0), button=button)
    )


def test_screen_window_wheel_zooms_a_drag_pans_and_a_double_click_resets(
    window: Callable[..., Display], screen: Screen
) -> None:
    display = window((853, 426))
    halves = np.full((426, 853, 3), 40, np.uint8)
    halves[:, 427:] = 90
    display.show(halves)
    width_mm = display.width_mm()
    assert width_mm is not None

    def light() -> float:
        return float((screen.shown() == 90).all(axis=2).mean())

    assert becomes(lambda: abs(light() - 0.5) < 0.01, display)
    _mouse(pygame.MOUSEMOTION, (213, 213))
    pygame.event.post(pygame.event.Event(pygame.MOUSEWHEEL, y=4, x=0))
    # a quarter of the width from the left edge stays where it is
    assert becomes(lambda: abs(light() - (1 - 0.25 - 0.25 * 1.2**4)) < 0.01, display)
    larger_mm = display.width_mm()
    assert larger_mm is not None and abs(larger_mm / width_mm - 1.2**4) < 0.01
    assert display.pointer.wheel == 0, "no distance"
    _mouse(pygame.MOUSEBUTTONDOWN, (640, 213))
    _mouse(pygame.MOUSEMOTION, (320, 213))
    _mouse(pygame.MOUSEBUTTONUP, (320, 213))
    assert becomes(lambda: light() > 0.55, display) and not display.pointer.left
    for _ in range(2):
        _mouse(pygame.MOUSEBUTTONDOWN, (320, 213))
        _mouse(pygame.MOUSEBUTTONUP, (320, 213))
    assert becomes(lambda: abs(light() - 0.5) < 0.01, display)
