"""The test of the glasses: a picture with an L for the left eye and an R for the right one, made like every other picture."""

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Render
from lfpipe.render.anaglyph import MATRICES, encode
from lfpipe.render.compositor import recipe_for

GREY, DARK, LIGHT = 128, 60, 235
FONT = cv2.FONT_HERSHEY_DUPLEX


def eye_picture(letter: str, left: bool, size_px: tuple[int, int]) -> NDArray[np.uint8]:
    """The picture for one eye, uint8 BGR: its letter in its half, on grey, and a frame for both. size_px: (width, height)."""
    width, height = size_px
    picture = np.full((height, width, 3), GREY, np.uint8)
    line = max(2, min(size_px) // 100)
    cv2.rectangle(picture, (line, line), (width - 1 - line, height - 1 - line), (LIGHT,) * 3, line)
    patch = slice(width // 16, width // 2 - width // 32) if left else slice(width // 2 + width // 32, width - width // 16)
    picture[height // 8 : height - height // 8, patch] = DARK
    scale = min(width / 2, height) / 40
    (wide, high), _ = cv2.getTextSize(letter, FONT, scale, line)
    middle_x = (patch.start + patch.stop) // 2
    cv2.putText(picture, letter, (middle_x - wide // 2, (height + high) // 2), FONT, scale, (LIGHT,) * 3, 2 * line, cv2.LINE_AA)
    return picture


class GlassesTest:
    """The test picture under the current render settings, cached until they change. before: the settings at its start."""

    def __init__(self, before: Render | None = None) -> None:
        self._before = before or Render()
        self._for: tuple[Render, tuple[int, int]] | None = None
        self.picture: NDArray[np.uint8] = np.empty((0, 0, 3), np.uint8)
        self.pair: tuple[NDArray[np.uint8], NDArray[np.uint8]] | None = None

    def draw(self, render: Render, size_px: tuple[int, int]) -> bool:
        """Makes `picture`, uint8 (height, width, 3) BGR, and `pair` for modes of two views; returns whether anything changed."""
        if self._for == (render, size_px):
            return False
        self._for = (render, size_px)
        left, right = eye_picture("L", True, size_px), eye_picture("R", False, size_px)
        if render.swap_eyes:
            left, right = right, left
        self.pair = None
        if render.anaglyph in MATRICES:
            self.picture = encode(left, right, recipe_for(render))
        elif render.anaglyph == "mono":
            self.picture = np.maximum(left, right)
        else:
            self.pair = left, right
            half = size_px[0] // 2
            self.picture = left.copy()
            if render.anaglyph == "row-interleaved":
                self.picture[1::2] = right[1::2]
            else:
                self.picture[:, :half] = cv2.resize(left, (half, size_px[1]), interpolation=cv2.INTER_AREA)
                self.picture[:, half:] = cv2.resize(right, (size_px[0] - half, size_px[1]), interpolation=cv2.INTER_AREA)
        return True

    def changed(self, render: Render) -> dict[str, float | bool]:
        """The settings that the person changed during the test, by key of [render]."""
        found: dict[str, float | bool] = {}
        if render.swap_eyes != self._before.swap_eyes:
            found["swap_eyes"] = render.swap_eyes
        if render.ghost_compensation != self._before.ghost_compensation:
            found["ghost_compensation"] = render.ghost_compensation
        return found

    def words(self, render: Render) -> str:
        """Instructions in a few lines."""
        if render.anaglyph == "mono":
            return "glasses test: this mode shows both eyes the same picture; m changes the mode"
        ghost = (
            f"a faint L too? adjust with right and left arrow: compensation {render.ghost_compensation:.0f} %"
            if render.anaglyph in MATRICES
            else ""
        )
        return "\n".join(filter(None, ["close your left eye: you should see only R", ghost, "x swaps the eyes, g ends the test"]))
