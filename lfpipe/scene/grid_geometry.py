"""Arithmetic on the grid: jitter of the cameras, nearest present view, the sign of truth after a turn."""

import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.source import Turn


def grid_offsets(coordinates: NDArray[np.float64] | None, turn: Turn, rows: int, cols: int) -> NDArray[np.float32]:
    """Offset of each camera from the best regular grid, float32 (rows, cols, 2) in steps (row, col).

    coordinates: float64 (rows, cols, 2) in FILE order, (down, right) in any unit, not finite if unknown; rows, cols are
    canonical. Zeros if there are none or they span no grid.
    """
    out = np.zeros((rows, cols, 2), np.float32)
    if coordinates is None:
        return out
    placed = np.array([[coordinates[turn.file_index(r, c, rows, cols)] for c in range(cols)] for r in range(rows)])
    known = np.isfinite(placed).all(axis=2)
    row, col = np.nonzero(known)
    for axis, count, index in ((0, rows, row), (1, cols, col)):
        if count > 1 and len(np.unique(index)) > 1:
            step, first = np.polyfit(index, placed[row, col, axis], 1)
            if abs(step) > 1e-9:
                out[row, col, axis] = (placed[row, col, axis] - first - step * index) / step
    return np.clip(out, -0.49, 0.49)


def nearest_present(present: NDArray[np.bool_], row: int, col: int) -> tuple[int, int]:
    """The present view closest to (row, col), the first in order among equals."""
    rows, cols = np.nonzero(present)
    best = int(np.argmin((rows - row) ** 2 + (cols - col) ** 2))
    return int(rows[best]), int(cols[best])


def truth_sign(said: Turn | None, used: Turn) -> int:
    """1; -1 if the turn in use is the half-turn of the truth's; 0 if the truth does not hold with it."""
    held = said or Turn()
    if used.transpose != held.transpose:
        return 0
    changed = used.rows != held.rows, used.cols != held.cols
    return {(False, False): 1, (True, True): -1}.get(changed, 0)
