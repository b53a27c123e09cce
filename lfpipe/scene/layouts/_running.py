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

from lfpipe.scene.layouts._candidates import Candidate, ranked
from lfpipe.scene.source import ViewIndex

_SIDE_PX = 96  # of the small pictures that are compared
MAX_PICTURES = 64  # to decode
# grid steps over which the difference saturates: short for wide baselines, long for narrow ones
_REACHES = (1.5, 4.0, 12.0, 40.0)
_PARAMETERS = 4  # of a grid: its columns, the reach, and a line through the differences
_CLEAR = 0.02  # lead in correlation of a clear grid


@attrs.frozen(kw_only=True)
class Running:
    """How a running number fills a grid: row by row; in a snake, every other row backwards."""

    rows: int
    cols: int
    snake: bool = False
    upwards: int = 0  # for a quilt: tiles in a row; its lowest row is the first
    doubt: str = ""  # what stays ambiguous
    score: float = 0.0  # correlation with the similarity of the pictures, at most 1

    @property
    def shape(self) -> ViewIndex:
        return self.rows, self.cols

    def index(self, position: int) -> ViewIndex:
        """The grid index of a position in the run."""
        if self.upwards:
            row, col = divmod(position, self.upwards)
            position = (self.cols // self.upwards - 1 - row) * self.upwards + col
        row, col = divmod(position, self.cols)
        return row, self.cols - 1 - col if self.snake and row % 2 else col


def reduced(picture: NDArray[Any], most_px: float) -> NDArray[Any]:
    """A picture whose longer side is at most that long."""
    scale = min(1.0, most_px / max(picture.shape[:2]))
    return np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def normalised(picture: NDArray[np.uint8]) -> NDArray[np.float32]:
    """A small copy of a picture, of mean 0 and variance 1, to be compared."""
    small = reduced(picture, _SIDE_PX).astype(np.float32)
    return np.asarray((small - small.mean()) / max(1.0, float(small.std())), np.float32)


def unlikeness(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    """Difference between two normalised pictures; 2 for those of other shapes."""
    return float(np.abs(a - b).mean()) if a.shape == b.shape else 2.0


def _candidates(count: int, grid: ViewIndex | None) -> list[Running]:
    """Every grid that a run of `count` positions can fill; grid: the user's."""
    shapes = (
        [grid]
        if grid
        else [(1, count), *((count // cols, cols) for cols in range(2, count // 2 + 1))]
    )
    shapes = [(rows, cols) for rows, cols in shapes if rows * cols == count]
    snakes = [
        Running(rows=rows, cols=cols, snake=True) for rows, cols in shapes if min(rows, cols) > 1
    ]
    return [Running(rows=rows, cols=cols) for rows, cols in shapes] + snakes


def _positions(present: Sequence[bool], tries: Sequence[Running]) -> list[int]:
    """Positions to compare: all of a short run, else some in the middle and, for each candidate,
    those one row below.
    """
    count = len(present)
    if count <= MAX_PICTURES:
        return [position for position in range(count) if present[position]]
    middle = count // 2
    strides = sorted({run.cols for run in tries if run.rows > 1 and run.cols < count // 2})
    order = [middle + near for near in (0, 1, 2, 3, -1, -2, 4, -3)]
    order += [
        middle + sign * (stride + near) for stride in strides for near in (0, 1) for sign in (1, -1)
    ]
    order += [
        end * stride + near
        for pair in ((-1, 0), (-2, 1))
        for stride in strides
        for end in (1, 3)
        for near in pair
    ]
    usable = dict.fromkeys(
        position for position in order if 0 <= position < count and present[position]
    )
    return list(usable)[:MAX_PICTURES]


@attrs.frozen
class Likeliest:
    """The candidate that explains the similarity of the pictures best."""

    run: Running
    score: float  # correlation of difference with distance in the grid
    near: tuple[Running, ...]  # other grids that explain it nearly as well
    others: tuple[Running, ...]  # all other grids, the best first

    @property
    def clear(self) -> bool:
        return not self.near


def likeliest(
    read: Callable[[int], NDArray[np.uint8]], present: Sequence[bool], tries: Sequence[Running]
) -> Likeliest:
    """The candidate that the pictures support best.

    read(position): a view, any size; present: whether there is a view, by position.
    """

    small = cache(lambda position: normalised(read(position)))
    pairs = np.array(list(combinations(_positions(present, tries), 2)))
    unlike = np.array([unlikeness(small(a), small(b)) for a, b in pairs])
    # among equals, the squarest grid, row by row
    order = ranked(
        f"how {len(present)} views in order fill a grid",
        [
            Candidate(
                what=f"{run.rows}x{run.cols}{', a snake' * run.snake}"
                f"{', upwards' * (run.upwards > 0)}",
                score=round(_explained(run, pairs, unlike), 4),
                value=run,
            )
            for run in sorted(tries, key=lambda run: (abs(run.rows - run.cols), run.snake))
        ],
    )
    best = order[0]
    others = [other for other in order if other.value.shape != best.value.shape]
    return Likeliest(
        best.value,
        best.score,
        tuple(other.value for other in others if other.score > best.score - _CLEAR),
        tuple(other.value for other in others),
    )


def find_columns(
    read: Callable[[int], NDArray[np.uint8]], present: Sequence[bool], grid: ViewIndex | None = None
) -> Running | None:
    """The grid of a run of views, by the pictures; None if the user's grid fits no part of it."""
    tries = _candidates(len(present), grid)
    if not tries:
        return None
    likely = likeliest(read, present, tries)
    if likely.clear:
        return attrs.evolve(likely.run, score=likely.score)
    # lines are more common than narrow grids
    best = next((run for run in likely.near if run.rows == 1), likely.run)
    others = dict.fromkeys(
        f"{run.rows}x{run.cols}" for run in (likely.run, *likely.others) if run.shape != best.shape
    )
    either = " or ".join(list(others)[:2])
    doubt = (
        f"the grid: {best.rows}x{best.cols}, or {either} (--set scene.grid=ROWSxCOLS)"
        if others
        else ""
    )
    return attrs.evolve(best, doubt=doubt, score=likely.score)


def copies(read: Callable[[int], NDArray[np.uint8]], positions: Sequence[int]) -> dict[int, int]:
    """The earlier position with the same picture, by position; {} if there are too many for
    accidental duplicates: then nothing moves.
    """
    first: dict[bytes, int] = {}
    pairs = [
        (position, first.setdefault(read(position).tobytes(), position)) for position in positions
    ]
    again = {late: early for late, early in pairs if late != early}
    return again if 4 * len(again) <= len(positions) else {}


def lay_out(
    read: Callable[[int], NDArray[np.uint8]],
    present: Sequence[bool],
    grid: ViewIndex | None,
    possible_copies: Sequence[int],
) -> tuple[Running | None, dict[int, int], dict[int, int]]:
    """(the grid of a run, as `find_columns`; the new position of each view; the earlier position
    that a view duplicates, by position). Duplicates are dropped; one may replace a view or be
    inserted between views. possible_copies: positions to compare.
    """
    kept = [position for position, there in enumerate(present) if there]
    again = copies(read, possible_copies)
    if not again:
        return find_columns(read, present, grid), {at: at for at in kept}, again
    kept = [position for position in kept if position not in again]
    as_is = {at: at for at in kept}
    moved = {at: at - sum(copy < at for copy in again) for at in kept}
    best: tuple[Running | None, dict[int, int]] = None, as_is
    for places, count in ((moved, len(present) - len(again)), (as_is, len(present))):
        at = {place: position for position, place in places.items()}
        run = find_columns(
            lambda place, at=at: read(at[place]),  # type: ignore[misc]
            [place in at for place in range(count)],
            grid,
        )
        if run is not None and (best[0] is None or run.score > best[0].score + _CLEAR):
            best = run, places
    return *best, again


def _explained(run: Running, pairs: NDArray[np.int64], unlike: NDArray[np.float64]) -> float:
    """Correlation of the pictures' difference with distance in the grid; -1 if they are not less
    alike along either side, or if there are too few pairs for a correlation.
    """
    if len(pairs) <= _PARAMETERS or unlike.std() <= 1e-9:
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
