"""Which stored views a picture is drawn from, and how far their cameras are from its viewpoint."""

import numpy as np

from lfpipe.render.synthesis.viewpoint import Position, ViewWeight, cell_of, view_weights
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

    def replace(self, field: LightField) -> None:
        """Takes the viewpoints of views that a program drew anew."""
        self._drawn = field.eye_positions

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
