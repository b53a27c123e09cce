"""Pictures to inspect a light field: one view, and a contact sheet that makes errors of the order
visible.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.lightfield import UNKNOWN, LightField

SHEET_PX = 1600  # the longer side of the contact sheet's grid
_GAP_PX = 4  # between views: seen on a sheet that is shown at half its size
_SLICE_PX = 12  # of each view's line in an epipolar slice


def stored_view(field: LightField, row: int, col: int) -> NDArray[np.uint8]:
    """A stored view as RGB, uint8 (height, width, 3)."""
    planes = list(np.asarray(field.views[0, row, col]))
    return np.asarray(cv2.merge(planes * 3 if len(planes) == 1 else planes), np.uint8)


def contact_sheet(field: LightField) -> NDArray[np.uint8]:
    """All views in canonical order, RGB. Below them an epipolar slice: the middle line of every
    view of the middle row, column 0 at the top; to the right the same for the middle column.

    In a well-ordered grid near objects lean to the left going down in the first slice, and upwards
    going right in the second. A flipped axis leans the wrong way; a transposed grid jumps instead.
    At the bottom, the middle view beside its depth.
    """
    scale = min(1.0, SHEET_PX / max(field.rows * field.height_px, field.cols * field.width_px))
    height, width = max(2, round(field.height_px * scale)), max(2, round(field.width_px * scale))
    sheet_height = field.rows * (height + _GAP_PX) + _GAP_PX
    sheet_width = field.cols * (width + _GAP_PX) + _GAP_PX
    across = np.stack(
        [stored_view(field, field.rows // 2, c)[field.height_px // 2] for c in range(field.cols)]
    )
    down = np.stack(
        [stored_view(field, r, field.cols // 2)[:, field.width_px // 2] for r in range(field.rows)],
        axis=1,
    )
    across_px, down_px = _SLICE_PX * field.cols, _SLICE_PX * field.rows
    out = np.full(
        (sheet_height + across_px + _GAP_PX, sheet_width + down_px + _GAP_PX, 3), 32, np.uint8
    )
    out[sheet_height : sheet_height + across_px, :sheet_width] = cv2.resize(
        across.repeat(_SLICE_PX, axis=0), (sheet_width, across_px)
    )
    out[:sheet_height, sheet_width : sheet_width + down_px] = cv2.resize(
        down.repeat(_SLICE_PX, axis=1), (down_px, sheet_height)
    )
    for r, c in np.ndindex(field.rows, field.cols):
        small = cv2.resize(stored_view(field, r, c), (width, height), interpolation=cv2.INTER_AREA)
        y, x = _GAP_PX + r * (height + _GAP_PX), _GAP_PX + c * (width + _GAP_PX)
        out[y : y + height, x : x + width] = small if field.present[r, c] else small // 3
    if field.disparity is None:
        return out
    place = field.rows // 2, field.cols // 2
    disparity = np.asarray(field.disparity[0][place], np.float32)
    disparity[disparity == UNKNOWN] = 0
    disparity *= np.sign(field.disparity_scale_px)  # negative after a half-turn
    low, high = np.percentile(disparity, (2, 98))
    near = np.asarray(
        255 * np.clip((disparity - low) / max(1.0, float(high - low)), 0, 1), np.uint8
    )
    depth = cv2.cvtColor(cv2.applyColorMap(near, cv2.COLORMAP_TURBO), cv2.COLOR_BGR2RGB)
    half = out.shape[1] // 2
    tile = (
        max(2, half - 2 * _GAP_PX),
        max(2, round((half - 2 * _GAP_PX) * field.height_px / field.width_px)),
    )
    strip = np.full((tile[1] + 2 * _GAP_PX, out.shape[1], 3), 32, np.uint8)
    for x, picture in ((_GAP_PX, stored_view(field, *place)), (half + _GAP_PX, depth)):
        strip[_GAP_PX : _GAP_PX + tile[1], x : x + tile[0]] = cv2.resize(
            picture, tile, interpolation=cv2.INTER_AREA
        )
    return np.vstack([out, strip])
