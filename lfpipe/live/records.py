"""What travels between the stages of a live light field: frames with all views, disparity of the
views in need, and the viewpoints of the next picture.
"""

from collections.abc import Iterable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import LiveSource
from lfpipe.transport.ring import RingSpec

VIEWS_SLOTS = 5
VIEWS_BYTES = 48 << 20  # of the ring of views, unless its frames are larger
MAX_PAIRS = 4  # of neighbouring views with disparity at a time: two for each eye
MAX_VIEWS = 2 * MAX_PAIRS
# of a step from row to row, on both sides of its middle: a warp fades there (its ROW_FADE), and
# the viewpoint moves on until the next frame
BOTH_ROWS = 0.2

# where the eyes are on the grid when the next picture is displayed, and from the middle of the
# screen: right, up, towards the viewer; zeros without a face
VIEWPOINTS = np.dtype(
    [
        ("left", "<f8", (2,)),
        ("right", "<f8", (2,)),
        ("left_mm", "<f8", (3,)),
        ("right_mm", "<f8", (3,)),
    ]
)

RANGE_PERCENT = (1.0, 99.0)  # of the disparities that count as farthest and nearest
UNCHANGED = np.repeat(np.arange(256, dtype=np.uint8)[:, None], 3, axis=1)

View = tuple[int, int]  # row, column
Pair = tuple[View, View]  # neighbours, the second one right of the first, or below it


def map_size(live: LiveSource) -> tuple[int, int]:
    """(rows, columns) of a disparity map: one value for each 2x2 pixels of a view."""
    return (live.height_px + 1) // 2, (live.width_px + 1) // 2


def disparity_dtype(live: LiveSource) -> np.dtype[np.void]:
    """A record of disparity; the slot header repeats number and stamps of its frame.

    maps: as in `LightField.disparity`, in steps of scale_px; of views, the first `count` rows.
    positions: (row, col) of the left and the right eye, if the first two views were drawn for them,
    else NaN. swapped: whether the left one of two cameras delivers the right view. bend: of
    an `Alignment`, for views of the last column. curves: by
    column, the value on show of each delivered one, BGR.
    """
    return np.dtype(
        [
            ("count", "<i4"),
            ("scale_px", "<f4"),
            ("low_px", "<f4"),
            ("high_px", "<f4"),
            ("bend", "<f8", (6,)),
            ("positions", "<f8", (2, 2)),
            ("swapped", "<i4"),
            ("curves", "u1", (live.cols, 256, 3)),
            ("views", "<i4", (MAX_VIEWS, 2)),
            ("maps", "i1", (MAX_VIEWS, *map_size(live))),
        ]
    )


def disparity_record(
    live: LiveSource, maps: Mapping[View, NDArray[np.int8]], step_px: float
) -> NDArray[np.void]:
    """A record of known maps."""
    record = np.zeros((), disparity_dtype(live))
    sample = np.concatenate([disparity[::4, ::4].ravel() for disparity in maps.values()])
    record["count"] = len(maps)
    record["scale_px"] = step_px
    record["low_px"], record["high_px"] = np.percentile(sample, RANGE_PERCENT) * step_px
    record["positions"] = np.nan
    record["curves"] = UNCHANGED
    for k, (view, disparity) in enumerate(maps.items()):
        record["views"][k], record["maps"][k] = view, disparity
    return record


def live_rings(live: LiveSource) -> dict[str, RingSpec]:
    """The rings of a session with a live light field."""
    width_px, height_px = live.frame_px
    slots = min(max(VIEWS_BYTES // (3 * width_px * height_px), 4), VIEWS_SLOTS)
    return {
        "views": RingSpec((height_px, width_px, 3), np.dtype("u1"), slots),
        "disparity": RingSpec((), disparity_dtype(live), 4),
        "viewpoints": RingSpec((), VIEWPOINTS, 8),
    }


def eye_views(live: LiveSource) -> list[View]:
    """The views that a program draws for both eyes: the first two."""
    return [divmod(eye, live.cols) for eye in (0, 1)]


def cut(
    frame: NDArray[np.uint8], live: LiveSource, view: View, swapped: bool = False
) -> NDArray[np.uint8]:
    """A view in a frame: uint8 (height, width, 3) BGR, a part of it. swapped: as in the
    record of disparity.
    """
    row, col = live.tile((view[0], live.cols - 1 - view[1]) if swapped else view)
    top, left = row * live.height_px, col * live.width_px
    return frame[top : top + live.height_px, left : left + live.width_px]


def pairs_in_need(live: LiveSource, positions: Iterable[tuple[float, float]]) -> list[Pair]:
    """The pairs of neighbours around viewpoints (row, col), along rows, or along the only column;
    at most MAX_PAIRS.
    """
    pairs = {pair: None for position in positions for pair in _around(live, position)}
    return list(pairs)[:MAX_PAIRS]


def views_of(pairs: Iterable[Pair]) -> list[View]:
    """The views of pairs, each once."""
    return list(dict.fromkeys(view for pair in pairs for view in pair))


def _around(live: LiveSource, position: tuple[float, float]) -> Iterator[Pair]:
    row, col = position
    if live.cols == 1:
        top = _below(row, live.rows)
        yield (top, 0), (top + 1, 0)
        return
    left = _below(col, live.cols)
    for at in _rows(row, live.rows):
        yield (at, left), (at, left + 1)


def _below(at: float, count: int) -> int:
    """The first of the two stored views around a viewpoint on an axis."""
    return int(min(max(np.floor(at), 0), max(count - 2, 0)))


def _rows(at: float, count: int) -> list[int]:
    """The row that a warp uses; two where it fades from one to the other."""
    low = _below(at, count)
    if count == 1 or at - low < 0.5 - BOTH_ROWS:
        return [low]
    return [low + 1] if at - low > 0.5 + BOTH_ROWS else [low, low + 1]
