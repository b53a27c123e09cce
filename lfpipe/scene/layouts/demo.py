"""The demo's still life, rendered view by view: nothing but its size is stored."""

from functools import lru_cache, partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.files.untrusted import json_fields
from lfpipe.scene.demo import MARKER
from lfpipe.scene.demo_layers import render_view
from lfpipe.scene.demo_still_life import OFFSET_PX, solids_of
from lfpipe.scene.files import Listing, read_bytes
from lfpipe.scene.lightfield import Geometry
from lfpipe.scene.source import SceneSource, Turn

NAME = "demo"
FOCAL_MM, SENSOR_MM, FOCUS_M = 100.0, 35.0, 1.5


def detect(listing: Listing) -> int | None:
    return 100 if MARKER in listing.names else None


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    path = listing.file(MARKER)
    fields = json_fields(read_bytes(path), str(path), "remove the folder; lfpipe makes it again")
    grid, size_px = fields.integer("grid", 1, 33), fields.integer("size_px", 32, 4096)
    middle, solids = grid // 2, solids_of(fields.text("scene"), size_px)

    @lru_cache(grid * grid)
    def view(row: int, col: int) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        return render_view(solids, size_px, col - middle, row - middle)

    def read(_frame: int, row: int, col: int) -> NDArray[Any]:
        return np.asarray(cv2.cvtColor(view(row, col)[0], cv2.COLOR_BGR2RGB))

    geometry = Geometry(
        # offset = baseline * focal length * width / (focus distance * sensor width), as in the HCI benchmark's tools
        baseline_mm=OFFSET_PX / 512 * FOCUS_M * 1000 * SENSOR_MM / FOCAL_MM,
        focus_distance_mm=FOCUS_M * 1000,
        focal_length_px=FOCAL_MM / SENSOR_MM * size_px,
    )
    truth = {place: partial(lambda row, col: view(row, col)[1], *place) for place in np.ndindex(grid, grid)}
    return SceneSource(
        NAME, listing.path, (path,), grid, grid, read, size_px, size_px, turn=Turn(), rendered=True, truth=truth,
        turn_by="the demo is rendered in this order", geometry=geometry,
    )  # fmt: skip
