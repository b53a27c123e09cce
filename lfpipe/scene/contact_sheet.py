"""Pictures to inspect a light field: one view, and a contact sheet that makes errors of the order visible."""

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.scene.lightfield import UNKNOWN, LightField

SHEET_PX = 1600  # the longer side of the contact sheet's grid
_GAP_PX = 4
_TEXT_PX = 24  # height of a line of text
_SLICE_PX = 12  # of each view's line in an epipolar slice


def stored_view(field: LightField, row: int, col: int, frame: int = 0) -> NDArray[np.uint8]:
    """A stored view as RGB, uint8 (height, width, 3)."""
    planes = list(np.asarray(field.views[frame, row, col]))
    return np.asarray(cv2.merge(planes * 3 if len(planes) == 1 else planes), np.uint8)


def require_view_index(field: LightField, row: float, col: float) -> None:
    """Raises UserError if (row, col) is not finite or lies outside the grid."""
    for name, value, count in (("row", row, field.rows), ("col", col, field.cols)):
        if not 0 <= value <= count - 1:  # not a number compares false
            raise UserError(f"--{name} {value:g}: the scene has {field.rows}x{field.cols} views", f"use 0 to {count - 1}")


def contact_sheet(field: LightField) -> NDArray[np.uint8]:
    """All views in canonical order, RGB. Below them an epipolar slice: the middle line of every view of the middle row, column 0
    at the top; to the right the same for the middle column.

    In a well-ordered grid near objects lean to the left going down in the first slice, and upwards going right in the second. A
    flipped axis leans the wrong way; a transposed grid jumps instead. At the bottom, the depth of the middle view in colour.
    """
    scale = min(1.0, SHEET_PX / max(field.rows * field.height_px, field.cols * field.width_px))
    height, width = max(2, round(field.height_px * scale)), max(2, round(field.width_px * scale))
    sheet_height = field.rows * (height + _GAP_PX) + _GAP_PX
    sheet_width = field.cols * (width + _GAP_PX) + _GAP_PX
    across = _slice([stored_view(field, field.rows // 2, c)[field.height_px // 2] for c in range(field.cols)])
    down = _slice([stored_view(field, r, field.cols // 2)[:, field.width_px // 2] for r in range(field.rows)]).transpose(1, 0, 2)
    across = np.asarray(cv2.resize(across, (sheet_width, across.shape[0])), np.uint8)
    down = np.asarray(cv2.resize(down, (down.shape[1], sheet_height)), np.uint8)
    out = np.full((sheet_height + across.shape[0] + _GAP_PX, sheet_width + down.shape[1] + _GAP_PX, 3), 32, np.uint8)
    for r in range(field.rows):
        for c in range(field.cols):
            small = cv2.resize(stored_view(field, r, c), (width, height), interpolation=cv2.INTER_AREA)
            y, x = _GAP_PX + r * (height + _GAP_PX), _GAP_PX + c * (width + _GAP_PX)
            out[y : y + height, x : x + width] = small if field.present[r, c] else small // 3
    out[sheet_height : sheet_height + across.shape[0], : across.shape[1]] = across
    out[: down.shape[0], sheet_width : sheet_width + down.shape[1]] = down
    below = depth_strip(field, out.shape[1])
    return out if below is None else np.vstack([out, below])


def depth_strip(field: LightField, width_px: int) -> NDArray[np.uint8] | None:
    """The middle view beside its depth, near in red and far in blue, RGB and width_px wide; beside both readings if the order of
    the views does not settle near and far. None without disparity."""
    if field.disparity is None:
        return None
    row, col = field.rows // 2, field.cols // 2
    about = field.manifest["orientation"]
    readings = [("as it is: red is near, blue is far", 1.0)]
    if about["undecided"] and about["by"] != "override":
        readings.append(("with --flip " + _half_turned(field) + ": red is near, blue is far", -1.0))
    tile_w = max(2, (width_px - _GAP_PX * (len(readings) + 2)) // (len(readings) + 1))
    tile_h = max(2, round(tile_w * field.height_px / field.width_px))
    out = np.full((tile_h + _TEXT_PX + _GAP_PX, width_px, 3), 32, np.uint8)
    disparity = np.asarray(field.disparity[0, row, col], np.float32)
    disparity[disparity == UNKNOWN] = 0
    low, high = np.percentile(disparity, (2, 98))
    tiles = [("the middle view", stored_view(field, row, col))]
    for text, sign in readings:
        near = (disparity - low) / max(1.0, float(high - low)) if sign > 0 else (high - disparity) / max(1.0, float(high - low))
        coloured = cv2.applyColorMap(np.asarray(255 * np.clip(near, 0, 1), np.uint8), cv2.COLORMAP_TURBO)
        tiles.append((text, np.asarray(cv2.cvtColor(coloured, cv2.COLOR_BGR2RGB), np.uint8)))
    for number, (text, picture) in enumerate(tiles):
        x = _GAP_PX + number * (tile_w + _GAP_PX)
        out[_TEXT_PX : _TEXT_PX + tile_h, x : x + tile_w] = cv2.resize(picture, (tile_w, tile_h), interpolation=cv2.INTER_AREA)
        scale = min(0.5, tile_w / (10.0 * len(text)))
        cv2.putText(out, text, (x, _TEXT_PX - 6), cv2.FONT_HERSHEY_SIMPLEX, scale, (255, 255, 255), 1, cv2.LINE_AA)
    return out


def _half_turned(field: LightField) -> str:
    """The value of scene.flip that exchanges near and far."""
    flips = field.manifest["flips"]
    rows, cols = not flips["rows"] and field.rows > 1, not flips["cols"] and field.cols > 1
    return "both" if rows and cols else "rows" if rows else "cols" if cols else "none"


def _slice(lines: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """One line of each view, stacked, each _SLICE_PX high."""
    return np.repeat(np.stack(lines), _SLICE_PX, axis=0)
