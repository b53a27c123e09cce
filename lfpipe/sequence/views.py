"""The second sequence of a recorded session: the frames of its live light field, in a folder of the
viewer's sequence. Its manifest has the grid: rows, cols, tiles_across, depth and drawn, see
`LiveSource`. Of a scene that a program draws, a packet also has what that knew of its frame.
"""

import struct
import zlib
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import LiveSource
from lfpipe.errors import UserError
from lfpipe.files.safe_files import check_links
from lfpipe.files.untrusted import Fields
from lfpipe.sequence.folder import MANIFEST, VIEWS, Sequence, is_sequence, open_sequence
from lfpipe.sequence.packets import COPY, REPAIR, scene_parts

GRID = ("rows", "cols", "tiles_across", "depth", "drawn")
_KNOWN = struct.Struct("<5d")  # step_px, positions


@attrs.frozen(eq=False)
class Known:
    """What the program that draws a live scene knows of a frame."""

    step_px: float
    """Of the maps; 0 without them."""
    positions: NDArray[np.float64]
    """(2, 2): (row, col) of both eyes, if the first two views were drawn for them; else NaN."""
    maps: NDArray[np.int8]
    """(views, height, width), as in `LightField.disparity`, row by row."""

    @property
    def of_eyes(self) -> bool:
        """Whether the first two views were drawn for the eyes, and no other one."""
        return bool(np.isfinite(self.positions).all())

    def packed(self) -> bytes:
        """For a packet, see `of`."""
        maps = self.maps[:2] if self.of_eyes else self.maps
        return _KNOWN.pack(self.step_px, *self.positions.ravel()) + maps.tobytes()

    @classmethod
    def of(cls, sequence: Sequence, live: LiveSource, index: int) -> "Known | None":
        """That of a stored frame; None if the program gave nothing. live: of `open_views`.

        Raises UserError if it is damaged.
        """
        if sequence.packets[index].codec != "scene":
            return None
        _, compressed = scene_parts(sequence.data(index))
        height, width = (live.height_px + 1) // 2, (live.width_px + 1) // 2
        views = live.rows * live.cols
        most = _KNOWN.size + views * height * width + 1
        try:
            packed = zlib.decompressobj().decompress(compressed, most)
            step_px, *at = _KNOWN.unpack_from(packed)
            positions = np.reshape(at, (2, 2))
            views = 2 if np.isfinite(positions).all() else views
            maps = np.frombuffer(packed, np.int8, offset=_KNOWN.size).reshape(views, height, width)
        except (struct.error, zlib.error, ValueError):
            raise UserError(
                f"{sequence.path}: frame {index}: has not the disparity of its {views} views",
                REPAIR,
            ) from None
        return cls(step_px, positions, maps)


def about_grid(live: LiveSource) -> dict[str, Any]:
    """What the manifest says of the grid."""
    return {VIEWS: {name: getattr(live, name) for name in GRID}}


def open_views(recording: Path, verify: bool = True) -> tuple[Sequence, LiveSource] | None:
    """The views of a recording, and how they lie in a frame; None if it has none.

    Raises UserError as `open_sequence`, and for a wrong grid.
    """
    folder = recording / VIEWS
    check_links(recording, [f"{VIEWS}/{MANIFEST}"])
    if not is_sequence(folder):
        return None
    sequence = open_sequence(folder, verify)
    width_px, height_px = sequence.size_px
    where = str(folder / MANIFEST)
    grid = Fields(sequence.manifest, where, COPY).table(VIEWS)
    cols = grid.integer("cols", 1, width_px)
    rows = grid.integer("rows", 1, height_px)
    across = grid.integer("tiles_across", 1, rows * cols)
    depth = grid.flag("depth")
    drawn = "drawn" in grid.values and grid.flag("drawn")  # not in the first recordings
    down, rest = divmod(rows * cols, across)
    if (
        rest
        or rows * cols < 2
        or width_px % across
        or height_px % down
        or (depth and (rows, cols) != (1, 2))
    ):
        raise UserError(
            f"{where}: {rows}x{cols} views, {across} across, do not divide a frame of"
            f" {width_px}x{height_px} px",
            COPY,
        )
    return sequence, LiveSource(
        source=str(folder.resolve()),
        rows=rows,
        cols=cols,
        tiles_across=across,
        frame_px=sequence.size_px,
        depth=depth,
        drawn=drawn,
        recorded=True,
    )
