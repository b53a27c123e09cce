"""The columns of a running number, from the pictures: views that are near in the grid look alike.

For each candidate grid, the difference between some pairs of views is correlated with their
distance in the grid. The grid with the highest correlation wins; if another one comes close, the
result is marked ambiguous.
"""

from collections.abc import Callable, Sequence
from functools import cache
from itertools import combinations
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.source import ViewIndex

_SIDE_PX = 96  # of the small pictures that are compared
_MAX_PICTURES = 64  # to decode
# grid steps over which the difference saturates: short for wide baselines, long for narrow ones
_REACHES = (1.5, 4.0, 12.0, 40.0)
_CLEAR = 0.02  # lead in correlation of a clear grid


@attrs.frozen(kw_only=True)
class Running:
    """How a running number fills a grid: row by row."""

    rows: int
    cols: int
    upwards: int = 0  # for a quilt: tiles in a row; its lowest row is the first
    doubt: str = ""  # what stays ambiguous

    def index(self, position: int) -> ViewIndex:
        """The grid index of a position in the run."""
        if self.upwards:
            row, col = divmod(position, self.upwards)
            position = (self.cols // self.upwards - 1 - row) * self.upwards + col
        return divmod(position, self.cols)


def reduced(picture: NDArray[Any], most_px: float) -> NDArray[Any]:
    """A picture whose longer side is at most that long."""
    scale = min(1.0, most_px / max(picture.shape[:2]))
    return np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def _normalised(picture: NDArray[np.uint8]) -> NDArray[np.float32]:
    """A small copy of a picture, of mean 0 and variance 1, to be compared."""
    small = reduced(picture, _SIDE_PX).astype(np.float32)
    return np.asarray((small - small.mean()) / max(1.0, float(small.std())), np.float32)


def _positions(present: Sequence[bool], tries: Sequence[Running]) -> list[int]:
    """Positions to compare: all of a short run, else some in the middle and, for each candidate,
    those one row below.
    """
    count = len(present)
    if count <= _MAX_PICTURES:
        return [position for position in range(count) if present[position]]
    middle = count // 2
    strides = sorted({run.cols for run in tries if run.rows > 1 and run.cols < count // 2})
    order = [middle + near for near in (0, 1, 2, 3, -1, -2, 4, -3)]
    order += [
        middle + sign * (stride + near) for stride in strides for near in (0, 1) for sign in (1, -1)
    ]
    usable = dict.fromkeys(
        position for position in order if 0 <= position < count and present[position]
    )
    return list(usable)[:_MAX_PICTURES]


def likeliest(
    read: Callable[[int], NDArray[np.uint8]], present: Sequence[bool], tries: Sequence[Running]
) -> tuple[Running, list[Running]]:
    """The candidate that explains the similarity of the pictures best, and those of another shape
    that come close.

    read(position): a view, any size; present: whether there is a view, by position.
    """

    small = cache(lambda position: _normalised(read(position)))
    pairs = np.array(list(combinations(_positions(present, tries), 2)))
    unlike = np.array(
        [
            float(np.abs(small(a) - small(b)).mean()) if small(a).shape == small(b).shape else 2.0
            for a, b in pairs
        ]
    )
    # among equals, the squarest grid
    order = sorted(tries, key=lambda run: abs(run.rows - run.cols))
    score = {run: round(_explained(run, pairs, unlike), 4) for run in order}
    best = max(order, key=score.__getitem__)
    near = [
        run
        for run in sorted(order, key=score.__getitem__, reverse=True)
        if (run.rows, run.cols) != (best.rows, best.cols) and score[run] > score[best] - _CLEAR
    ]
    return best, near


def find_columns(
    read: Callable[[int], NDArray[np.uint8]], present: Sequence[bool], grid: ViewIndex | None = None
) -> Running | None:
    """The grid of a run of views, by the pictures; None if the user's grid does not fit it."""
    count = len(present)
    if grid:
        return Running(rows=grid[0], cols=grid[1]) if grid[0] * grid[1] == count else None
    columns = (count, *(cols for cols in range(2, count // 2 + 1) if count % cols == 0))
    best, near = likeliest(read, present, [Running(rows=count // n, cols=n) for n in columns])
    if not near:
        return best
    # lines are more common than narrow grids
    shown = next((run for run in near if run.rows == 1), best)
    either = " or ".join(f"{r.rows}x{r.cols}" for r in (best, *near) if r != shown)
    doubt = f"the grid: {shown.rows}x{shown.cols}, or {either} (--set scene.grid=ROWSxCOLS)"
    return attrs.evolve(shown, doubt=doubt)


def _explained(run: Running, pairs: NDArray[np.int64], unlike: NDArray[np.float64]) -> float:
    """Correlation of the pictures' difference with distance in the grid; -1 if they are not less
    alike along either side, or if there are too few pairs for a correlation.
    """
    if not len(pairs) or unlike.std() <= 1e-9:
        return -1.0
    place = np.array([[run.index(a), run.index(b)] for a, b in pairs.tolist()], np.float64)
    rows, cols = np.abs(place[:, 0] - place[:, 1]).T
    best = -1.0
    for reach in _REACHES:
        far = [1 - np.exp(-away / reach) for away in (rows, cols, np.hypot(rows, cols))]
        sides = [side for side in far[:2] if side.std() > 1e-9]
        growth = np.linalg.lstsq(np.stack([np.ones_like(unlike), *sides], 1), unlike, rcond=None)[0]
        if sides and growth[1:].min() > 0:
            best = max(best, float(np.corrcoef(far[2], unlike)[0, 1]))
    return best
