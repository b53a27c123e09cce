"""The ring by which another program delivers a live light field, see docs/contracts.md: views and,
if the program knows it, their disparity; and a ring with the viewpoints of the next picture, by
which it may draw.
"""

import contextlib
import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import LiveSource
from lfpipe.errors import UserError
from lfpipe.host import file_lock
from lfpipe.live.records import VIEWPOINTS, View, disparity_record, eye_views
from lfpipe.transport import ring
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.ring import RingSpec, Stamp
from lfpipe.transport.session import LIVE, base_dir

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


VIEWPOINTS_RING = RingSpec((), VIEWPOINTS, 4)


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
        return file_lock.is_held(directory_of(name) / "lock")
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

    def tell(self, at: NDArray[np.void]) -> None:
        """Gives it the viewpoints of the next picture, of dtype VIEWPOINTS."""
        if self._viewpoints is None and self._reader is not None:
            with contextlib.suppress(UserError, FileNotFoundError):
                self._viewpoints = ring.Writer(viewpoints_of(self._name))
        if self._viewpoints is not None:
            self._viewpoints.begin()[...] = at
            self._viewpoints.publish(0, now_ns(), 0)

    def found(self, stamp: Stamp, views: Iterable[View]) -> NDArray[np.void] | None:
        """Its disparity of views of a frame; None if it gives none, or what no program means."""
        reader = self._reader
        taken = reader.find(stamp.t_sensor_ns) if reader is not None else None
        if reader is None or taken is None:
            if now_ns() - self._tried_ns > RETRY_NS:
                self._attach()
            return None
        slot, record = taken  # in shared memory
        live = self._live
        step_px, positions = float(record["step_px"]), np.array(record["positions"])
        # NaN is none
        if not 0 < step_px <= live.width_px or (np.abs(positions) > MAX_SIDE_VIEWS).any():
            return None
        if np.isfinite(positions).all():
            views = eye_views(live)
        maps = {view: np.array(record["maps"][view]) for view in views}
        found = disparity_record(live, maps, step_px)
        found["positions"] = positions
        return found if reader.still_valid(slot) else None

    def close(self) -> None:
        """Closes the rings."""
        for part in (self._reader, self._viewpoints):
            if part is not None:
                part.close()
        self._reader = self._viewpoints = None
