"""A scene on disk as its layout describes it, before it is reordered or packed."""

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
    """Parameters of the capture; None if the source does not state them."""

    baseline_mm: float | None = None
    focus_distance_mm: float | None = None
    focal_length_px: float | None = None  # of a stored view


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
        """The canonical (rows, cols) of a file grid, and vice versa."""
        return (cols, rows) if self.transpose else (rows, cols)


@attrs.frozen(eq=False, kw_only=True)
class SceneSource:
    """A scene on disk as its layout describes it. Rows and columns are in file order."""

    layout: str
    path: Path
    files: tuple[Path, ...]  # every file that `read` and `truth` read, for the content key
    rows: int
    cols: int
    read: Callable[[int, int, int], NDArray[Any]]
    """(frame, row, col) -> a view, (h, w) or (h, w, 3) RGB, uint8 or uint16 up to max_value.
    Thread-safe. Raises UserError that names the file."""
    height_px: int
    width_px: int
    max_value: int = 255
    small: Callable[[int, int, float], NDArray[np.uint8]] | None = None
    """(row, col, px) -> a view in grey, uint8 (h, w), of at least that many px if available; faster
    than `read`"""
    frames: int = 1
    frame_rate_hz: float = 0.0
    telling: int = 0  # the frame that is analysed: the first one may be black
    missing: frozenset[tuple[int, int]] = frozenset()  # grid indices without a view
    turn: GridTransform | None = None
    """to canonical order, if the layout or camera coordinates define it"""
    turn_by: str = ""  # what defines `turn`
    turn_firm: bool = True  # False: clear optical flow overrides `turn`
    coordinates: NDArray[np.float64] | None = None
    """(rows, cols, 2): camera positions, (down, right) in any one unit"""
    truth: Mapping[tuple[int, int], Callable[[], NDArray[np.float32]]] = attrs.field(factory=dict)
    """true disparity by file index: functions that read float32 (h, w), px per canonical grid step,
    positive: nearer. They are valid with `turn`."""
    rendered: bool = False  # views and truth are computed from one picture: no check, no estimate
    geometry: Geometry = attrs.field(factory=Geometry)
    linear: bool = False  # the values are linear light
    doubt: str = ""  # any ambiguity of the layout
    stated_inverted: bool | None = None  # scene.invert_depth in `lightfield.toml`; None: "auto"
    certain: bool = True  # the format defines a light field; False: names or pictures suggest it
    notes: tuple[str, ...] = ()  # for people, one sentence each
    playlist: tuple[Path, ...] = ()  # scenes beside each other, of which this is the first

    @property
    def places(self) -> list[ViewIndex]:
        """The indices of present views, row by row."""
        return [place for place in np.ndindex(self.rows, self.cols) if place not in self.missing]

    @property
    def middle(self) -> ViewIndex:
        """The present view closest to the middle of the grid."""
        return min(
            self.places,
            key=lambda place: abs(place[0] - self.rows // 2) + abs(place[1] - self.cols // 2),
        )


@attrs.frozen
class Layout:
    """A format of light fields. A module that defines these three names is a layout, too."""

    NAME: str  # value of `--layout`
    detect: Callable[[Listing], int | None]
    """Specificity of the match, from names and one picture: 90 for a format that identifies itself,
    50 for a pattern of names, 10 for a last resort; None for no match."""
    describe: Callable[[Listing, config.Scene], SceneSource]
    """The scene, by the user's settings. Raises UserError."""
