"""Occlusion of far surfaces by near ones, the only cue in pictures for a grid's depth order."""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.optical_flow import FloatMap, Grey, Mask

UNMISTAKABLE, AGAINST = (
    16,
    10,
)  # agreeing positions required, and how many of them one opposing position cancels
# grey levels between two surfaces; between a surface and the observed view
DIFFERENT, SAME, WRONG = 10, 3, 6
# positions along the shorter side of a view, one vote each; its pixels must agree by this many
SIDE, MAJORITY = 20, 3


def hides(right: int, wrong: int) -> int:
    """1 if near surfaces clearly occlude far ones, -1 for the reverse, 0 if ambiguous.

    right, wrong: counts of positions. Glow, blur and repetition mislead at many positions at once.
    Real light fields: antinous 104 / 1, stillLife 76 / 3, monasroom 57 / 0 and lytro 46 / 2 are
    certain; newshot01 44 / 4, quilt 77 / 42, lego knights 82 / 10, toys 4 / 0, airplane 0 / 2 and
    illum_field 0 / 0 stay ambiguous. Of 170 synthetic, reordered and disturbed sets none is wrong.
    """
    return int(right - AGAINST * wrong >= UNMISTAKABLE) - int(
        wrong - AGAINST * right >= UNMISTAKABLE
    )


def places(
    view: Callable[[int], Grey], count: int, disparity_px: FloatMap, reliable: Mask, sideways: bool
) -> tuple[int, int]:
    """(right, wrong): numbers of positions where two surfaces meet and the outermost views of a
    line show the nearer or the farther one, respectively.

    view(0) .. view(count - 1): the line; disparity_px: of its middle view, float32 (h, w), per
    step; reliable: where it holds.
    """
    here = view(count // 2)
    low, high = np.percentile(disparity_px, (5, 95))
    ends = [end for end in (0, count - 1) if abs(end - count // 2) * (high - low) > 2]
    if not ends:
        return 0, 0
    sharp = _sharpened(disparity_px, here)
    votes = np.zeros(here.shape, np.int32)
    for end in ends:
        votes += _votes(here, sharp, reliable, view(end), end - count // 2, sideways)
    side = max(4, min(here.shape) // SIDE)
    rows, cols = (size // side for size in here.shape)
    sums = votes[: rows * side, : cols * side].reshape(rows, side, cols, side).sum(axis=(1, 3))
    return int(np.count_nonzero(sums >= MAJORITY)), int(np.count_nonzero(sums <= -MAJORITY))


def _sharpened(disparity_px: FloatMap, picture: Grey) -> FloatMap:
    """The map with its edges moved to those of the picture (weighted median), because occlusion
    shows only at edges.
    """
    low, high = (float(v) for v in np.percentile(disparity_px, (0.5, 99.5)))
    steps = np.clip((disparity_px - low) * np.float32(255 / (high - low)), 0, 255).astype(np.uint8)
    sharp = cv2.ximgproc.weightedMedianFilter(picture, steps, 7, sigma=12.0)
    return np.asarray(sharp, np.float32) * np.float32((high - low) / 255) + np.float32(low)


def _votes(
    here: Grey, disparity_px: FloatMap, reliable: Mask, there: Grey, steps: int, sideways: bool
) -> NDArray[np.int32]:
    """Votes by pixel of a view, int32 (h, w): 1 if two surfaces meet in the view `steps` further
    and that view shows the nearer one, -1 if it shows the farther one.
    """
    height, width = here.shape
    far_first = np.argsort(disparity_px, axis=None, kind="stable")
    y, x = np.divmod(far_first, width)
    shift = np.rint(disparity_px.ravel()[far_first] * np.float32(steps)).astype(np.intp)
    x, y = (x - shift, y) if sideways else (x, y - shift)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    landing = (y * width + x)[inside]
    start = far_first[inside]
    # the nearest and the farthest pixel that lands on each one
    front, back = np.full((2, here.size), -1, np.intp)
    front[landing] = start
    back[landing[::-1]] = start[::-1]
    colour = here.ravel().astype(np.float32)
    depth = disparity_px.ravel()
    known = reliable.ravel()
    meet = (
        (front >= 0)
        # px: a surface that lands on another is that much nearer
        & ((depth[front] - depth[back]) * abs(steps) > 1.5)
        & known[front]
        & known[back]
    )
    meet &= np.abs(colour[front] - colour[back]) > DIFFERENT
    front = front[meet]
    back = back[meet]
    seen = there.ravel()[meet]
    front_off, back_off = np.abs(colour[front] - seen), np.abs(colour[back] - seen)
    out = np.zeros(here.size, np.int32)
    np.add.at(out, front, (front_off < SAME) & (back_off > WRONG))
    np.subtract.at(out, front, (back_off < SAME) & (front_off > WRONG))
    return out.reshape(here.shape)
