"""The columns of a running number, from the pictures: views that are near in the grid look alike.

For each candidate grid the likeness of some pairs of views is compared with how near the grid places them. The grid
that explains the likenesses best wins; where another one explains them nearly as well, the result says so.
"""

from collections.abc import Callable, Sequence
from functools import cache
from itertools import combinations

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.source import ViewIndex

_SIDE_PX = 96  # of the small pictures that are compared
_MAX_PICTURES = 64  # that are decoded
_REACHES = (
    1.5,
    4.0,
    12.0,
    40.0,
)  # grid steps over which likeness falls off: far cameras differ at once, near ones slowly
_ROW_STEPS = (
    0.6,
    1.0,
    1.7,
)  # of a row step against a column step, as the camera may move farther one way
_SURE, _CLEAR = 0.35, 0.02  # correlation of a sure grid, and its lead on the next one


@attrs.frozen
class Running:
    """How a running number fills a grid: row by row, in a snake every other one backwards. doubt: what is left open."""

    rows: int
    cols: int
    snake: bool = False
    doubt: str = ""

    @property
    def shape(self) -> ViewIndex:
        return self.rows, self.cols

    def index(self, position: int) -> ViewIndex:
        """The grid index of a position of the run."""
        row, col = divmod(position, self.cols)
        return row, self.cols - 1 - col if self.snake and row % 2 else col


def _candidates(count: int, grid: ViewIndex | None) -> list[Running]:
    """Every grid that a run of `count` positions can fill; grid: the user's."""
    shapes = (
        [grid]
        if grid
        else [(1, count), *((count // cols, cols) for cols in range(2, count // 2 + 1))]
    )
    shapes = [(rows, cols) for rows, cols in shapes if rows * cols == count]
    return [Running(*shape) for shape in shapes] + [
        Running(*shape, snake=True) for shape in shapes if min(shape) > 1
    ]


def _positions(present: Sequence[bool], tries: Sequence[Running]) -> list[int]:
    """Positions to compare: all of a short run, else some in the middle and, for each candidate, a row below them."""
    count = len(present)
    if count <= _MAX_PICTURES:
        return [position for position in range(count) if present[position]]
    middle, strides = (
        count // 2,
        sorted({run.cols for run in tries if run.rows > 1 and run.cols < count // 2}),
    )
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
    return list(usable)[:_MAX_PICTURES]


@attrs.frozen
class Likeliest:
    """The candidate that explains the likeness of the pictures best. score: correlation of unlikeness with distance in the grid.
    near: other grids that explain it nearly as well; others: the next ones."""

    run: Running
    score: float
    near: tuple[Running, ...]
    others: tuple[Running, ...]

    @property
    def clear(self) -> bool:
        return self.score >= _SURE and not self.near


def likeliest(
    read: Callable[[int], NDArray[np.uint8]], present: Sequence[bool], tries: Sequence[Running]
) -> Likeliest:
    """The candidate that the pictures speak for. read(position): a view, any size; present: by position, whether there is one."""

    @cache
    def small(position: int) -> NDArray[np.float32]:
        picture = np.asarray(read(position))
        scale = _SIDE_PX / max(picture.shape)
        out = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA).astype(
            np.float32
        )
        return np.asarray((out - out.mean()) / max(1.0, float(out.std())), np.float32)

    pairs = np.array(list(combinations(_positions(present, tries), 2)))
    unlike = np.array(
        [
            np.abs(small(a) - small(b)).mean() if small(a).shape == small(b).shape else 2.0
            for a, b in pairs
        ]
    )
    scores = {run: _explained(run, pairs, unlike) for run in tries}
    order = sorted(
        tries, key=lambda run: (-round(scores[run], 4), abs(run.rows - run.cols), run.snake)
    )
    best, others = order[0], tuple(run for run in order if run.shape != order[0].shape)
    return Likeliest(
        best,
        scores[best],
        tuple(run for run in others if scores[run] > scores[best] - _CLEAR),
        others,
    )


def find_columns(
    read: Callable[[int], NDArray[np.uint8]], present: Sequence[bool], grid: ViewIndex | None = None
) -> Running | None:
    """The grid of a run of views, by the pictures; None where the user's grid fits no part of the run."""
    tries = _candidates(len(present), grid)
    if len(tries) < 2:
        return tries[0] if tries else None
    likely = likeliest(read, present, tries)
    if likely.clear:
        return likely.run
    best = next(
        (run for run in likely.near if run.rows == 1), likely.run
    )  # people more often make lines than narrow grids
    others = dict.fromkeys(
        f"{run.rows}x{run.cols}" for run in (likely.run, *likely.others) if run.shape != best.shape
    )
    either = " or ".join(list(others)[:2])
    doubt = (
        f"the grid: {best.rows}x{best.cols}, or {either} (--set scene.grid=ROWSxCOLS)"
        if others
        else ""
    )
    return attrs.evolve(best, doubt=doubt)


def _explained(run: Running, pairs: NDArray[np.int64], unlike: NDArray[np.float64]) -> float:
    """Correlation of unlikeness with distance in the grid, at the ratio of row and column steps that suits best."""
    if len(pairs) < 3 or unlike.std() <= 1e-9:
        return -1.0
    place = np.array([[run.index(a), run.index(b)] for a, b in pairs.tolist()], np.float64)
    rows, cols = np.abs(place[:, 0] - place[:, 1]).T
    ratios = _ROW_STEPS if min(run.shape) > 1 else (1.0,)
    far = [
        1 - np.exp(-np.hypot(ratio * rows, cols) / reach) for ratio in ratios for reach in _REACHES
    ]
    return max(
        (float(np.corrcoef(distance, unlike)[0, 1]) for distance in far if distance.std() > 1e-9),
        default=-1.0,
    )
