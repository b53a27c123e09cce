"""A live light field drawn from formulas: `tests.render.rendered` as frames of a source."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import LiveSource
from lfpipe.live.records import View
from lfpipe.scene.lightfield import LightField


def source(
    rows: int = 1, cols: int = 2, height_px: int = 96, width_px: int = 128, name: str = "demo"
) -> LiveSource:
    """A mosaic of views."""
    frame_px = cols * width_px, rows * height_px
    return LiveSource(source=name, rows=rows, cols=cols, tiles_across=cols, frame_px=frame_px)


def frame_of(field: LightField) -> NDArray[np.uint8]:
    """All views of a light field as one picture, uint8 (height, width, 3) BGR."""
    views = np.broadcast_to(field.views[0], (*field.views.shape[1:3], 3, *field.views.shape[4:]))
    rows, cols, _, height, width = views.shape
    tiles = views[:, :, ::-1].transpose(0, 3, 1, 4, 2)
    return np.ascontiguousarray(tiles.reshape(rows * height, cols * width, 3))


def maps_of(record: NDArray[np.void]) -> dict[View, NDArray[np.floating[Any]]]:
    """The disparities of a record, px."""
    count = int(record["count"])
    maps = record["maps"][:count] * record["scale_px"]
    return dict(zip(map(tuple, record["views"][:count].tolist()), maps, strict=True))
