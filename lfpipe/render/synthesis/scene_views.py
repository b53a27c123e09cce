"""The views and disparities of a light field at the size at which they are drawn."""

import threading
from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import TypeVar
from weakref import WeakMethod

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.render.synthesis.anaglyph import Plane, PlaneBuilder
from lfpipe.scene.lightfield import UNKNOWN, LightField

# between the mean and the middle of a cell of disparities, above which it holds an occlusion edge:
# a surface of this slope is bent by less than half a pixel of a view one step away
EDGE_PX = 0.5

T = TypeVar("T")
Source = Callable[[int, int, int], NDArray[np.uint8]]  # (frame, row, col) -> a plane of that view


def not_owning(method: Callable[..., T]) -> Callable[..., T]:
    """A method, to be cached by its own object: they would be a cycle, which ends at the next
    garbage collection alone, and until then keeps a pack mapped.
    """
    weak = WeakMethod(method)
    return lambda *arguments: weak()(*arguments)  # type: ignore[misc]  # only its object calls it


def size_of(height_px: int, width_px: int) -> tuple[int, int]:
    """(rows, columns) of the blocks of 2x2 pixels of a picture: one per disparity value."""
    return (height_px + 1) // 2, (width_px + 1) // 2


def stored_channels(field: LightField, plane: Plane) -> tuple[int, ...]:
    """Stored channels of a plane. Weights sum to 1: every plane of a grey view is the view."""
    return (0,) if field.channels == 1 else plane.channels


def reduced(plane: NDArray[np.uint8], size_px: tuple[int, int]) -> NDArray[np.uint8]:
    """A plane by area averaging, at size_px (width, height), which is smaller.

    Far larger ones by halves first, which takes a fiftieth of the time of other ratios, and hardly
    differs there.
    """
    width, height = size_px
    while plane.shape[1] >= 4 * width and plane.shape[0] >= 4 * height:
        half = plane.shape[1] // 2, plane.shape[0] // 2
        even = plane[: 2 * half[1], : 2 * half[0]]
        plane = np.asarray(cv2.resize(even, half, interpolation=cv2.INTER_AREA), np.uint8)
    return np.asarray(cv2.resize(plane, size_px, interpolation=cv2.INTER_AREA), np.uint8)


def reduced_disparity(
    disparity: NDArray[np.int8], size: tuple[int, int], edge: float
) -> NDArray[np.int8]:
    """Disparities, int8 in stored units, at size (columns, rows): the mean of each cell, or the
    value in its middle where both differ by more than edge, so that no average crosses an occlusion
    edge, and where some are unknown.
    """
    middle = cv2.resize(disparity, size, interpolation=cv2.INTER_NEAREST_EXACT)
    mean, unknown = (
        cv2.resize(values.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        for values in (disparity, disparity == UNKNOWN)
    )
    smooth = (np.abs(mean - middle) <= edge) & (unknown == 0)
    return np.where(smooth, np.rint(mean), middle).astype(np.int8)


class SceneViews:
    """The planes and disparity maps of a light field, of any size up to its own.

    Channels of the light field's own size are not copied. Other planes are made when first drawn,
    and kept while they fit.
    """

    def __init__(
        self,
        field: LightField,
        size_px: tuple[int, int] | None = None,
        budget_bytes: int = 64 << 20,
    ) -> None:
        """size_px: (width, height), of the light field's aspect and no larger; its own for None.
        budget_bytes: of planes that are built, and of views that are reduced, to be drawn again.
        """
        self.field = field
        own_px = field.width_px, field.height_px
        self.width_px, self.height_px = size_px or own_px
        self.scale = self.width_px / field.width_px
        """px that are drawn for one of the light field."""
        self._reduces = (self.width_px, self.height_px) != own_px
        # plain views of the maps: indexing an np.memmap costs microseconds
        self._views = np.asarray(field.views)
        self._builder = PlaneBuilder((self.height_px, self.width_px))
        self._building = threading.Lock()  # a builder has one set of buffers
        fit = budget_bytes // max(1, self.height_px * self.width_px)
        self.built = lru_cache(max(8, fit))(not_owning(self._build))
        self._reduced = lru_cache(max(4, fit // field.channels))(not_owning(self._reduce))
        self._reduced_map = lru_cache(max(4, 4 * fit))(not_owning(self._reduce_map))

    def replace(self, field: LightField) -> None:
        """Draws another light field of the same size from now on."""
        self.field = field
        self._views = np.asarray(field.views)
        self.__dict__.pop("_disparity", None)
        for made in (self.built, self._reduced, self._reduced_map):
            made.cache_clear()

    def source(self, plane: Plane) -> Source:
        """A function (frame, row, col) -> uint8 (height, width), read-only."""
        channels = stored_channels(self.field, plane)
        if len(channels) > 1:
            return lambda frame, row, col: self.built(frame, row, col, plane)
        return self.channel(channels[0])

    def channel(self, channel: int) -> Source:
        """As `source`, of a stored channel."""
        if self._reduces:
            return lambda frame, row, col: self._reduced(frame, row, col)[channel]
        return lambda frame, row, col: self._views[frame, row, col, channel]

    def disparity(self, frame: int, row: int, col: int) -> NDArray[np.int8]:
        """The map of a view: int8 (half height, half width), in steps of the light field's
        disparity_scale_px, which are `scale` times as many px here.
        """
        frame = min(frame, len(self._disparity) - 1)
        if self._reduces:
            return self._reduced_map(frame, row, col)
        stored: NDArray[np.int8] = self._disparity[frame, row, col]
        return stored

    @cached_property
    def _disparity(self) -> NDArray[np.int8]:
        assert self.field.disparity is not None
        return np.asarray(self.field.disparity)

    def _build(self, frame: int, row: int, col: int, plane: Plane) -> NDArray[np.uint8]:
        view = self._reduced(frame, row, col) if self._reduces else self._views[frame, row, col]
        with self._building:
            return self._builder.build(view, plane)

    def _reduce(self, frame: int, row: int, col: int) -> NDArray[np.uint8]:
        size_px = self.width_px, self.height_px
        return np.stack([reduced(channel, size_px) for channel in self._views[frame, row, col]])

    def _reduce_map(self, frame: int, row: int, col: int) -> NDArray[np.int8]:
        rows, cols = size_of(self.height_px, self.width_px)
        return reduced_disparity(
            self._disparity[frame, row, col],
            (cols, rows),
            edge=EDGE_PX / abs(self.field.disparity_scale_px),
        )
