"""Views of a scene on disk, prepared for optical flow, and the lines of the grid to compare."""

import math
from collections.abc import Callable
from functools import lru_cache
from itertools import groupby, product

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.optical_flow import Grey
from lfpipe.scene.source import SceneSource, ViewIndex

_LUMA = np.array([[0.299, 0.587, 0.114]], np.float32)
LOOK_PX = 1 << 17  # of a view, enough to judge order and fit
_DARK = 0.2  # views with a lower mean are brightened


@lru_cache(maxsize=2)
def grey_views(source: SceneSource, most_px: float = math.inf) -> Callable[[int, int], Grey]:
    """Views by file place for optical flow: grey, 8 bit; dark (linear-light) scenes are brightened so that it finds texture.

    Views of more than most_px are reduced.
    """
    scale = min(1.0, math.sqrt(most_px / (source.height_px * source.width_px)))
    size = max(1, round(scale * source.width_px)), max(1, round(scale * source.height_px))

    def share(row: int, col: int) -> NDArray[np.float32]:
        if scale < 1 and source.small is not None:
            grey = cv2.resize(source.small(row, col, most_px), size, interpolation=cv2.INTER_AREA)
            return np.asarray(grey.astype(np.float32) * np.float32(1 / 255), np.float32)
        picture = source.read(0, row, col)
        if scale < 1:
            picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
        plane = picture if picture.ndim == 2 else cv2.transform(picture, _LUMA)
        return np.asarray(np.minimum(plane.astype(np.float32) * np.float32(1 / source.max_value), 1), np.float32)

    there = min(product(range(source.rows), range(source.cols)), key=lambda place: (place in source.missing, -sum(place)))
    lift = 0.5 if float(share(*there).mean()) < _DARK else 1.0

    @lru_cache(maxsize=64)
    def grey(row: int, col: int) -> Grey:
        return np.asarray(np.rint(255 * share(row, col) ** np.float32(lift)), np.uint8)

    return grey


def present_lines(source: SceneSource) -> tuple[list[ViewIndex], list[ViewIndex]]:
    """A row and a column of views that cross near the middle of the grid, without gaps."""

    def lines(row: int, col: int) -> tuple[list[ViewIndex], list[ViewIndex]]:
        return [(row, c) for c in range(source.cols)], [(r, col) for r in range(source.rows)]

    def key(place: ViewIndex) -> tuple[int, int]:
        off = abs(2 * place[0] - source.rows) + abs(2 * place[1] - source.cols)
        return sum(len(source.missing.intersection(line)) for line in lines(*place)), off

    across, down = lines(*min(product(range(source.rows), range(source.cols)), key=key))
    return _longest_part(across, source), _longest_part(down, source)


def _longest_part(line: list[ViewIndex], source: SceneSource) -> list[ViewIndex]:
    """The longest part of a line of views without a gap."""
    parts = [list(group) for there, group in groupby(line, lambda place: place not in source.missing) if there]
    return max(parts, key=len, default=[])
