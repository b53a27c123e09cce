"""The viewer's glasses: the question about them (key e, and at the first start), and their
test (key g).
"""

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Render
from lfpipe.render.display.overlay import Event, Item, Menu
from lfpipe.render.synthesis.anaglyph import MATRICES, encode
from lfpipe.render.synthesis.compositor import recipe_for
from lfpipe.render.synthesis.pair_layout import Pair, arrange_stereo_pair

Colour = tuple[int, int, int]
# label, colours of the left and right lens (RGB), value of render.anaglyph
KINDS: tuple[tuple[str, tuple[Colour, Colour] | None, str], ...] = (
    ("red / cyan", ((220, 30, 30), (0, 190, 200)), "dubois"),
    ("green / magenta", ((20, 170, 40), (210, 40, 200)), "dubois-green-magenta"),
    ("amber / blue", ((240, 170, 0), (30, 40, 190)), "dubois-amber-blue"),
    ("3-D television", ((60, 60, 60), (60, 60, 60)), "side-by-side"),
    ("none", None, "mono"),
)
ICON_PX = 480, 240  # width, height: larger than on any screen, so that it is only scaled down
# of the test: both values leave headroom for ghost compensation
GREY, DARK, LIGHT = 128, 60, 235
LETTER_AT = 0.38  # of the height: the middle of the letters
GHOST = "ghost"  # the slider of the test
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
        Item(label, Event("wear", value), picture=_icon(lenses)) for label, lenses, value in KINDS
    )
    at = next((k for k, (_, _, value) in enumerate(KINDS) if value == anaglyph), 0)
    return Menu(
        "Which glasses do you have?",
        "Click, or use the arrows and Enter. Key e asks again.",
        items,
        at,
    )


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


def instructions(render: Render) -> tuple[tuple[str, ...], tuple[Item, ...]]:
    """The lines and choices of the running test."""
    others = Item("Other glasses", Event("which"), "e"), Item("Done", Event("glasses"), "g")
    if render.anaglyph == "mono":
        return ("Glasses test: these colours are the same for both eyes.",), others
    swap = Item("Swap the eyes", Event("swap"), "x")
    if render.anaglyph not in MATRICES:
        return ("Close your left eye: you should see only R.",), (swap, *others)
    lines = (
        "Close your left eye: you should see only R.",
        "A faint L too? Move the slider, or press the right and left arrow:"
        f" {render.ghost_compensation:.0f} %.",
    )
    ghost = Item("Ghost compensation", Event(GHOST), slider=render.ghost_compensation / 100)
    return lines, (swap, ghost, *others)
