"""The second sequence of a recorded session: the frames of its live light field, in a folder of the
viewer's sequence. Its manifest has the grid: rows, cols, tiles_across and depth, see `LiveSource`.
"""

from pathlib import Path
from typing import Any

from lfpipe.config import LiveSource
from lfpipe.errors import UserError
from lfpipe.files.safe_files import check_links
from lfpipe.files.untrusted import Fields
from lfpipe.sequence.folder import MANIFEST, VIEWS, Sequence, is_sequence, open_sequence
from lfpipe.sequence.packets import COPY

GRID = ("rows", "cols", "tiles_across", "depth")


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
        recorded=True,
    )
