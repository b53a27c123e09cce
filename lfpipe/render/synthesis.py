"""Views between the stored views, and a little beyond them.

A viewpoint is (row, col), fractional, in grid steps. Whole numbers are the stored views, which every method returns bit for bit.
Between them a stored view b is warped backwards along its own disparity d (px per grid step, nearer is positive):

    picture(x, y) = view_b(x + d * (col - b_col), y + d * (row - b_row)),   d taken where it lands (fixed point)

All methods work on single planes at the light field's resolution, in blocks of 2x2 pixels; disparity is refined at its own lower
resolution.
"""

from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config.quality import WARPS
from lfpipe.render.blocks import Blocks, size_of
from lfpipe.render.view_mean import ViewMean
from lfpipe.render.view_weights import Position, ViewWeight, view_weights
from lfpipe.render.warper import Warper
from lfpipe.scene.lightfield import LightField

Source = Callable[[int, int], NDArray[np.uint8]]  # a plane of the stored view (row, col)


def shifted(plane: NDArray[np.uint8], dy: int, dx: int, out: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """out[y, x] = plane[y + dy, x + dx], its border repeated outwards. Returns out."""
    height, width = plane.shape
    dy, dx = min(max(dy, 1 - height), height - 1), min(max(dx, 1 - width), width - 1)
    y0, y1, x0, x1 = max(0, -dy), min(height, height - dy), max(0, -dx), min(width, width - dx)
    out[y0:y1, x0:x1] = plane[y0 + dy : y1 + dy, x0 + dx : x1 + dx]
    out[y0:y1, :x0] = out[y0:y1, x0 : x0 + 1]
    out[y0:y1, x1:] = out[y0:y1, x1 - 1 : x1]
    out[:y0] = out[y0]
    out[y1:] = out[y1 - 1]
    return out


class Synthesiser:
    """Planes of a light field from any viewpoint."""

    def __init__(self, field: LightField, method: str) -> None:
        self.method = method
        self._rows, self._cols = field.rows, field.cols
        self._centre = ((field.rows - 1) / 2, (field.cols - 1) / 2)
        self._warper = Warper(field) if method in WARPS else None
        size = (field.height_px, field.width_px)
        self._parts = [np.empty(size, np.uint8) for _ in range(4)]
        self._cross: list[NDArray[np.uint8]] = []  # the cross-fade at pixels of unknown disparity
        self._blocks = Blocks(*size)
        self._mean = ViewMean(*size) if method == "best" else None
        self._made = [np.empty((*size_of(*size), 4), np.uint8) for _ in range(4)]
        self._part = np.empty((*size_of(*size), 4), np.uint8)

    def render(
        self, position: Position, frame: int, zero_plane_px: float, sources: Sequence[Source], outs: Sequence[NDArray[np.uint8]]
    ) -> list[NDArray[np.uint8]]:
        """One plane for each source, at most four, seen from position.

        zero_plane_px: disparity that lies in the plane of the screen. outs: uint8 (height, width) each, to draw into. Returns the
        planes: an element of outs, or the stored plane itself if that is the picture.
        """
        used = view_weights(self.method, position, self._rows, self._cols)
        if self._warper is None:
            return self._faded(used, zero_plane_px, sources, outs)
        return self._warped(self._warper, used, position, frame, zero_plane_px, sources, outs)

    def _faded(
        self, used: list[ViewWeight], zero_plane_px: float, sources: Sequence[Source], outs: Sequence[NDArray[np.uint8]]
    ) -> list[NDArray[np.uint8]]:
        """The weighted sum of the stored views, each shifted as a whole to its zero plane."""
        made: list[NDArray[np.uint8]] = []
        total = 0.0
        for view in used:
            total += view.weight
            dy, dx = (round(zero_plane_px * (c - p)) for c, p in zip(self._centre, (view.row, view.col), strict=True))
            part = [source(view.row, view.col) for source in sources]
            if dy or dx:
                into = self._parts if made else outs
                part = [shifted(plane, dy, dx, to) for plane, to in zip(part, into, strict=False)]
            if made:
                for k, plane in enumerate(part):
                    cv2.addWeighted(plane, view.weight / total, made[k], 1 - view.weight / total, 0.0, outs[k])
                made = list(outs[: len(part)])
            else:
                made = part
        return made

    def _warped(
        self,
        warper: Warper,
        used: list[ViewWeight],
        position: Position,
        frame: int,
        zero_plane_px: float,
        sources: Sequence[Source],
        outs: Sequence[NDArray[np.uint8]],
    ) -> list[NDArray[np.uint8]]:
        """Warps each view along its own disparity and combines them in blocks: by their weights, or by the mean of the views that
        see the point."""
        shift = (zero_plane_px * (self._centre[0] - position[0]), zero_plane_px * (self._centre[1] - position[1]))
        mean, drawn, total = self._mean, list(outs[: len(sources)]), 0.0
        if mean is not None:
            mean.clear(len(drawn))
        for view in used:
            steps = warper.offset(view, position)
            if steps == (0.0, 0.0) and not any(shift):
                return [source(view.row, view.col) for source in sources]
            warper.aim(frame, view, steps, shift)
            planes = [source(view.row, view.col) for source in sources]
            total += view.weight
            share = view.weight / total
            for band in warper.bands:
                x, y = warper.maps(band)
                reach = self._blocks.reach(y)
                if mean is not None:
                    mean.weigh(band.rows, warper.weights(band, view.weight, x, y), view.weight, x, y)
                    for k, plane in enumerate(planes):
                        self._blocks.sample(plane, x, reach, self._part[band.rows])
                        mean.add(k, band.rows, self._part[band.rows])
                    continue
                for plane, made, out in zip(planes, self._made, drawn, strict=False):
                    blocks = made[band.rows]
                    if share == 1:
                        self._blocks.sample(plane, x, reach, blocks)
                    else:
                        part = self._part[: len(blocks)]
                        self._blocks.sample(plane, x, reach, part)
                        cv2.addWeighted(part, share, blocks, 1 - share, 0.0, blocks)
                    if view is used[-1]:
                        self._blocks.pixels(blocks, out[2 * band.rows.start : 2 * band.rows.stop])
        if mean is not None:
            mean.planes(drawn)
        if not warper.known_around(frame, position):
            self._fade_unknown(warper, position, frame, zero_plane_px, sources, drawn)
        return drawn

    def _fade_unknown(
        self,
        warper: Warper,
        position: Position,
        frame: int,
        zero_plane_px: float,
        sources: Sequence[Source],
        drawn: list[NDArray[np.uint8]],
    ) -> None:
        """Replaces what was warped along no known disparity by the cross-fade."""
        every = view_weights("blend", position, self._rows, self._cols)
        found = warper.unknown(frame, every)
        if found is None:
            return
        box, share = found
        cut = np.s_[:, :] if zero_plane_px else box
        parts = [lambda row, col, source=source: source(row, col)[cut] for source in sources]
        self._cross = self._cross or [np.empty_like(part) for part in self._parts]
        plain = self._faded(every, zero_plane_px, parts, [part[cut] for part in self._cross])
        for out, part in zip(drawn, plain, strict=True):
            cv2.blendLinear(part[box] if zero_plane_px else part, out[box], share, 1 - share, out[box])
