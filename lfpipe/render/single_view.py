"""The view of one camera at any position of a light field's grid, in its own colours."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lfpipe.render.compositor import method_for
from lfpipe.render.synthesis import Synthesiser
from lfpipe.scene.lightfield import LightField


class ViewRenderer:
    """Draws views of one light field; keeps its tables from view to view. method: as `render.method`. zero_plane_px: disparity
    that stays in place from view to view; only warps shift by it."""

    def __init__(self, field: LightField, method: str = "auto", zero_plane_px: float = 0.0) -> None:
        self._field, self._zero_plane_px = field, zero_plane_px
        self._synthesiser = Synthesiser(field, method_for(field, method))
        self._outs = [np.empty((field.height_px, field.width_px), np.uint8) for _ in range(field.channels)]

    def render(self, row: float, col: float, frame: int = 0) -> NDArray[np.uint8]:
        """The view at (row, col), fractions allowed, as a new uint8 (height, width, 3) BGR. frame: of a light-field video."""
        field = self._field
        number = frame % field.frames

        def plane(channel: int) -> Callable[[int, int], NDArray[np.uint8]]:
            return lambda r, c: np.asarray(field.views[number, r, c, channel])

        sources = [plane(k) for k in range(field.channels)]
        planes = self._synthesiser.render((row, col), number, self._zero_plane_px, sources, self._outs)
        return np.stack(planes * 3 if len(planes) == 1 else planes[::-1], axis=2)


def render_view(field: LightField, row: float, col: float, method: str = "auto", frame: int = 0) -> NDArray[np.uint8]:
    """See `ViewRenderer.render`."""
    return ViewRenderer(field, method).render(row, col, frame)
