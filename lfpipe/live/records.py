"""What travels between the stages of a live light field: frames with all views, disparity of the
views in need, and the viewpoints of the next picture; and the ring by which another program
delivers one, see docs/contracts.md: views and, if the program knows it, their disparity.
"""

import contextlib
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import LiveSource
from lfpipe.errors import UserError
from lfpipe.host.files import is_held
from lfpipe.transport import ring
from lfpipe.transport.control import LIVE, base_dir
from lfpipe.transport.ring import SECOND_NS, RingSpec, Stamp, now_ns

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


RING = "ring:"  # prefix of its source
SLOTS = 4
MAX_SIDE_PX, MAX_SIDE_VIEWS = 8192, 64


def directory_of(name: str) -> Path:
    """The directory of the scene, whose lock its program holds."""
    return base_dir() / f"{LIVE}{name}"


def scene_of(name: str) -> Path:
    """The ring of the scene."""
    return directory_of(name) / "scene.ring"


def viewpoints_of(name: str) -> Path:
    """The ring with the viewpoints."""
    return directory_of(name) / "viewpoints.ring"


def two_cameras(live: LiveSource) -> bool:
    """Whether the views are those of two cameras, which may be turned: a mosaic of many comes from
    one optical system, and a program's views are exact.
    """
    return live.rows * live.cols == 2 and not live.drawn


def check_name(name: str) -> None:
    """Raises UserError for a name that is none."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_]{0,31}", name):
        raise UserError(
            f"live scene {name!r}: not a valid name",
            "use 1 to 32 letters, digits and _, beginning with a letter or digit",
        )


def scene_dtype(rows: int, cols: int, size_px: tuple[int, int]) -> np.dtype[np.void]:
    """A record of the ring. size_px: (width, height) of a view.

    step_px: of the disparity maps, which are as in `LightField.disparity`; 0 without them.
    positions: (row, col) of both eyes, if the first two views are drawn for them, else NaN.
    """
    width, height = size_px
    return np.dtype(
        [
            ("views", "u1", (rows, cols, height, width, 3)),
            ("step_px", "<f8"),
            ("positions", "<f8", (2, 2)),
            ("maps", "i1", (rows, cols, (height + 1) // 2, (width + 1) // 2)),
        ]
    )


VIEWPOINTS_RING = RingSpec((), VIEWPOINTS, SLOTS)


def attached(name: str) -> tuple[ring.Reader, tuple[int, int], tuple[int, int]]:
    """The ring of a live scene, its (rows, columns), and (width, height) of its views.

    Raises UserError if no program writes it.
    """
    check_name(name)
    remedy = "start the program that draws it"
    try:
        reader = ring.Reader(scene_of(name))
    except FileNotFoundError:
        raise UserError(f"ring:{name}: no such live scene", remedy) from None
    except (UserError, ValueError, LookupError, TypeError):  # written in another language, too
        raise _other_version(name) from None
    shape = dict((reader.dtype.fields or {}).items()).get("views", (np.dtype("u1"),))[0].shape
    if len(shape) == 5 and reader.dtype == scene_dtype(shape[0], shape[1], (shape[3], shape[2])):
        return reader, shape[:2], (shape[3], shape[2])
    reader.close()
    raise _other_version(name)


def _other_version(name: str) -> UserError:
    return UserError(
        f"ring:{name}: its records are not those of this version",
        "use the same version of lfpipe in both programs",
    )


def has_writer(name: str) -> bool:
    """Whether the program that created the ring lives."""
    with contextlib.suppress(OSError):
        return is_held(directory_of(name) / "lock")
    return False


# The program that draws a live scene: its disparity, and the viewpoints that it may draw for.

RETRY_NS = SECOND_NS  # between two tries to find its ring again


class Program:
    """The rings of a live scene, whose program may end and start again."""

    def __init__(self, live: LiveSource) -> None:
        """live: of such a scene."""
        self._live = live
        self._name = live.source.removeprefix(RING)
        self._reader: ring.Reader | None = None
        self._viewpoints: ring.Writer | None = None
        self._tried_ns = 0
        self._attach()

    def _attach(self) -> None:
        self.close()
        self._tried_ns = now_ns()
        with contextlib.suppress(UserError, FileNotFoundError):
            self._reader, grid, size_px = attached(self._name)
            live = self._live
            if (*grid, *size_px) != (live.rows, live.cols, live.width_px, live.height_px):
                self.close()  # it came back with other views, which cannot be shown

    def send_viewpoints(self, at: NDArray[np.void]) -> None:
        """Gives it the viewpoints of the next picture, of dtype VIEWPOINTS."""
        if self._viewpoints is None and self._reader is not None:
            with contextlib.suppress(UserError, FileNotFoundError):
                self._viewpoints = ring.Writer(viewpoints_of(self._name))
        if self._viewpoints is not None:
            self._viewpoints.begin()[...] = at
            self._viewpoints.publish(0, now_ns(), 0)

    def disparity(self, stamp: Stamp, views: Iterable[View]) -> NDArray[np.void] | None:
        """Its disparity of views of a frame; None if it gives none, or what no program means."""
        reader = self._reader
        match = reader.find(stamp.t_sensor_ns) if reader is not None else None
        if reader is None or match is None:
            if now_ns() - self._tried_ns > RETRY_NS:
                self._attach()
            return None
        slot, record = match  # in shared memory
        live = self._live
        step_px, positions = float(record["step_px"]), np.array(record["positions"])
        # NaN is none
        if not 0 < step_px <= live.width_px or (np.abs(positions) > MAX_SIDE_VIEWS).any():
            return None
        if np.isfinite(positions).all():
            views = [divmod(eye, live.cols) for eye in (0, 1)]  # a program draws the first two
        maps = {view: np.array(record["maps"][view]) for view in views}
        disparity = disparity_record(live, maps, step_px)
        disparity["positions"] = positions
        return disparity if reader.still_valid(slot) else None

    def close(self) -> None:
        """Closes the rings."""
        for part in (self._reader, self._viewpoints):
            if part is not None:
                part.close()
        self._reader = self._viewpoints = None
