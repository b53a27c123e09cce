"""A live scene that a program draws."""

import contextlib
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfpipe.api.scenes import ArrayLike, Closing, typed
from lfpipe.errors import UserError
from lfpipe.live.records import (
    MAX_SIDE_PX,
    MAX_SIDE_VIEWS,
    SLOTS,
    VIEWPOINTS,
    VIEWPOINTS_RING,
    check_name,
    directory_of,
    scene_dtype,
    scene_of,
    viewpoints_of,
)
from lfpipe.scene.disparity import quantised, scale_for
from lfpipe.supervisor import rundir
from lfpipe.transport import ring
from lfpipe.transport.ring import RingSpec, now_ns


class Viewpoints(NamedTuple):
    """Where the eyes will be when the next picture is displayed."""

    left: tuple[float, float]
    """(row, column) on the grid of views, fractional."""
    right: tuple[float, float]
    left_mm: tuple[float, float, float]
    """From the neutral place: right, up, and the distance from the screen, mm; zeros without a
    face."""
    right_mm: tuple[float, float, float]


class LiveScene(Closing):
    """A light field that this program draws, frame by frame, for `lfpipe up live:ring:NAME`.

    Parameters
    ----------
    name : str
        1 to 32 letters, digits and _.
    rows, cols : int
        The grid of views: row 0 is the top camera, column 0 the left one.
    size_px : tuple of int
        (width, height) of a view.

    Raises
    ------
    UserError
        If the name is not valid or in use, a number is out of range, or shared memory is short.

    Examples
    --------
    >>> import numpy as np
    >>> with LiveScene("grey", rows=1, cols=2, size_px=(64, 48)) as scene:
    ...     scene.write(np.full((1, 2, 48, 64, 3), 128, np.uint8))
    """

    @typed
    def __init__(
        self,
        name: str,
        *,
        rows: int,
        cols: int,
        size_px: tuple[int, int],
    ) -> None:
        check_name(name)
        _check_range("rows", rows, MAX_SIDE_VIEWS)
        _check_range("cols", cols, MAX_SIDE_VIEWS)
        for what, value in zip(("width", "height"), size_px, strict=True):
            _check_range(f"size_px {what}", value, MAX_SIDE_PX)
        if rows * cols < 2:
            raise UserError("rows 1, cols 1: one view has no parallax", "use two views or more")
        self.name = name
        self._shape = rows, cols, size_px[1], size_px[0], 3
        in_use = UserError(
            f"live scene {name!r} is in use", "end the other program, or use another name"
        )
        with contextlib.ExitStack() as parts:
            lock = rundir.acquire_directory(directory_of(name), in_use)
            parts.callback(rundir.remove, directory_of(name), lock)
            spec = RingSpec((), scene_dtype(rows, cols, size_px), SLOTS)
            ring.create(scene_of(name), spec).close()
            ring.create(viewpoints_of(name), VIEWPOINTS_RING).close()
            self._writer = parts.enter_context(contextlib.closing(ring.Writer(scene_of(name))))
            reader = ring.Reader(viewpoints_of(name))
            self._viewpoints = parts.enter_context(contextlib.closing(reader))
            self._parts = parts.pop_all()
        self._at = np.zeros((), VIEWPOINTS)
        self._count = 0

    def write(
        self,
        views: ArrayLike,
        disparity: ArrayLike | None = None,
        positions: ArrayLike | None = None,
        t_ns: int | None = None,
    ) -> None:
        """Publishes a frame: all views of the grid, or one for each eye.

        Parameters
        ----------
        views : array_like of uint8
            (rows, cols, height, width, 3), BGR; with positions, (2, height, width, 3).
        disparity : array_like of float, optional
            (rows, cols, (height + 1) // 2, (width + 1) // 2), px per view, one value for each 2x2
            pixels; positive is nearer than the screen. A point at (x, y) in view (r, c) appears at
            (x - d * (c' - c), y - d * (r' - r)) in view (r', c'). Measured if None. With positions,
            it is needed, and has the first axis of views.
        positions : array_like of float, optional
            (2, 2): (row, col) of the grid from which the views of the left and of the right eye
            were drawn, usually those of `wanted`. Each view is moved by what the eye has moved
            since.
        t_ns : int, optional
            Time that the frame shows, CLOCK_MONOTONIC ns; now if None.

        Raises
        ------
        UserError
            For another shape or type, or disparity that is not finite.
        """
        rows, cols, height, width, _ = self._shape
        grid = (rows, cols) if positions is None else (2,)
        picture = np.asarray(views)
        if picture.shape != (*grid, height, width, 3) or picture.dtype != np.uint8:
            raise UserError(
                f"views: {picture.dtype} {picture.shape}",
                f"give uint8 of shape {(*grid, height, width, 3)}",
            )
        step_px, maps = self._steps(disparity, grid)
        drawn = np.full((2, 2), np.nan) if positions is None else np.asarray(positions, float)
        if drawn.shape != (2, 2) or (positions is not None and not np.isfinite(drawn).all()):
            raise UserError(
                f"positions {positions!r}: not (row, col) of both eyes",
                "give those of scene.wanted()",
            )
        if positions is not None and maps is None:
            raise UserError("positions without disparity", "give the disparity of both views")
        count = math.prod(grid)
        record = self._writer.begin()
        record["views"].reshape(-1, height, width, 3)[:count] = picture.reshape(
            -1, height, width, 3
        )
        record["step_px"] = step_px
        record["positions"] = drawn
        if maps is not None:
            size = maps.shape[-2:]
            record["maps"].reshape(-1, *size)[:count] = maps.reshape(-1, *size)
        self._count += 1
        stamp_ns = now_ns() if t_ns is None else t_ns
        self._writer.publish(self._count, stamp_ns, stamp_ns)

    def _steps(
        self, disparity: ArrayLike | None, grid: tuple[int, ...]
    ) -> tuple[float, NDArray[np.int8] | None]:
        if disparity is None:
            return 0.0, None
        shape = (*grid, (self._shape[2] + 1) // 2, (self._shape[3] + 1) // 2)
        maps = np.asarray(disparity, np.float32)
        if maps.shape != shape:
            raise UserError(f"disparity of shape {maps.shape}", f"give {shape}")
        if not np.isfinite(maps).all():
            raise UserError(
                "disparity contains values that are no numbers", "give numbers, or None"
            )
        step_px = scale_for(float(maps.min()), float(maps.max()))
        return step_px, quantised(maps, step_px)

    def wanted(self) -> Viewpoints | None:
        """The viewpoints of the next picture: `Viewpoints`, or None while no session shows the
        scene.
        """
        if self._viewpoints.published:
            self._viewpoints.read(self._at)
            return Viewpoints(*(tuple(self._at[name].tolist()) for name in Viewpoints._fields))
        return None

    def close(self) -> None:
        """Ends the scene; a session that shows it keeps the last picture."""
        self._parts.close()


def _check_range(what: str, value: int, most: int) -> None:
    if not 1 <= value <= most:
        raise UserError(f"{what} {value}: not a number from 1 to {most}", f"use 1 to {most}")
