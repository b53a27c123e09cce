"""An opened light field, as used by all rooms above: in canonical order (row 0 top camera, column 0
left camera).
"""

from collections.abc import Callable
from functools import cached_property
from typing import Self

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.manifest import Manifest
from lfpipe.scene.source import Geometry

# in LightField.disparity: no value explains the neighbours, so views are cross-faded there
UNKNOWN = -128


@attrs.frozen(eq=False, repr=False, kw_only=True)
class LightField:
    """A grid of views with its metadata.

    views: uint8 (frames, rows, cols, channels, height, width); channels is 1 (grey) or 3 (red,
    green, blue), in screen
        (gamma) values. A read-only memory map: touching one plane reads that plane only.
    disparity: int8 (frames or 1, rows, cols, height_d, width_d), or None; times disparity_scale_px,
    which is negative after
        a half-turn, it is the shift in px of a stored view per grid step, positive is nearer than
        the plane of zero disparity: what stands at (x, y) in view (r, c) stands at (x - d*(c'-c), y
        - d*(r'-r)) in view (r', c'). UNKNOWN where it is not known.
    offsets: float32 (rows, cols, 2), where a camera stood less its place on the regular grid, in
    grid steps
        (row, col); zeros on a regular grid.
    present: bool (rows, cols), False where the source has no such view (its place holds the nearest
    one's copy).
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
    # provenance; its order is the one shown
    manifest: Manifest = attrs.field(factory=Manifest)
    folder: str = ""  # of the pack, absolute
    # ends the lock that keeps `lfpipe scene clean` from removing the pack
    hold: Callable[[], object] | None = None
    # farthest and nearest at the left and right border, px per view
    border_px: tuple[float, float] = (0.0, 0.0)
    half_turned: bool = False  # rows and columns run against the pack's order

    @classmethod
    def of(
        cls,
        manifest: Manifest,
        views: NDArray[np.uint8],
        disparity: NDArray[np.int8] | None,
        folder: str = "",
        hold: Callable[[], object] | None = None,
    ) -> Self:
        """The light field of the arrays of a pack with this manifest."""
        grid = manifest.rows, manifest.cols
        about = manifest.disparity
        offsets = np.zeros((*grid, 2)) if manifest.offsets is None else manifest.offsets
        return cls(
            views=views,
            disparity=disparity,
            disparity_scale_px=about.scale_px,
            disparity_min_px=about.min_px,
            disparity_max_px=about.max_px,
            disparity_source=about.source,
            offsets=np.asarray(offsets, np.float32).reshape(*grid, 2),
            present=np.asarray(manifest.present, bool).reshape(grid),
            geometry=manifest.geometry,
            frame_rate_hz=manifest.frame_rate_hz,
            name=manifest.name,
            method=manifest.method,
            manifest=manifest,
            folder=folder,
            hold=hold,
            border_px=(about.border_low_px, about.border_high_px),
        )

    def __repr__(self) -> str:
        frames = f"{self.frames} frames of " if self.frames > 1 else ""
        return (
            f"<LightField {self.name!r}: {frames}{self.rows}x{self.cols} views of"
            f" {self.width_px}x{self.height_px}, method {self.method}>"
        )

    def close(self) -> None:
        """Lets `lfpipe scene clean` remove the pack. Its maps last as long as their arrays."""
        if self.hold is not None:
            self.hold()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def exchanged(self) -> "LightField":
        """The same field with near and far exchanged: the grid turned by 180 degrees, disparities
        negated. Copies nothing.
        """
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
            manifest=self.manifest.exchanged(),
            half_turned=not self.half_turned,
        )

    @cached_property
    def needs_eyes(self) -> bool:
        """Whether the picture depends on the eyes: of a single view, or of equal ones, it is the
        same from everywhere. The outermost views of most scenes answer.
        """
        if self.rows * self.cols == 1:
            return False
        first = self.views[:, 0, 0]
        places = reversed([*np.ndindex(self.rows, self.cols)])
        return not self.complete or any(
            not np.array_equal(self.views[:, row, col], first) for row, col in places
        )

    @property
    def complete(self) -> bool:
        """Whether the packer has measured the disparity, as far as there is any."""
        return self.manifest.complete

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
