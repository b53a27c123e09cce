"""What plenoptic cameras have in common: the outer views are dark or empty."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numpy.typing import NDArray

from lfpipe.scene.source import ViewIndex

_DARK_SIDE, _DARK_VIEW = 0.55, 0.4  # brightness over that of the middle view, below which a whole side, a view is left out


def bright_part(
    read: Callable[[int, int], NDArray[Any] | None], rows: int, cols: int
) -> tuple[int, int, int, int, set[ViewIndex]]:
    """(first row, first column, rows, columns, missing places of the part) of the views that got light.

    Removes whole sides, evenly from both ends, while the middle of a side is dark; dark views in the corners
    count as missing. read(row, col): a view, or None where there is none.
    """

    def light(row: int, col: int) -> float:
        view = read(row, col)
        return 0.0 if view is None else float(view[::4, ::4].mean())

    middle = light(rows // 2, cols // 2)
    top = left = 0
    while rows - 2 * top > 2 and min(light(top, cols // 2), light(rows - 1 - top, cols // 2)) < _DARK_SIDE * middle:
        top += 1
    while cols - 2 * left > 2 and min(light(rows // 2, left), light(rows // 2, cols - 1 - left)) < _DARK_SIDE * middle:
        left += 1
    inner_rows, inner_cols = rows - 2 * top, cols - 2 * left
    missing: set[ViewIndex] = set()
    for row in range(inner_rows):
        for col in range(inner_cols):
            # Light falls off towards the corners only: the rest of the grid is not looked at.
            corner = min(row, inner_rows - 1 - row) + min(col, inner_cols - 1 - col) < max(1, min(inner_rows, inner_cols) // 4)
            if corner and light(row + top, col + left) < _DARK_VIEW * middle:
                missing.add((row, col))
    return top, left, inner_rows, inner_cols, missing
