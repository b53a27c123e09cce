"""Measures a few small views before all of them are packed: how much of them common motion
explains, and whether anything moves between them.
"""

from itertools import product

import attrs
import cv2
import numpy as np

from lfpipe.scene.lightfield import HARDLY_FIT
from lfpipe.scene.optical_flow import (
    SMALLEST_PX,
    FloatMap,
    Grey,
    flow,
    grey_views,
    present_lines,
    returned_flow,
    textured,
    without_shake,
)
from lfpipe.scene.source import GridTransform, SceneSource

# Share of the detail that common motion explains, below which views hardly fit together. Light
# fields, also with wide baselines or held by hand: at least 0.64, the shared and the demo scenes
# 0.85; unrelated pictures: at most 0.21, portraits of several people 0.14 to 0.4.
FITS = 0.3
_FAR = 0.6  # share of a pair's detail that flow finds, below which blocks are matched
_LOOSE_PX, _LOOSE_SHARE = 1.0, 0.2  # tolerance of the flow
_NOTHING_PX = 0.3  # between the farthest views: less motion counts as none
_FEWEST_POINTS = 100  # of detail, to measure motion
# minimum correlation of a matched block, and its lead over the second-best position
_FOUND, _LEADS = 0.75, 0.08
_FEWEST_BLOCKS = 6


@attrs.frozen(kw_only=True)
class Measurements:
    """Measurements of a few small views of a scene."""

    explained: float  # share of the detail that common motion explains
    moved_px: float  # motion between the farthest views, of nearly all of their detail
    far: tuple[float, float] | None = None  # motion that flow misses, in shares of the width


def _moved_px(a: Grey, b: Grey) -> float:
    """Motion of nearly all detail common to two views; infinity if there is too little."""
    ahead, confirmed = returned_flow(a, b)
    detail = textured(a)
    sure = confirmed & detail
    if np.count_nonzero(sure) < max(_FEWEST_POINTS, 0.5 * np.count_nonzero(detail)):
        return np.inf
    return float(np.percentile(np.hypot(*ahead[sure].T), 97))


def _found(a: Grey, b: Grey, y: int, x: int, side: int) -> int | None:
    """The x in b of the block of a at (y, x); None unless the match is unique, and level."""
    top = max(0, y - side // 2)
    strip, block = b[top : y + side + side // 2], a[y : y + side, x : x + side]
    alike = cv2.matchTemplate(strip, block, cv2.TM_CCOEFF_NORMED)
    _, best, _, (across, down) = cv2.minMaxLoc(alike)
    alike[:, max(0, across - side // 2) : across + side // 2 + 1] = -1
    level = abs(top + down - y) <= 2
    return across if level and best > _FOUND and best - float(alike.max()) > _LEADS else None


def _far(a: Grey, b: Grey, ahead: FloatMap) -> tuple[float, float] | None:
    """The range of motion along x, in shares of the width, of blocks of a that are matched in b and
    back, but that the flow misses; None if there are too few.
    """
    height, width = a.shape
    side = min(height, width) // 7
    moves, missed = [], []
    for y, x in product(range(side // 2, height - side, side), range(0, width - side, side)):
        there = _found(a, b, y, x, side) if a[y : y + side, x : x + side].std() > 8 else None
        back = None if there is None else _found(b, a, y, there, side)
        if there is not None and back is not None and abs(back - x) <= 2:
            flowed = float(np.median(ahead[y : y + side, x : x + side, 0]))
            moves.append((there - x) / width)
            missed.append(abs(flowed - (there - x)) > 2)
    if len(moves) < _FEWEST_BLOCKS or np.mean(missed) < 0.5:
        return None
    low, high = np.percentile(moves, (5, 95)).tolist()
    return low, high


def _pair(a: Grey, b: Grey) -> Measurements:
    """As `_triple`, for two views: the share of the detail of one that is found in the other."""
    ahead, confirmed = returned_flow(a, b)
    detail = textured(a)
    explained = float(confirmed[detail].mean()) if detail.any() else 1.0
    return Measurements(
        explained=explained,
        moved_px=_moved_px(a, b),
        far=_far(a, b, ahead) if explained < _FAR else None,
    )


def _triple(before: Grey, middle: Grey, after: Grey) -> float:
    """The share of the middle view's detail that one disparity explains: its motion to the others
    is equal and opposite, and along the line of views.
    """
    detail = textured(middle)
    if not detail.any():
        return 1.0
    to_before, to_after = (flow(middle, other)[detail] for other in (before, after))
    y, x = np.nonzero(detail)
    sideways = np.abs(to_after[:, 0]).mean() >= np.abs(to_after[:, 1]).mean()
    along, beside = (to_after[:, k] for k in ((0, 1) if sideways else (1, 0)))
    off = np.hypot(*(without_shake(x, y, (to_before + to_after)[:, k]) for k in (0, 1)))
    loose = _LOOSE_PX + _LOOSE_SHARE * np.abs(along)
    return float(((off < loose) & (np.abs(without_shake(x, y, beside)) < loose)).mean())


def measure_views(source: SceneSource) -> Measurements | None:
    """Measurements from a few small views; None if there are too few, or they are too small."""
    if min(source.height_px, source.width_px) < SMALLEST_PX:
        return None
    grey = grey_views(source)
    lines = [[grey(*at) for at in line] for line in present_lines(source) if len(line) > 1]
    if not lines:
        return None
    if max(map(len, lines)) == 2:
        pairs = [_pair(*line) for line in lines]
        return Measurements(
            explained=float(np.median([pair.explained for pair in pairs])),
            moved_px=max(pair.moved_px for pair in pairs),
            far=pairs[0].far if len(pairs) == 1 else None,
        )
    shares = [
        _triple(*line[at - 1 : at + 2])
        for line in lines
        for at in {max(1, len(line) // 5), len(line) // 2, min(len(line) - 2, 4 * len(line) // 5)}
        if len(line) > 2
    ]
    return Measurements(
        explained=float(np.median(shares)),
        moved_px=max(_moved_px(line[0], line[-1]) for line in lines),
    )


def plausible(source: SceneSource) -> tuple[SceneSource, Measurements | None]:
    """The source, with a note if its views hardly fit together, and measurements of a few views.
    Pictures without motion between them become one view. A format that defines a light field is
    not measured.
    """
    measured = (
        measure_views(source) if not source.certain or source.rows * source.cols == 2 else None
    )
    if measured is None:
        return source, None
    if measured.far is not None:
        share = max(map(abs, measured.far))
        doubt = (
            f"the views are too far apart ({share:.0%} of the width): no views are made between"
            " them"
        )
        doubts = filter(None, (source.doubt, doubt))
        return attrs.evolve(source, doubt="; ".join(doubts)), measured
    if measured.explained < FITS:
        return attrs.evolve(source, notes=(*source.notes, HARDLY_FIT)), measured
    if measured.moved_px < _NOTHING_PX:
        one = attrs.evolve(
            source,
            rows=1,
            cols=1,
            read=lambda frame, row, col: source.read(frame, *source.middle),
            small=None,
            missing=frozenset(),
            turn=GridTransform(),
            turn_by="there is one view",
            coordinates=None,
            truth={},
            doubt="nothing moves between these pictures: one of them is shown",
        )
        return one, measured
    return source, measured
