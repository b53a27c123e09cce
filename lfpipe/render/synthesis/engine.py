"""Views between the stored views, and slightly beyond them: which of them a picture is drawn from,
and how far their cameras are from its viewpoint.

A viewpoint is (row, col), fractional, in grid steps. Whole numbers are the stored views, which
every method returns bit for bit. Between them a stored view b is warped backwards along its own
disparity d (px per grid step, nearer is positive):

    picture(x, y) = view_b(x + d * (col - b_col), y + d * (row - b_row)),   d taken where it lands
    (fixed point)

All methods work on single planes at the drawn resolution, in blocks of 2x2 pixels; disparity is
refined at its own lower resolution.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config.quality import WARPS
from lfpipe.render.synthesis.scene_views import SceneViews, Source, size_of
from lfpipe.render.synthesis.viewpoint import Position, ViewWeight, cell_of, view_weights
from lfpipe.render.synthesis.warper import Blocks, Box, Warper, shifted
from lfpipe.scene.lightfield import LightField


class Cameras:
    """The cameras of a light field. eye: 0 left, 1 right; a program may have drawn a view for each
    of them.
    """

    def __init__(self, field: LightField) -> None:
        self.rows, self.cols = field.rows, field.cols
        self.centre = (field.rows - 1) / 2, (field.cols - 1) / 2
        """(row, col) of the middle of the grid."""
        self._drawn = field.eye_positions
        self._offsets = field.offsets.astype(np.float64)
        self._regular = not self._offsets.any()

    def weights(self, method: str, position: Position, eye: int) -> list[ViewWeight]:
        """The stored views of a picture."""
        if self._drawn is not None:
            return [ViewWeight(*divmod(eye, self.cols), 1.0)]
        return view_weights(method, position, self.rows, self.cols)

    def steps(self, view: ViewWeight, position: Position, eye: int) -> Position:
        """(row, col) steps from the view's camera to position. Camera offsets distort the
        coordinates: whole numbers are always the cameras themselves, and offsets between them are
        interpolated.
        """
        if self._drawn is not None:
            return position[0] - self._drawn[eye][0], position[1] - self._drawn[eye][1]
        if self._regular:
            return position[0] - view.row, position[1] - view.col
        r, up = cell_of(position[0], self.rows)
        c, right = cell_of(position[1], self.cols)
        r1, c1 = min(r + 1, self.rows - 1), min(c + 1, self.cols - 1)
        near, far = self._offsets[r], self._offsets[r1]
        bend = (1 - up) * ((1 - right) * near[c] + right * near[c1]) + up * (
            (1 - right) * far[c] + right * far[c1]
        )
        bend -= self._offsets[view.row, view.col]
        return position[0] - view.row + float(bend[0]), position[1] - view.col + float(bend[1])

    def shift_px(self, zero_px: float, at: Position) -> Position:
        """(down, right) by which what a camera at `at` sees moves to bring a disparity into the
        plane of the screen.
        """
        return zero_px * (self.centre[0] - at[0]), zero_px * (self.centre[1] - at[1])


Array = NDArray[np.uint8]


# A stored view in a cross-fade: its planes, its share of the sum of this layer and those below, and
# the offset of the sampled pixels in the planes, px down and right
Layer = tuple[list[Array], float, tuple[int, int]]


class Synthesiser:
    """Planes of a light field from any viewpoint. rows: of the picture, which are drawn."""

    def __init__(self, scene: SceneViews, method: str, rows: slice = slice(None)) -> None:
        self.method = method
        self.rows = slice(*rows.indices(scene.height_px))
        self._scene = scene
        self._cameras = Cameras(scene.field)
        self._warper = Warper(scene, self.rows) if method in WARPS else None
        height, width = scene.height_px, scene.width_px
        self._whole = slice(0, height), slice(0, width)
        self._blocks = Blocks(height, width)
        *self._sums, self._sample = (
            np.empty((*size_of(height, width), 4), np.uint8) for _ in range(5)
        )

    def reset(self) -> None:
        """Takes the disparities of the scene anew, which were replaced."""
        self._cameras = Cameras(self._scene.field)
        if self._warper is not None:
            self._warper.reset()

    def render(
        self,
        position: Position,
        frame: int,
        zero_plane_px: float,
        sources: Sequence[Source],
        outs: Sequence[Array],
        eye: int = 0,
    ) -> list[Array]:
        """One plane for each source, at most four, seen from position, by the left eye, 0, or the
        right one, 1, for which a program may have drawn a view.

        zero_plane_px: disparity in the plane of the screen. outs: uint8 (height, width)
        each, to draw its rows into. Returns the planes: an element of outs, the stored plane itself
        if that is the picture, or a shifted copy.
        """
        views = self._cameras.weights(self.method, position, eye)
        if self._warper is None:
            layers = self._layers(frame, views, zero_plane_px, sources)
            return self._faded(layers, self._whole, outs)
        shift = self._cameras.shift_px(zero_plane_px, position)
        drawn = list(outs[: len(sources)])
        total = 0.0
        for view in views:
            steps = self._cameras.steps(view, position, eye)
            planes = [source(frame, view.row, view.col) for source in sources]
            if steps == (0.0, 0.0) and not any(shift):
                return planes
            self._warper.aim(frame, view, steps, shift)
            total += view.weight
            self._warp(
                self._warper, view.weight / total, planes, drawn if view is views[-1] else []
            )
        # cross-fade the parts with unknown disparity
        layers = []
        for whole_box, whole_share in self._warper.unknown(frame, position, shift):
            box, share = _within(whole_box, whole_share, self.rows)
            if not share.size:
                continue
            if not layers:
                views = self._cameras.weights("blend", position, eye)
                layers = self._layers(frame, views, zero_plane_px, sources)
            scratch = [np.empty(share.shape, np.uint8) for _ in sources]
            for out, plane in zip(drawn, self._faded(layers, box, scratch), strict=True):
                cv2.blendLinear(plane, out[box], share, 1 - share, out[box])
        return drawn

    def _layers(
        self, frame: int, views: list[ViewWeight], zero_px: float, sources: Sequence[Source]
    ) -> list[Layer]:
        """The stored views of a cross-fade, each shifted as a whole to its zero plane."""
        layers: list[Layer] = []
        total = 0.0
        for view in views:
            total += view.weight
            down_px, right_px = self._cameras.shift_px(zero_px, (view.row, view.col))
            by = round(down_px), round(right_px)
            planes = [source(frame, view.row, view.col) for source in sources]
            layers.append((planes, view.weight / total, by))
        return layers

    def _faded(self, layers: list[Layer], box: Box, outs: Sequence[Array]) -> list[Array]:
        """A box of the layers' sum, one plane for each of their planes.

        outs: to draw into, of the box's size. Returns them, or the stored planes themselves.
        """
        faded: list[Array] = []
        for planes, share, by in layers:
            if any(by) or box is not self._whole:
                planes = [shifted(plane, *by, box) for plane in planes]
            if faded:
                for plane, below, out in zip(planes, faded, outs, strict=False):
                    cv2.addWeighted(plane, share, below, 1 - share, 0.0, out)
                planes = list(outs[: len(planes)])
            faded = planes
        return faded

    def _warp(self, warper: Warper, share: float, planes: list[Array], outs: list[Array]) -> None:
        """Warps planes of a view to the target view, and adds them in blocks, with the view's share
        of the sum so far. outs: to unpack into, after the last view.
        """
        for band in warper.bands:
            reach = self._blocks.reach(band, warper.most_px)
            x, y = warper.maps(band, reach[0])
            sample = self._sample[: len(x)]
            for k, plane in enumerate(planes):
                blocks = self._sums[k][band]
                if share == 1:
                    self._blocks.sample(plane, x, y, reach, blocks)
                else:
                    self._blocks.sample(plane, x, y, reach, sample)
                    cv2.addWeighted(sample, share, blocks, 1 - share, 0.0, blocks)
                if outs:
                    self._blocks.pixels(blocks, outs[k][2 * band.start : 2 * band.stop])


def _within(box: Box, share: NDArray[np.float32], rows: slice) -> tuple[Box, NDArray[np.float32]]:
    """The part of a box of the picture, and of the values in it, that lies in rows."""
    top, bottom = max(box[0].start, rows.start), min(box[0].stop, rows.stop)
    inside = slice(top, max(top, bottom))
    return (inside, box[1]), share[inside.start - box[0].start : inside.stop - box[0].start]
