"""The planes that make up a picture: stored channels without a copy, others built on first use and cached while they fit."""

from collections import OrderedDict

import numpy as np
from numpy.typing import NDArray

from lfpipe.render.anaglyph import Plane, PlaneBuilder
from lfpipe.scene.lightfield import LightField

BUDGET_BYTES = 64 << 20


def stored_channels(field: LightField, plane: Plane) -> tuple[int, ...]:
    """Stored channels of a plane. Weights sum to 1: every plane of a grey view is the view."""
    return (0,) if field.channels == 1 else plane.channels


class PlaneStore:
    """Planes of stored views, built lazily: views that are not shown cost nothing, and memory is bounded."""

    def __init__(self, field: LightField, budget_bytes: int = BUDGET_BYTES) -> None:
        self._views = np.asarray(field.views)  # a plain view of the map: indexing an np.memmap costs microseconds
        self._field = field
        self._builder = PlaneBuilder(field.height_px, field.width_px)
        self._room = max(8, budget_bytes // max(1, field.height_px * field.width_px))
        self._built: OrderedDict[tuple[int, int, int, Plane], NDArray[np.uint8]] = OrderedDict()

    def get(self, frame: int, row: int, col: int, plane: Plane) -> NDArray[np.uint8]:
        """uint8 (height, width), read-only. It stays valid for at least the next seven calls."""
        channels = stored_channels(self._field, plane)
        if len(channels) == 1:
            stored: NDArray[np.uint8] = self._views[frame, row, col, channels[0]]
            return stored
        place = (frame, row, col, plane)
        found = self._built.get(place)
        if found is not None:
            self._built.move_to_end(place)
            return found
        full = len(self._built) >= self._room
        buffer = self._built.popitem(last=False)[1] if full else np.empty(self._views.shape[4:], np.uint8)
        self._builder.build(self._views[frame, row, col], plane, buffer)
        self._built[place] = buffer
        return buffer
