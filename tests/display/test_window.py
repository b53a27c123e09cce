"""A real window on a real X server."""

import os
import subprocess
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pygame
import pytest

from lfpipe.render.display import HINT, Display, open_display
from lfpipe.render.overlay import EVENTS, HELP, KEYS, Item, Menu, Overlay
from tests.xdnd import drop
from tests.xvfb_screen import Screen, needs_xdotool, outline

WAIT_S = 60.0
GREY = np.full((500, 700, 3), 90, np.uint8)


@pytest.fixture
def window(screen: Screen) -> Iterator[Callable[..., Display]]:
    opened = []

    def make(size: tuple[int, int], spec: str = "window") -> Display:
        opened.append(open_display(spec, size, "lfpipe: a test", 60.0))
        assert becomes(pygame.key.get_focused, opened[-1])
        return opened[-1]

    yield make
    for display in opened:
        display.close()


def becomes(true: Callable[[], bool], display: Display) -> bool:
    """Waits until true, keeping the window alive."""
    until = time.monotonic() + WAIT_S
    while not (done := true()) and time.monotonic() < until:
        display.events()
        time.sleep(0.01)
    return done


def noise(width: int, height: int, seed: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).integers(1, 256, (height, width, 3), np.uint8)


def test_the_screen_shows_each_picture_to_the_bit(
    window: Callable[..., Display], screen: Screen
) -> None:
    display = window((641, 479))
    for seed in (1, 2, 3):
        picture = noise(641, 479, seed)
        before = time.monotonic_ns()
        assert before < display.show(picture) <= time.monotonic_ns()
        assert becomes(lambda picture=picture: np.array_equal(screen.shown(), picture), display)


def test_a_small_picture_is_scaled_up_whole(window: Callable[..., Display], screen: Screen) -> None:
    picture = np.zeros((30, 40, 3), np.uint8)
    picture[:, :20, 2], picture[:15, 20:, 1], picture[15:, 20:, 0] = 200, 150, 100
    display = window((40, 30))
    display.show(picture)
    assert becomes(lambda: screen.shown().shape == (480, 640, 3), display)
    corners = [screen.shown()[place].tolist() for place in ((240, 100), (100, 500), (400, 500))]
    assert corners == [[0, 0, 200], [0, 150, 0], [100, 0, 0]]


def test_lines_stand_at_the_top_and_notices_at_the_bottom_and_go_again(
    window: Callable[..., Display], screen: Screen
) -> None:
    display = window((700, 500))
    display.show(GREY)
    odd = "sc\udce8ne\0"  # names of files that no font has letters for
    for overlay, rest in (
        (Overlay(("30.0 Hz", "age of the picture 21 ms")), slice(200, None)),
        (Overlay(notices=("mode: grey", "paused")), slice(400)),
        (Overlay((odd,), notices=(odd,), progress=0.5), slice(200, 300)),
        (Overlay(menu=Menu("", "a hint", (Item(odd),))), slice(0, 20)),
    ):
        display.overlay(overlay)
        assert becomes(lambda: bool((screen.shown() == 255).any()), display)  # white letters
        display.show(GREY)
        assert becomes(lambda rest=rest: bool((screen.shown()[rest] == 90).all()), display)
        display.overlay(Overlay())
        assert becomes(lambda: np.array_equal(screen.shown(), GREY), display)
    for name in (odd, "bunny"):
        display.title(name)
    assert becomes(lambda: outline("lfpipe: bunny", screen.name) is not None, display)


def test_rows_of_two_views_are_rows_of_the_screen(
    window: Callable[..., Display], screen: Screen
) -> None:
    left, right = (
        np.full((50, 70, 3), colour, np.uint8) for colour in ((10, 20, 200), (220, 120, 30))
    )
    display = window((70, 50))
    display.show(left, (left, right), "row-interleaved")
    assert becomes(lambda: bool((screen.shown()[0] != screen.shown()[1]).any()), display)

    def interleaved() -> bool:
        """Every row is one eye's, once the bar that a mouse over the window brings has gone."""
        shown = screen.picture()
        rows, cols = shown.any(axis=(1, 2)).nonzero()[0], shown.any(axis=(0, 2))
        colours = np.array([((10, 20, 200), (220, 120, 30))[row % 2] for row in rows])
        return len(rows) > 400 and bool((shown[rows][:, cols] == colours[:, None]).all())

    assert becomes(interleaved, display)
    display.show(left, (left, right), "side-by-side")
    assert becomes(lambda: bool((screen.shown()[:, 5] == (10, 20, 200)).all()), display)
    assert (screen.shown()[:, -5] == (220, 120, 30)).all()


def test_what_is_dropped_is_named_and_a_name_that_is_no_text_ends_nothing(
    window: Callable[..., Display], screen: Screen
) -> None:
    display = window((640, 480))
    display.show(noise(640, 480))
    with ThreadPoolExecutor(1) as pool:
        for name, event in (
            (b"/tmp/sc\xe8ne", "load"),
            ("/tmp/a schöne b".encode(), "load /tmp/a schöne b"),
        ):
            dropped = pool.submit(
                drop, Path(os.fsdecode(name)), f"lfpipe: a test ({HINT})", screen.name
            )
            assert pressed(display) == [event]
            dropped.result()


def press(*keys: str) -> None:
    subprocess.run(["xdotool", "key", *keys], check=True)


def pressed(display: Display, count: int = 1) -> list[str]:
    events: list[str] = []
    until = time.monotonic() + WAIT_S
    while len(events) < count and time.monotonic() < until:
        events += display.events()
        time.sleep(0.01)
    return events


@needs_xdotool
def test_every_key_arrives_and_keys_without_meaning_do_not(window: Callable[..., Display]) -> None:
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
    }
    keys |= {
        "bracketleft": "depth-",
        "minus": "alpha-",
        "Left": "less",
        "Right": "more",
        "Tab": "choose",
        "Next": "next",
    }
    keys |= {
        key: event
        for key, event in EVENTS.items()
        if len(key) == 1 and key.isalpha() and key not in "fh"
    }
    press("y", "F5", "Insert", "Escape", *keys)
    assert pressed(display, len(keys)) == list(keys.values())


def test_help_lists_every_key_over_the_picture(
    window: Callable[..., Display], screen: Screen
) -> None:
    display = window((700, 500))
    display.show(GREY)

    def lines() -> int:
        white = (screen.shown() == 255).all(axis=2)
        return int((np.diff(white.any(axis=1).astype(int)) == 1).sum())

    display.overlay(Overlay(HELP))
    assert becomes(lambda: lines() >= len(KEYS), display)


@needs_xdotool
def test_full_screen_keeps_the_aspect_with_black_bars_and_goes_back_with_the_last_picture(
    window: Callable[..., Display], screen: Screen
) -> None:
    colour = (10, 120, 230)
    display = window((640, 640))
    display.show(np.full((640, 640, 3), colour, np.uint8))
    for key, side_px in (("f", 800), ("f", 640), ("F11", 800), ("Escape", 640), ("f", 800)):
        press(key)
        assert pressed(display) == ["fullscreen"]
        assert becomes(
            lambda side_px=side_px: screen.shown().shape == (side_px, side_px, 3), display
        )
    assert (screen.shown() == colour).all()
    assert not screen.picture()[:, :240].any() and not screen.picture()[:, 1040:].any()
