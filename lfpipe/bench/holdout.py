"""Light fields with views held out, and viewpoints that move among the views."""

import itertools
from collections.abc import Callable, Sequence

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.render.synthesis import Synthesiser
from lfpipe.render.viewpoint import Position
from lfpipe.scene.disparity import estimate_disparity, quantised, scale_for
from lfpipe.scene.lightfield import LightField


def subsample(field: LightField, rows: Sequence[int], cols: Sequence[int]) -> LightField:
    """The views of the first frame at rows x cols, with disparities estimated from these views alone if field has disparities.

    rows, cols: evenly spaced, with the same step on both axes. Raises ValueError if no disparity can be estimated.
    """
    step = next((indices[1] - indices[0] for indices in (cols, rows) if len(indices) > 1), 1)
    part = attrs.evolve(
        field,
        views=np.ascontiguousarray(np.asarray(field.views)[:1, rows][:, :, cols]),
        offsets=np.ascontiguousarray(field.offsets[rows][:, cols]) / np.float32(step),
        present=np.ones((len(rows), len(cols)), bool),
    )
    if field.disparity is None:
        return part
    disparity = estimate_disparity(part.views[0])
    if disparity is None:
        raise ValueError("no disparity can be estimated: one view, or the views are too small")
    known = disparity[~np.isnan(disparity)] if not np.isnan(disparity).all() else np.zeros(1, np.float32)
    low, high = (float(v) for v in np.percentile(known, (0.05, 99.95)))
    scale = scale_for(low, high)
    return attrs.evolve(
        part,
        disparity=quantised(disparity, scale)[None],
        disparity_scale_px=scale,
        disparity_min_px=low,
        disparity_max_px=high,
    )


class ViewRenderer:
    """Renders whole views of a field with one method."""

    def __init__(self, field: LightField, method: str) -> None:
        views = np.asarray(field.views)
        self._synthesiser = Synthesiser(field, method)
        self._planes = [lambda r, c, k=k: views[0, r, c, k] for k in range(field.channels)]
        self._outs = [np.empty((field.height_px, field.width_px), np.uint8) for _ in range(field.channels)]

    def at(self, position: Position) -> NDArray[np.float32]:
        """The view at position (row, col), float32 (channels, height, width)."""
        return np.stack(self.draw(position)).astype(np.float32)

    def draw(self, position: Position) -> list[NDArray[np.uint8]]:
        """The planes of the view at position, uint8 (height, width) each, valid until the next call."""
        return self._synthesiser.render(position, 0, 0.0, self._planes, self._outs)


def viewpoint_walk(field: LightField) -> Callable[[], tuple[Position, Position]]:
    """Returns a function whose calls give viewpoints of the left and right eye, 1.4 views apart, drifting among the middle 3x3
    views of the grid."""
    row_middle, col_middle = (field.rows - 1) / 2, (field.cols - 1) / 2
    phases = itertools.count()

    def step() -> tuple[Position, Position]:
        t = next(phases) * 0.013
        row, col = row_middle + 0.8 * np.sin(1.7 * t), col_middle + 0.3 * np.sin(t)
        return (float(row), float(col - 0.7)), (float(row), float(col + 0.7))

    return step
