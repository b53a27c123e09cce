"""The stored views of a picture and their weights."""

import math
from typing import NamedTuple

Position = tuple[float, float]

# Half the width, in views, of the zone in which warp2 fades from one stored view to the next. Against fading all the way
# (antinous): nothing lost with every 2nd view kept, 0.3 dB with every 4th, largest over median step of a sweep 2.1 instead of
# 2.0, and half as many views to warp on average.
ROW_FADE, COL_FADE = 0.1, 0.25
# best: a share of this much or less counts nothing, from the second on it counts in full. What the fourth view adds where it is
# far away (antinous: 0.1 dB) is not worth its time.
LEAST_SHARE, FULL_SHARE = 0.09, 0.14


class ViewWeight(NamedTuple):
    """A stored view and its share of the picture."""

    row: int
    col: int
    weight: float


def cell_of(position: float, count: int) -> tuple[int, float]:
    """Lower index of the pair of views around position, and the share of the upper one; the outermost pair at the edge."""
    inside = min(max(position, 0.0), count - 1.0)
    low = min(int(inside), max(count - 2, 0))
    return low, inside - low


def _nearest(position: float, count: int) -> int:
    return min(max(math.floor(position + 0.5), 0), count - 1)


def _faded(share: float, half_width: float) -> float:
    return min(max((share - 0.5) / (2 * half_width) + 0.5, 0.0), 1.0)


def view_weights(method: str, position: Position, rows: int, cols: int) -> list[ViewWeight]:
    """The stored views that method uses at position, with weights > 0 that sum to 1 and are continuous in position for
    blend, warp2 and best. position must be finite.

    warp2 fades only around the middle between views, where the nearest view changes; elsewhere it uses one view. Heads move
    sideways, so columns have the wider zone.
    """
    row, col = position
    if method in ("nearest", "warp"):
        return [ViewWeight(_nearest(row, rows), _nearest(col, cols), 1.0)]
    r, up = cell_of(row, rows)
    c, right = cell_of(col, cols)
    if method == "warp2":
        up, right = _faded(up, ROW_FADE), _faded(right, COL_FADE)
    shares = [
        (r, c, (1 - up) * (1 - right)),
        (r, c + 1, (1 - up) * right),
        (r + 1, c, up * (1 - right)),
        (r + 1, c + 1, up * right),
    ]
    views = [ViewWeight(*share) for share in shares if share[2] > 0]
    if method != "best":
        return views
    counts = [view.weight * min((view.weight - LEAST_SHARE) / (FULL_SHARE - LEAST_SHARE), 1.0) for view in views]
    total = sum(count for count in counts if count > 0)
    return [ViewWeight(view.row, view.col, n / total) for view, n in zip(views, counts, strict=True) if n > 0]
