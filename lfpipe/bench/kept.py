"""Light fields with views left out, and a viewer who walks among them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.render.synthesis import Position, Synthesiser
from lfpipe.scene.disparity import estimate_disparity, quantised, scale_for
from lfpipe.scene.lightfield import LightField


def kept(field: LightField, rows: Sequence[int], cols: Sequence[int], truth: bool = False) -> LightField:
    """The kept views of the first frame as a light field of their own, with disparities that know of no other view.

    rows, cols: of the views kept, evenly spaced and equally on both axes. truth: take field's own disparities instead.
    Raises ValueError where there is nothing to find disparities from.
    """
    step = next((places[1] - places[0] for places in (cols, rows) if len(places) > 1), 1)
    views = np.ascontiguousarray(np.asarray(field.views)[:1, rows][:, :, cols])
    disparity: NDArray[np.float32] | None
    if truth and field.disparity is not None:
        unit = np.float32(field.disparity_scale_px * step)
        disparity = np.asarray(field.disparity)[0, rows][:, cols].astype(np.float32) * unit
    else:
        disparity = estimate_disparity(views[0])
    if disparity is None:
        raise ValueError("no disparity can be found: one view, or views that are too small")
    low, high = (float(v) for v in np.percentile(disparity, (0.05, 99.95)))
    scale = scale_for(low, high)
    return attrs.evolve(
        field,
        views=views,
        disparity=quantised(disparity, scale)[None],
        disparity_scale_px=scale,
        disparity_min_px=low,
        disparity_max_px=high,
        offsets=np.ascontiguousarray(field.offsets[rows][:, cols]) / np.float32(step),
        present=np.ones((len(rows), len(cols)), bool),
    )


def coarser(field: LightField, factor: int) -> LightField:
    """field with its disparity maps at a factor-th of their resolution."""
    if field.disparity is None or factor == 1:
        return field
    stored = np.asarray(field.disparity)
    size = max(1, stored.shape[4] // factor), max(1, stored.shape[3] // factor)
    maps = [_shrunk(map_, size) for map_ in stored.reshape(-1, *stored.shape[3:])]
    return attrs.evolve(field, disparity=np.stack(maps).reshape(*stored.shape[:3], size[1], size[0]))


def made(field: LightField, synthesiser: Synthesiser, position: Position, outs: list[NDArray[np.uint8]]) -> NDArray[np.float32]:
    """The whole view at position, float32 (channels, height, width). outs: planes to draw into, one per channel."""
    views = np.asarray(field.views)
    sources = [lambda r, c, k=k: views[0, r, c, k] for k in range(field.channels)]
    return np.stack(synthesiser.render(position, 0, 0.0, sources, outs)).astype(np.float32)


def walk(field: LightField) -> Callable[[], tuple[Position, Position]]:
    """A viewer who drifts among the middle 3x3 views of the grid: viewpoints of the left and right eye, 1.4 views apart."""
    row_middle, col_middle = (field.rows - 1) / 2, (field.cols - 1) / 2
    phases = itertools.count()

    def step() -> tuple[Position, Position]:
        t = next(phases) * 0.013
        row, col = row_middle + 0.8 * np.sin(1.7 * t), col_middle + 0.3 * np.sin(t)
        return (float(row), float(col - 0.7)), (float(row), float(col + 0.7))

    return step


def _shrunk(map_: NDArray[np.int8], size: tuple[int, int]) -> NDArray[np.int8]:
    smaller = cv2.resize(map_.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return np.rint(smaller).astype(np.int8)
