"""A scene on disk as its layout describes it, before it is turned or packed."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.scene.files import Listing

Progress = Callable[[str, int, int], None]  # (task, steps done, steps in total)
ViewIndex = tuple[int, int]  # (row, column)


@attrs.frozen
class Geometry:
    """Known facts of the capture; None if the source does not state them.

    focal_length_px is of a stored view.
    """

    baseline_mm: float | None = None
    focus_distance_mm: float | None = None
    focal_length_px: float | None = None


@attrs.frozen
class GridTransform:
    """The transform from file order to canonical order: transpose first, then reverse rows and
    columns.
    """

    rows: bool = False
    cols: bool = False
    transpose: bool = False

    def file_index(self, row: int, col: int, rows: int, cols: int) -> tuple[int, int]:
        """The file index of the canonical view (row, col); rows, cols: the canonical grid."""
        row = rows - 1 - row if self.rows else row
        col = cols - 1 - col if self.cols else col
        return (col, row) if self.transpose else (row, col)

    def applied(self, grid: NDArray[Any]) -> NDArray[Any]:
        """Values by file index, (rows, cols, ...), in canonical order."""
        grid = grid.swapaxes(0, 1) if self.transpose else grid
        return grid[:: -1 if self.rows else 1, :: -1 if self.cols else 1]

    def grid(self, rows: int, cols: int) -> tuple[int, int]:
        """The canonical (rows, cols) of a file grid, and the other way round."""
        return (cols, rows) if self.transpose else (rows, cols)


@attrs.frozen(eq=False, kw_only=True)
class SceneSource:
    """A scene on disk as its layout describes it. Rows and columns here are in FILE order.

    read(frame, row, col): one view, (h, w) or (h, w, 3) RGB, uint8 or uint16 up to max_value; may
    be called from
        several threads; raises UserError that names the file.
    small: one view in grey, uint8 (h, w), from (row, col, px): with at least that many px where it
    has them, quicker than read.
    missing: indices without a view. files: everything that read and truth read from, for the
    content key.
    turn: the way to canonical order where the layout or its coordinates define it, with the reason
    in turn_by; else None.
        turn_firm: False where scenes of this layout with another order exist, so that clear flow
        overrides it.
    coordinates: float64 (rows, cols, 2), where each camera stood, (down, right) in any one unit, or
    None.
    truth: true disparity by file index, as functions that read float32 (h, w) in px per canonical
    grid step, positive
        nearer, and hold with `turn` (no turn where that is None).
    rendered: views and truth are computed from one picture and agree: nothing to check or to
    estimate.
    stated_inverted: what `lightfield.toml` states as scene.invert_depth; None for "auto".
    linear: the values are linear light. doubt: what the layout leaves open, "" for nothing.
    certain: whether the format says that this is a light field; False where names or a look at a
    picture suggest it.
    notes: for people, one sentence each.
    """

    layout: str
    path: Path
    files: tuple[Path, ...]
    rows: int
    cols: int
    read: Callable[[int, int, int], NDArray[Any]]
    height_px: int
    width_px: int
    max_value: int = 255
    small: Callable[[int, int, float], NDArray[np.uint8]] | None = None
    frames: int = 1
    frame_rate_hz: float = 0.0
    missing: frozenset[tuple[int, int]] = frozenset()
    turn: GridTransform | None = None
    turn_by: str = ""
    turn_firm: bool = True
    coordinates: NDArray[np.float64] | None = None
    truth: Mapping[tuple[int, int], Callable[[], NDArray[np.float32]]] = attrs.field(factory=dict)
    rendered: bool = False
    geometry: Geometry = attrs.field(factory=Geometry)
    linear: bool = False
    doubt: str = ""
    stated_inverted: bool | None = None
    certain: bool = True
    notes: tuple[str, ...] = ()

    def __attrs_post_init__(self) -> None:
        """Raises ValueError for a scene without a view or pixels."""
        counts = (self.frames, self.rows, self.cols, self.height_px, self.width_px, self.max_value)
        if min(counts) < 1 or len(self.missing) >= self.rows * self.cols:
            raise ValueError(
                f"{self.frames} frames of {self.rows}x{self.cols} views, {len(self.missing)} of"
                f" them missing, {self.width_px}x{self.height_px} px, values to {self.max_value}"
            )

    @property
    def places(self) -> list[ViewIndex]:
        """Where there is a view, row by row."""
        return [place for place in np.ndindex(self.rows, self.cols) if place not in self.missing]

    @property
    def middle(self) -> ViewIndex:
        """The present view closest to the middle of the grid."""
        return min(
            self.places,
            key=lambda place: abs(place[0] - self.rows // 2) + abs(place[1] - self.cols // 2),
        )

    @property
    def bit_depth(self) -> int:
        """Number of bits of the source's values."""
        return self.max_value.bit_length()


@attrs.frozen
class Layout:
    """One of the formats in which light fields come. A module that defines these three names is a
    layout, too.

    NAME: as `--layout` takes it. detect: how specific the match is, by names (and a glance at one
    picture) alone: 90 for a format that says what it is, 50 for a pattern of names, 10 for a last
    resort; None where it is not this layout. describe: the scene, by the user's settings; raises
    UserError.
    """

    NAME: str
    detect: Callable[[Listing], int | None]
    describe: Callable[[Listing, config.Scene], SceneSource]
