"""An opened light field in canonical order (row 0: top camera, column 0: left camera), and its
manifest: the content of a pack's manifest.json.

Reversing rows and columns inverts depth (pseudoscopic order) and the sign of disparity. The images
alone rarely determine the order, so a pack holds the views as stored, and the order is state of the
session: `scene.invert_depth`, else the user's earlier choice for this scene, else the order that
the pack's manifest states.

    STATE/depth_order/KEY      "yes", "no", or "asked" once the window has asked
"""

import contextlib
import enum
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Self

import attrs
import numpy as np
import platformdirs
from numpy.typing import NDArray

from lfpipe.files.safe_files import read_bytes, write_file
from lfpipe.scene.source import Geometry, GridTransform

VERSION = 13  # of the pack format; part of the cache key
HARDLY_FIT = (  # a note of manifests, which the window shows, too
    "The views hardly fit together. If this is not one scene, open one of its folders or pictures."
)


@attrs.frozen(kw_only=True)
class Depth:
    """Disparities of the farthest and the nearest things, px per grid step, positive is nearer."""

    min_px: float = 0.0
    max_px: float = 0.0
    # at the left and right border, which the screen edge cuts off
    border_low_px: float = 0.0
    border_high_px: float = 0.0

    @property
    def reach_px(self) -> float:
        """The largest disparity either way."""
        return max(-self.min_px, self.max_px)


class DisparitySource(enum.StrEnum):
    """The source of disparity; manifests store the values."""

    NONE = "none"
    UNKNOWN = "unknown"  # not packed yet
    ESTIMATED = "estimated"
    TRUTH = "truth"


class OrderSource(enum.StrEnum):
    """The basis for the order of the views; manifests store the values."""

    NOTHING = "nothing"
    OVERRIDE = "override"
    COORDINATES = "coordinates"
    LAYOUT = "layout"
    FLOW = "flow"


@attrs.frozen(kw_only=True)
class Disparity(Depth):
    """The source and range of a pack's disparities, and the step of the stored maps."""

    source: DisparitySource = DisparitySource.NONE
    scale_px: float = 1 / 16
    confirmed: float = 1.0
    """Of a pair, the share of the pixels for which the maps of both views agree."""


@attrs.frozen(kw_only=True)
class MethodScores:
    """How well the rendering methods predict the views of a scene."""

    psnr_db: Mapping[str, float] = attrs.field(factory=dict)
    """By method, of held-out views; empty if none can be held out."""
    errors: Mapping[str, Sequence[float]] = attrs.field(factory=dict)
    """By method, at each of `config.quality.SIZES`: the error of pictures between stored views, in
    grey levels, see `render.plan`."""


@attrs.frozen(kw_only=True)
class OrientationFacts:
    """The basis for the order of the views, as in `orientation.Orientation`."""

    by: OrderSource = OrderSource.NOTHING
    sure: bool = True
    reason: str = ""
    undecided: str = ""
    invert_depth: bool = False  # whether the order of the pack inverts depth
    depth_order_sure: bool = True


@attrs.frozen(kw_only=True)
class Manifest:
    """The content of manifest.json. Sizes are those of the arrays, in the order of the pack."""

    version: int = VERSION
    complete: bool = True  # whether the packer has measured the disparity, if there is any
    lfpipe: str = ""  # the version that made the pack
    key: str = ""  # of the cache; "" if not packed
    name: str = ""
    source: str = ""
    layout: str = ""
    files: int = 0
    created: str = ""
    rows: int = 0
    cols: int = 0
    frames: int = 0
    height: int = 0
    width: int = 0
    channels: int = 0
    bit_depth: int = 0
    frame_rate_hz: float = 0.0
    flips: GridTransform = attrs.field(factory=GridTransform)
    orientation: OrientationFacts = attrs.field(factory=OrientationFacts)
    gamma: float = 1.0
    gamma_by: str = ""
    geometry: Geometry = attrs.field(factory=Geometry)
    present: list[list[int]] = attrs.field(factory=list)  # by row and column, 1 or 0
    offsets: list[list[list[float]]] | None = None  # as in LightField; None on a regular grid
    disparity: Disparity = attrs.field(factory=Disparity)
    notes: tuple[str, ...] = ()
    # as in MethodScores
    scores: Mapping[str, float] = attrs.field(factory=dict)
    errors: Mapping[str, tuple[float, ...]] = attrs.field(factory=dict)
    method: str = ""  # that `auto` selects; "" if not packed

    @property
    def views_shape(self) -> tuple[int, ...]:
        """(frames, rows, cols, channels, height, width)."""
        return self.frames, self.rows, self.cols, self.channels, self.height, self.width

    @property
    def disparity_shape(self) -> tuple[int, ...]:
        """(frames, rows, cols, half height, half width)."""
        return self.frames, self.rows, self.cols, (self.height + 1) // 2, (self.width + 1) // 2

    def inverted(self) -> "Manifest":
        """In inverted depth order: rows and columns reversed, disparities negated."""
        turn = self.flips
        depth = self.disparity
        return attrs.evolve(
            self,
            flips=attrs.evolve(turn, rows=not turn.rows, cols=not turn.cols),
            disparity=attrs.evolve(
                depth,
                min_px=0.0 - depth.max_px,  # never -0.0
                max_px=0.0 - depth.min_px,
                border_low_px=0.0 - depth.border_high_px,
                border_high_px=0.0 - depth.border_low_px,
            ),
        )


# in LightField.disparity: unknown, so views are cross-faded there
UNKNOWN = -128


@attrs.frozen(eq=False, repr=False, kw_only=True)
class LightField:
    """A grid of views with its metadata."""

    views: NDArray[np.uint8]
    """(frames, rows, cols, channels, height, width); channels: 1 (grey) or 3 (red, green, blue), in
    screen (gamma) values. A read-only memory map: reading a plane touches that plane only."""
    disparity: NDArray[np.int8] | None
    """(frames or 1, rows, cols, half height, half width), in steps of disparity_scale_px: the shift
    in px of a stored view per grid step; positive: nearer than the zero-disparity plane. A point
    at (x, y) in view (r, c) appears at (x - d*(c'-c), y - d*(r'-r)) in view (r', c')."""
    disparity_scale_px: float  # negative in inverted depth order
    disparity_min_px: float
    disparity_max_px: float
    disparity_source: str  # a DisparitySource
    offsets: NDArray[np.float32]
    """(rows, cols, 2): camera position minus regular grid position, in grid steps"""
    present: NDArray[np.bool_]
    """(rows, cols): False if the source has no view; the nearest view is stored instead"""
    geometry: Geometry
    frame_rate_hz: float  # of light-field video; 0 for a still
    name: str
    method: str  # the method that `auto` selects: "nearest", "blend", "warp" or "warp2"
    # of the pack, in the order of `views`
    manifest: Manifest = attrs.field(factory=Manifest)
    folder: str = ""  # of the pack, absolute
    # releases the lock that keeps `lfpipe scene clean` from removing the pack
    hold: Callable[[], object] | None = None
    # farthest and nearest at the left and right border, px per view
    border_px: tuple[float, float] = (0.0, 0.0)
    depth_inverted: bool = False  # rows and columns are reversed against the pack's order
    eye_positions: tuple[tuple[float, float], tuple[float, float]] | None = None
    """(row, col) of the left and of the right eye, if the first two views were drawn for them."""

    @classmethod
    def of(
        cls,
        manifest: Manifest,
        views: NDArray[np.uint8],
        disparity: NDArray[np.int8] | None,
        folder: str = "",
    ) -> Self:
        """The light field of a pack's arrays and manifest."""
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
            border_px=(about.border_low_px, about.border_high_px),
        )

    def __repr__(self) -> str:
        frames = f"{self.frames} frames of " if self.frames > 1 else ""
        return (
            f"<LightField {self.name!r}: {frames}{self.rows}x{self.cols} views of"
            f" {self.width_px}x{self.height_px}, method {self.method}>"
        )

    def _repr_png_(self) -> bytes:
        """The middle view, which a notebook shows for the light field."""
        import cv2  # 30 MB, which a session's supervisor does without

        planes = np.asarray(self.views[0, self.rows // 2, self.cols // 2])
        rgb = np.repeat(planes, 3, axis=0) if len(planes) == 1 else planes
        _, data = cv2.imencode(".png", np.ascontiguousarray(rgb[::-1].transpose(1, 2, 0)))
        return data.tobytes()

    def close(self) -> None:
        """Lets `lfpipe scene clean` remove the pack. Memory maps live as long as their arrays."""
        if self.hold is not None:
            self.hold()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def inverted(self) -> "LightField":
        """The same field in inverted depth order: rows and columns reversed, disparities negated.
        Copies nothing.
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
            manifest=self.manifest.inverted(),
            depth_inverted=not self.depth_inverted,
        )

    @cached_property
    def needs_eyes(self) -> bool:
        """Whether the picture depends on the eyes. It does not for a single view, or for equal
        views. Comparing the outermost views suffices for most scenes.
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
        """Whether the packer has measured the disparity, if there is any."""
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


def folder() -> Path:
    """The folder of the choices; it need not exist."""
    return Path(platformdirs.user_state_dir("lfpipe")) / "depth_order"


def remembered(field: LightField) -> str:
    """ "yes", "no", "asked", or "" if the user was not asked about this scene."""
    with contextlib.suppress(OSError, UnicodeDecodeError):
        word = read_bytes(folder() / field.manifest.key).decode()
        return word if word in ("yes", "no", "asked") else ""
    return ""


def remember(field: LightField, word: str) -> None:
    """Stores the choice for this scene, by its content.

    Does nothing if the folder is not writable: the session goes on.
    """
    with contextlib.suppress(OSError):
        write_file(folder() / field.manifest.key, word.encode())


def shown_as(field: LightField, setting: str) -> LightField:
    """The field in the order that scene.invert_depth = setting asks for. Copies nothing."""
    word = setting if setting != "auto" else remembered(field)
    turned = word == "yes" if word in ("yes", "no") else field.manifest.orientation.invert_depth
    return field if turned == field.depth_inverted else field.inverted()


def undecided(field: LightField, setting: str) -> bool:
    """Whether the depth order of the field is a guess that the user was not asked about."""
    return (
        setting == "auto"
        and not field.manifest.orientation.depth_order_sure
        and not remembered(field)
    )
