"""The second sequence of a recorded session: the frames of its live light field, in a folder of the
viewer's sequence. Its manifest has the grid: rows, cols, and tiles_across, see `LiveSource`.
"""

from pathlib import Path
from typing import Any

from lfpipe.config import LiveSource
from lfpipe.errors import UserError
from lfpipe.files.untrusted import Fields
from lfpipe.sequence.folder import MANIFEST, VIEWS, Sequence, is_sequence, open_sequence
from lfpipe.sequence.packets import COPY


def about_grid(live: LiveSource) -> dict[str, Any]:
    """What the manifest says of the grid."""
    grid = {"rows": live.rows, "cols": live.cols, "tiles_across": live.tiles_across}
    return {VIEWS: grid}


def open_views(recording: Path, verify: bool = True) -> tuple[Sequence, LiveSource] | None:
    """The views of a recording, and how they lie in a frame; None if it has none.

    Raises UserError as `open_sequence`, and for a wrong grid.
    """
    folder = recording / VIEWS
    if not is_sequence(folder):
        return None
    sequence = open_sequence(folder, verify)
    width_px, height_px = sequence.size_px
    where = str(folder / MANIFEST)
    grid = Fields(sequence.manifest, where, COPY).table(VIEWS)
    cols = grid.integer("cols", 1, width_px)
    rows = grid.integer("rows", 1, height_px)
    across = grid.integer("tiles_across", 1, rows * cols)
    down, rest = divmod(rows * cols, across)
    if rest or rows * cols < 2 or width_px % across or height_px % down:
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
        recorded=True,
    )
