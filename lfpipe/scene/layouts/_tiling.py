"""The division of one picture into tiles, one view each."""

from __future__ import annotations

from typing import Any

import attrs
from numpy.typing import NDArray

# Sizes and tiles (columns, rows) of displays whose tiles do not divide the picture: the remainder is at the right and the bottom.
UNEVEN = {(4096, 4096): (5, 9), (8192, 8192): (5, 9)}


@attrs.frozen
class Tiling:
    """Where the tiles of a picture lie: tops and lefts in px, and their common size; what lies between them belongs to none.
    quilt: one row of views from the bottom left tile to the right, then upwards (downwards with `down`)."""

    tops: tuple[int, ...]
    lefts: tuple[int, ...]
    height_px: int
    width_px: int
    quilt: bool = False
    down: bool = False

    @classmethod
    def even(cls, picture: NDArray[Any], rows: int, cols: int, quilt: bool = False) -> Tiling:
        """Tiles of one size without gaps; a remainder at the right and the bottom belongs to none."""
        height, width = picture.shape[0] // rows, picture.shape[1] // cols
        return cls(tuple(height * r for r in range(rows)), tuple(width * c for c in range(cols)), height, width, quilt)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of tiles."""
        return len(self.tops), len(self.lefts)

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of views."""
        return (1, len(self.tops) * len(self.lefts)) if self.quilt else self.shape

    def cut(self, picture: NDArray[Any], row: int, col: int) -> NDArray[Any]:
        """One view."""
        if self.quilt:
            row, col = divmod(col, len(self.lefts))
            row = row if self.down else len(self.tops) - 1 - row
        top, left = self.tops[row], self.lefts[col]
        return picture[top : top + self.height_px, left : left + self.width_px]
