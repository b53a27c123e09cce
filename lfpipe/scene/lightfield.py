"""An opened light field, as used by all rooms above: in canonical order (row 0 top camera, column 0 left camera)."""

from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

UNKNOWN = (
    -128
)  # in LightField.disparity: no value explains the neighbours, so views are cross-faded there


@attrs.frozen
class Geometry:
    """Known facts of the capture; None if the source does not state them. focal_length_px is of a stored view."""

    baseline_mm: float | None = None
    focus_distance_mm: float | None = None
    focal_length_px: float | None = None


@attrs.frozen(eq=False)
class LightField:
    """A grid of views with its metadata.

    views: uint8 (frames, rows, cols, channels, height, width); channels is 1 (grey) or 3 (red, green, blue), in screen
        (gamma) values. A read-only memory map: touching one plane reads that plane only.
    disparity: int8 (frames or 1, rows, cols, height_d, width_d), or None; times disparity_scale_px, which is negative after
        a half-turn, it is the shift in
        px of a stored view per grid step, positive is nearer than the plane of zero disparity: what stands at (x, y)
        in view (r, c) stands at (x - d*(c'-c), y - d*(r'-r)) in view (r', c'). UNKNOWN where it is not known.
    offsets: float32 (rows, cols, 2), where a camera stood less its place on the regular grid, in grid steps
        (row, col); zeros on a regular grid.
    present: bool (rows, cols), False where the source has no such view (its place holds the nearest one's copy).
    """

    views: NDArray[np.uint8]
    disparity: NDArray[np.int8] | None
    disparity_scale_px: float
    disparity_min_px: float
    disparity_max_px: float
    disparity_source: str  # "truth", "estimated" or "none"
    offsets: NDArray[np.float32]
    present: NDArray[np.bool_]
    geometry: Geometry
    frame_rate_hz: float  # of light-field video; 0 for a still
    name: str
    method: str  # the method that `auto` stands for: "nearest", "blend", "warp" or "warp2"
    manifest: dict[str, Any]  # provenance, as stored; "flips" as shown
    folder: str = ""  # of the pack, absolute
    hold: object = None  # keeps `lfpipe scene clean` from removing the pack
    border_px: tuple[float, float] = (
        0.0,
        0.0,
    )  # farthest and nearest at the left and right border, px per view
    half_turned: bool = False  # rows and columns run against the pack's order

    def exchanged(self) -> "LightField":
        """The same field with near and far exchanged: the grid turned by 180 degrees, disparities negated. Copies nothing."""
        flips = self.manifest.get("flips")
        turned = flips and {**flips, "rows": not flips["rows"], "cols": not flips["cols"]}
        return attrs.evolve(
            self,
            views=self.views[:, ::-1, ::-1],
            disparity=None if self.disparity is None else self.disparity[:, ::-1, ::-1],
            disparity_scale_px=-self.disparity_scale_px,
            disparity_min_px=-self.disparity_max_px,
            disparity_max_px=-self.disparity_min_px,
            border_px=(-self.border_px[1], -self.border_px[0]),
            offsets=-self.offsets[::-1, ::-1],
            present=self.present[::-1, ::-1],
            manifest={**self.manifest, "flips": turned} if turned else self.manifest,
            half_turned=not self.half_turned,
        )

    @property
    def complete(self) -> bool:
        """Whether the packer has measured the disparity, as far as there is any."""
        return bool(self.manifest.get("complete", True))

    @property
    def frames(self) -> int:
        return int(self.views.shape[0])

    @property
    def rows(self) -> int:
        return int(self.views.shape[1])

    @property
    def cols(self) -> int:
        return int(self.views.shape[2])

    @property
    def channels(self) -> int:
        return int(self.views.shape[3])

    @property
    def height_px(self) -> int:
        return int(self.views.shape[4])

    @property
    def width_px(self) -> int:
        return int(self.views.shape[5])
