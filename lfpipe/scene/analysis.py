"""Analysis of a scene from its names and a few views, before all of them are read."""

import os
from functools import cached_property
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import STRIP_ROWS
from lfpipe.scene import layouts
from lfpipe.scene.description import FILE, stated, with_stated
from lfpipe.scene.files import library_errors
from lfpipe.scene.lightfield import Depth
from lfpipe.scene.orientation import Orientation, orient
from lfpipe.scene.plausibility import Measurements, plausible
from lfpipe.scene.source import GridTransform, SceneSource, ViewIndex

SCREEN_GAMMA = 2.2  # for linear-light pictures: out = in ** (1 / gamma)
STATED = {"yes": True, "no": False}  # scene.invert_depth
FrameIndex = tuple[int, int, int]  # frame, row, column


@attrs.frozen(eq=False, slots=False, kw_only=True)
class AnalysedScene:
    """An analysed scene. The views are in the order of the pack, without inverted depth."""

    source: SceneSource
    orientation: Orientation
    gamma: float  # exponent of the scene's values
    gamma_by: str  # what determines it
    channels: int  # 1 or 3
    measured: Measurements | None = None

    @property
    def turn(self) -> GridTransform:
        """The transform from file order to the order of the pack."""
        return self.orientation.packed

    @property
    def too_far_apart(self) -> bool:
        """Whether the views are too far apart to interpolate between them."""
        return self.measured is not None and self.measured.far is not None

    @property
    def depth(self) -> Depth:
        """Depth range of the middle view, in the order of the pack; zeros if unknown."""
        return self.orientation.depth or Depth()

    @property
    def rows(self) -> int:
        return self.turn.grid(self.source.rows, self.source.cols)[0]

    @property
    def cols(self) -> int:
        return self.turn.grid(self.source.rows, self.source.cols)[1]

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the views: (frames, rows, cols, channels, height, width)."""
        return (
            self.source.frames,
            self.rows,
            self.cols,
            self.channels,
            self.source.height_px,
            self.source.width_px,
        )

    def file_index(self, row: int, col: int) -> ViewIndex:
        """The file index of a view of the pack."""
        return self.turn.file_index(row, col, self.rows, self.cols)

    @cached_property
    def present(self) -> NDArray[np.bool_]:
        """The grid indices that have a view, bool (rows, cols)."""
        present = np.ones((self.source.rows, self.source.cols), bool)
        for place in self.source.missing:
            present[place] = False
        return self.turn.applied(present)

    @cached_property
    def offsets(self) -> NDArray[np.float32]:
        """Camera offsets, as in LightField."""
        camera_positions = self.source.coordinates
        return (
            np.zeros((self.rows, self.cols, 2), np.float32)
            if camera_positions is None
            else grid_offsets(self.turn.applied(camera_positions))
        )

    @cached_property
    def views(self) -> list[FrameIndex]:
        """The present views of every frame."""
        return [
            (f, r, c)
            for f in range(self.source.frames)
            for r, c in np.argwhere(self.present).tolist()
        ]


def analyse_scene(path: str | os.PathLike[str], scene: config.Scene) -> AnalysedScene:
    """Analyses the scene at path. Raises UserError if there is none."""
    with library_errors(path):
        return analyse_source(*checked_source(path, scene))


def checked_source(
    path: str | os.PathLike[str], scene: config.Scene
) -> tuple[SceneSource, config.Scene]:
    """The scene at path as its layout describes it, and the settings completed by
    `lightfield.toml`. Raises UserError.
    """
    values = stated(path)
    scene = with_stated(scene, values)
    source = layouts.describe(path, scene)
    if values:
        file = Path(path) / FILE
        source = attrs.evolve(
            source,
            files=(*source.files, file),
            stated_inverted=STATED.get(values.get("invert_depth", "auto")),
            notes=(*source.notes, f"{FILE} states {', '.join(values)}"),
        )
    require_plausible_truth(source)
    return source, scene


def analyse_source(source: SceneSource, scene: config.Scene) -> AnalysedScene:
    """Analyses a few views."""
    source, measured = plausible(source)
    middle = source.read(source.telling, *source.middle)
    ends = (
        {(0, 0), (0, source.cols - 1), (source.rows - 1, source.cols - 1)}
        - {source.middle}
        - source.missing
    )
    grey = is_grey(middle) and (
        source.rendered or all(is_grey(source.read(source.telling, *place)) for place in ends)
    )
    order = orient(source, scene)
    if measured is not None and measured.far is not None:  # too far apart for optical flow
        width_px = source.width_px if order.packed.cols else -source.width_px
        low, high = sorted(round(width_px * move, 4) for move in measured.far)
        depth = Depth(min_px=low, max_px=high, border_low_px=low, border_high_px=high)
        order = attrs.evolve(order, depth=depth)
    gamma, gamma_by = 1.0, ""
    if scene.gamma != "auto":
        gamma, gamma_by = float(scene.gamma), "set by scene.gamma"
    elif source.linear:
        gamma, gamma_by = SCREEN_GAMMA, f"{source.layout} holds linear light"
    return AnalysedScene(
        source=source,
        orientation=order,
        gamma=gamma,
        gamma_by=gamma_by,
        channels=1 if grey else 3,
        measured=measured,
    )


def is_grey(pixels: NDArray[Any]) -> bool:
    """Whether a picture has one plane or three equal ones."""
    if pixels.ndim == 2:
        return True
    strips = (pixels[top : top + STRIP_ROWS] for top in range(0, len(pixels), STRIP_ROWS))
    return all(
        np.array_equal(s[..., 0], s[..., 1]) and np.array_equal(s[..., 1], s[..., 2])
        for s in strips
    )


def grid_offsets(camera_positions: NDArray[np.float64]) -> NDArray[np.float32]:
    """Camera positions minus those of the best regular grid, (rows, cols, 2) in steps (row, col);
    zeros if they span no grid.

    camera_positions: (rows, cols, 2) in canonical order, (down, right) in any unit, not finite if
    unknown.
    """
    out = np.zeros(camera_positions.shape, np.float32)
    row, col = np.nonzero(np.isfinite(camera_positions).all(axis=2))
    for axis, index in ((0, row), (1, col)):
        if len(np.unique(index)) > 1:
            step, first = np.polyfit(index, camera_positions[row, col, axis], 1)
            if abs(step) > 1e-9:
                out[row, col, axis] = (
                    camera_positions[row, col, axis] - first - step * index
                ) / step
    return np.clip(out, -0.49, 0.49)


def require_plausible_truth(source: SceneSource) -> None:
    """Raises UserError if a true disparity map differs in size from the views, contains NaN,
    exceeds a picture's side per view (such a range would flatten the whole scene), or cannot be
    read.
    """
    size = (source.height_px, source.width_px)
    remedy = "remove the map to have disparity estimated"
    for (row, col), read in () if source.rendered else source.truth.items():
        values = read()
        where = f"{source.path}: true disparity of the view in row {row} column {col}"
        if values.shape != size:
            raise UserError(
                f"{where} has {values.shape[1]}x{values.shape[0]} values, but the"
                f" views have {size[1]}x{size[0]} px",
                remedy,
            )
        if bad := int(np.count_nonzero(~np.isfinite(values))):
            raise UserError(f"{where}: {bad} of {values.size} values are NaN or infinite", remedy)
        if (most := float(np.abs(values).max())) > max(size):
            raise UserError(
                f"{where}: up to {most:g} px per view, but the views have {size[1]}x{size[0]} px",
                remedy,
            )
