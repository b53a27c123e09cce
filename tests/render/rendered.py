"""A small light field drawn from formulas, so that every depth and every view, also between the
stored ones, is known.

A textured wall at disparity FAR and before it a textured square at NEAR (px per grid step), on a
grid of any size.
"""

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Config, Render
from lfpipe.config.tree import Method
from lfpipe.eyes import EYES, EyesRecord
from lfpipe.render.presenter import DisplayTime, Presentation, TrackedEyes
from lfpipe.render.synthesis.anaglyph import MATRICES
from lfpipe.render.viewer.viewer import Viewer, Viewpoints
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.source import Geometry
from lfpipe.transport.ring import Stamp

FAR, NEAR = -1.0, 2.0
# where the square begins and ends in the middle view, both axes, in px of a 64x64 view
SQUARE = (20.0, 44.0)
METHODS: list[Method] = ["nearest", "blend", "warp", "warp2"]
OUTPUTS = [*MATRICES, "mono", "side-by-side", "row-interleaved"]
S = 1_000_000_000


def eyes_array(
    x: float = 320.0, y: float = 240.0, eye_distance: float = 24.0, **more: Any
) -> NDArray[np.void]:
    """Eyes around (x, y) in a picture of 640x480: of dtype EYES, shape ()."""
    eyes = np.zeros((), EYES)
    eyes["face"], eyes["width_px"], eyes["height_px"] = 1, 640, 480
    eyes["raw_px"] = eyes["filtered_px"] = [[x + eye_distance / 2, y], [x - eye_distance / 2, y]]
    for name, value in more.items():
        eyes[name] = value
    return eyes


def record(*place: float, **more: Any) -> EyesRecord:
    """The same as a record."""
    return EyesRecord.of(eyes_array(*place, **more))


def viewer(**render: Any) -> Viewer:
    """Of nine by nine small views, warped."""
    return Viewer(field(9, 9, 16, 16), Config(render=Render(method="warp2", **render)))


def presentation(**fields: Any) -> Presentation:
    """A new picture for eyes in the middle, submitted after 1 s; fields: other values."""
    eyes = TrackedEyes(record(), Stamp(1, 1, 0, S, S, S, 0), S)
    plain: dict[str, Any] = {
        "seq": 0,
        "number": 1,
        "display_time": DisplayTime(S),
        "eyes": eyes,
        "viewpoints": Viewpoints(eyes.record.filtered_px, (0.0, 0.0), (0.0, 0.0), 0),
        "picture": None,
        "t_started_ns": S,
        "t_composed_ns": S,
        "t_handed_ns": S,
        "cost_ns": 0,
    }
    return Presentation(**(plain | fields))


def _texture(x: NDArray[np.float64], y: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    value = np.zeros_like(x)
    for _ in range(12):
        fx, fy, phase = rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5), rng.uniform(0, 6.28)
        value += np.sin(fx * x + fy * y + phase)
    return value / 12


def view(
    row: float, col: float, height: int = 64, width: int = 64, texture: float = 1.0
) -> NDArray[np.uint8]:
    """The true view at steps (row, col) from the middle of the grid: uint8 (3, height, width), red,
    green, blue.

    texture: 0 leaves a plain bright square before a plain dark wall.
    """
    y, x = np.mgrid[0:height, 0:width].astype(float)
    planes = []
    inside = _square(row, col, height, width)
    for channel in range(3):
        wall = (110 if texture else 20) + 60 * texture * _texture(
            x + FAR * col, y + FAR * row, channel
        )
        square = (150 if texture else 240) + 80 * texture * _texture(
            x + NEAR * col, y + NEAR * row, 10 + channel
        )
        planes.append(np.where(inside, square, wall))
    return np.asarray(np.stack(planes).round().clip(0, 255), np.uint8)


def _square(row: float, col: float, height: int, width: int) -> NDArray[np.bool_]:
    y, x = np.mgrid[0:height, 0:width].astype(float)
    x, y = x + NEAR * col, y + NEAR * row
    low, high = SQUARE
    return np.asarray((x >= low) & (x < high) & (y >= low) & (y < high))


@lru_cache(64)
def field(
    rows: int = 5,
    cols: int = 5,
    height: int = 64,
    width: int = 64,
    depth: bool = True,
    scale: float = 1.0,
    texture: float = 1.0,
) -> LightField:
    """The grid as a LightField, not to be written to.

    scale: multiplies the grid's spacing, and so its disparities.
    """
    views = np.zeros((1, rows, cols, 3, height, width), np.uint8)
    disparity = np.zeros((1, rows, cols, (height + 1) // 2, (width + 1) // 2), np.int8)
    unit_px = max(abs(FAR), abs(NEAR)) * scale / 120
    for r in range(rows):
        for c in range(cols):
            row, col = (r - (rows - 1) / 2) * scale, (c - (cols - 1) / 2) * scale
            views[0, r, c] = view(row, col, height, width, texture)
            depth_px = np.where(_square(row, col, height, width), NEAR, FAR).astype(
                np.float32
            ) * np.float32(scale / unit_px)
            disparity[0, r, c] = np.rint(
                cv2.resize(depth_px, disparity.shape[:2:-1], interpolation=cv2.INTER_AREA)
            )
    return light_field(views, disparity if depth else None, unit_px, FAR * scale, NEAR * scale)


def noise(
    rows: int, cols: int, height: int, width: int, extent_px: float, seed: int, channels: int = 3
) -> LightField:
    """Two frames of views and disparities of pure noise, up to +-extent_px, without any
    consistency.
    """
    rng = np.random.default_rng(seed)
    views = rng.integers(0, 256, (2, rows, cols, channels, height, width), dtype=np.uint8)
    disparity = rng.integers(
        -127, 128, (1, rows, cols, (height + 1) // 2, (width + 1) // 2), dtype=np.int8
    )
    return light_field(views, disparity, extent_px / 127, -extent_px, extent_px, "warp")


def light_field(
    views: NDArray[np.uint8],
    disparity: NDArray[np.int8] | None,
    unit_px: float,
    low_px: float,
    high_px: float,
    method: str = "",
) -> LightField:
    """views: uint8 (frames, rows, cols, channels, height, width)."""
    rows, cols = views.shape[1:3]
    method = method or ("blend" if disparity is None else "warp2")
    return LightField(
        views=views,
        disparity=disparity,
        disparity_scale_px=unit_px,
        disparity_min_px=low_px,
        disparity_max_px=high_px,
        disparity_source="none" if disparity is None else "truth",
        offsets=np.zeros((rows, cols, 2), np.float32),
        present=np.ones((rows, cols), bool),
        geometry=Geometry(),
        frame_rate_hz=25.0,
        name="drawn",
        method=method,
    )
