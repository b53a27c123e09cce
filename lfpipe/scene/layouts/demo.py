"""The demo scenes, rendered view by view: only a name and a size are stored."""

from functools import lru_cache, partial

import cv2
import numpy as np

from lfpipe import config
from lfpipe.files.safe_files import json_fields
from lfpipe.scene.demo_drawing import Floats, Picture, draw_view
from lfpipe.scene.demo_scenes import OFFSET_PX, solids_of
from lfpipe.scene.pack import DEMO_MARKER, DEMO_SIZE_PX
from lfpipe.scene.source import Geometry, GridTransform, Listing, SceneSource, read_bytes

NAME = "demo"
GRID = 9  # views a side, as in the HCI benchmark, whose cameras have
# this focal length and width of the sensor, and about this focus
FOCAL_MM, SENSOR_MM, FOCUS_M = 100.0, 35.0, 1.5


def detect(listing: Listing) -> int | None:
    return 100 if DEMO_MARKER in listing.names else None


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    path = listing.file(DEMO_MARKER)
    fields = json_fields(read_bytes(path), str(path), "remove the folder; lfpipe makes it again")
    size_px = fields.integer("size_px", 32, 4096)
    scale = max(size_px / DEMO_SIZE_PX, 1.0)
    solids = solids_of(fields.text("scene"), scale)

    @lru_cache(GRID * GRID)
    def view(row: int, col: int) -> tuple[Picture, Floats]:
        drawn_px = round(DEMO_SIZE_PX * scale)
        picture, disparity = draw_view(solids, col - GRID // 2, row - GRID // 2, drawn_px)
        if size_px == drawn_px:
            return picture, disparity
        sides = size_px, size_px
        small = cv2.resize(
            disparity * np.float32(size_px / drawn_px), sides, interpolation=cv2.INTER_NEAREST
        )
        return np.asarray(
            cv2.resize(picture, sides, interpolation=cv2.INTER_AREA), np.uint8
        ), np.asarray(small, np.float32)

    geometry = Geometry(
        # offset = baseline * focal length * width / (focus distance * sensor width),
        # as in the HCI benchmark's tools
        baseline_mm=OFFSET_PX / DEMO_SIZE_PX * FOCUS_M * 1000 * SENSOR_MM / FOCAL_MM,
        focus_distance_mm=FOCUS_M * 1000,
        focal_length_px=FOCAL_MM / SENSOR_MM * size_px,
    )
    truth = {
        place: partial(lambda row, col: view(row, col)[1], *place)
        for place in np.ndindex(GRID, GRID)
    }
    return SceneSource(
        layout=NAME,
        path=listing.path,
        files=(path,),
        rows=GRID,
        cols=GRID,
        read=lambda frame, row, col: view(row, col)[0],
        height_px=size_px,
        width_px=size_px,
        turn=GridTransform(),
        rendered=True,
        truth=truth,
        turn_by="the demo is rendered in this order",
        geometry=geometry,
    )
