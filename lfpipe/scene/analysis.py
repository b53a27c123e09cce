"""Analysis of a scene from its names and a few views, before all of them are read.

A few small views measure how much of them common motion explains, and whether anything moves
between them. Scores of held-out views select the rendering method (`render.plan`).
A folder may hold the user's statements about its views. They override detection, and settings of
the session override them:

    # lightfield.toml
    written_by = "lfpipe scene describe"
    [scene]
    layout = "numbered"
    grid = "9x9"

The keys are those of [scene], without `cache_dir`.
"""

import os
from collections.abc import Mapping
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.config.check import updated
from lfpipe.config.quality import METHODS
from lfpipe.config.tree import options
from lfpipe.errors import UserError
from lfpipe.files.pictures import STRIP_ROWS
from lfpipe.files.safe_files import read_text, toml_table, write_file
from lfpipe.host.files import is_file
from lfpipe.scene import layouts
from lfpipe.scene.lightfield import HARDLY_FIT, Depth
from lfpipe.scene.optical_flow import (
    SMALLEST_PX,
    FloatMap,
    Grey,
    flow,
    grey_views,
    present_lines,
    returned_flow,
    textured,
    without_shake,
)
from lfpipe.scene.orientation import Orientation, orient
from lfpipe.scene.source import GridTransform, SceneSource, ViewIndex, library_errors

FILE = "lightfield.toml"
WRITTEN_BY = "lfpipe scene describe"
KEYS = tuple(field.name for field in attrs.fields(config.Scene) if field.name != "cache_dir")
REMEDY = f"correct the file, or write it again: `{WRITTEN_BY} FOLDER --grid ROWSxCOLS`"


def stated(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The keys of [scene] that `lightfield.toml` in the folder at path states; empty if absent.

    Raises UserError if the file is not as described above.
    """
    file = Path(path) / FILE
    if not is_file(file):
        return {}
    table = toml_table(_text(file), str(file), REMEDY)
    values = table.pop("scene", {})
    written_by = table.pop("written_by", "")
    if table or not isinstance(values, dict) or not isinstance(written_by, str):
        odd = ", ".join(map(repr, table)) or "written_by, scene"
        raise UserError(f"{file}: expected written_by (text) and [scene], found {odd}", REMEDY)
    if unknown := [name for name in values if name not in KEYS]:
        raise UserError(f"{file}: scene.{unknown[0]} cannot be stated there", REMEDY)
    try:
        updated(config.Config(), {f"scene.{name}": value for name, value in values.items()})
    except UserError as error:
        raise UserError(f"{file}: {error.message}", REMEDY) from None
    return values


def describe_folder(folder: Path, settings: config.Scene) -> Path:
    """Writes the file that states every key of settings that is not its default; returns its path.

    Raises UserError if there is nothing to state, or if another program wrote the file.
    """
    import tomlkit

    values = {
        name: getattr(settings, name)
        for name in KEYS
        if getattr(settings, name) != options()[f"scene.{name}"].default
    }
    file = folder / FILE
    if not values:
        raise UserError(f"{folder}: nothing to state", "name a key, for example --grid 9x9")
    if is_file(file) and f'written_by = "{WRITTEN_BY}"' not in _text(file):
        raise UserError(
            f"{file}: exists, and `{WRITTEN_BY}` did not write it", "edit it, or move it away"
        )
    document = tomlkit.document()
    document["written_by"] = WRITTEN_BY
    document["scene"] = values
    write_file(file, tomlkit.dumps(document).encode(), 0o644)
    return file


def _text(file: Path) -> str:
    return read_text(file, str(file), REMEDY)


# Share of the detail that common motion explains, below which views hardly fit together. Light
# fields, also with wide baselines or held by hand: at least 0.64, the shared and the demo scenes
# 0.85; unrelated pictures: at most 0.21, portraits of several people 0.14 to 0.4.
FITS = 0.3
_FAR = 0.6  # share of a pair's detail that flow finds, below which blocks are matched
_LOOSE_PX, _LOOSE_SHARE = 1.0, 0.2  # tolerance of the flow
_NOTHING_PX = 0.3  # between the farthest views: less motion counts as none
_FEWEST_POINTS = 100  # of detail, to measure motion
# minimum correlation of a matched block, and its lead over the second-best position
_FOUND, _LEADS = 0.75, 0.08
_FEWEST_BLOCKS = 6


@attrs.frozen(kw_only=True)
class Measurements:
    """Measurements of a few small views of a scene."""

    explained: float  # share of the detail that common motion explains
    moved_px: float  # motion between the farthest views, of nearly all of their detail
    far: tuple[float, float] | None = None  # motion that flow misses, in shares of the width


def _moved_px(a: Grey, b: Grey) -> float:
    """Motion of nearly all detail common to two views; infinity if there is too little."""
    ahead, confirmed = returned_flow(a, b)
    detail = textured(a)
    sure = confirmed & detail
    if np.count_nonzero(sure) < max(_FEWEST_POINTS, 0.5 * np.count_nonzero(detail)):
        return np.inf
    return float(np.percentile(np.hypot(*ahead[sure].T), 97))


def _match_x(a: Grey, b: Grey, y: int, x: int, side: int) -> int | None:
    """The x in b of the block of a at (y, x); None unless the match is unique, and level."""
    top = max(0, y - side // 2)
    strip, block = b[top : y + side + side // 2], a[y : y + side, x : x + side]
    alike = cv2.matchTemplate(strip, block, cv2.TM_CCOEFF_NORMED)
    _, best, _, (across, down) = cv2.minMaxLoc(alike)
    alike[:, max(0, across - side // 2) : across + side // 2 + 1] = -1
    level = abs(top + down - y) <= 2
    return across if level and best > _FOUND and best - float(alike.max()) > _LEADS else None


def _far(a: Grey, b: Grey, ahead: FloatMap) -> tuple[float, float] | None:
    """The range of motion along x, in shares of the width, of blocks of a that are matched in b and
    back, but that the flow misses; None if there are too few.
    """
    height, width = a.shape
    side = min(height, width) // 7
    moves, missed = [], []
    for y, x in product(range(side // 2, height - side, side), range(0, width - side, side)):
        there = _match_x(a, b, y, x, side) if a[y : y + side, x : x + side].std() > 8 else None
        back = None if there is None else _match_x(b, a, y, there, side)
        if there is not None and back is not None and abs(back - x) <= 2:
            flowed = float(np.median(ahead[y : y + side, x : x + side, 0]))
            moves.append((there - x) / width)
            missed.append(abs(flowed - (there - x)) > 2)
    if len(moves) < _FEWEST_BLOCKS or np.mean(missed) < 0.5:
        return None
    low, high = np.percentile(moves, (5, 95)).tolist()
    return low, high


def _pair(a: Grey, b: Grey) -> Measurements:
    """As `_triple`, for two views: the share of the detail of one that is found in the other."""
    ahead, confirmed = returned_flow(a, b)
    detail = textured(a)
    explained = float(confirmed[detail].mean()) if detail.any() else 1.0
    return Measurements(
        explained=explained,
        moved_px=_moved_px(a, b),
        far=_far(a, b, ahead) if explained < _FAR else None,
    )


def _triple(before: Grey, middle: Grey, after: Grey) -> float:
    """The share of the middle view's detail that one disparity explains: its motion to the others
    is equal and opposite, and along the line of views.
    """
    detail = textured(middle)
    if not detail.any():
        return 1.0
    to_before, to_after = (flow(middle, other)[detail] for other in (before, after))
    y, x = np.nonzero(detail)
    sideways = np.abs(to_after[:, 0]).mean() >= np.abs(to_after[:, 1]).mean()
    along, beside = (to_after[:, k] for k in ((0, 1) if sideways else (1, 0)))
    off = np.hypot(*(without_shake(x, y, (to_before + to_after)[:, k]) for k in (0, 1)))
    loose = _LOOSE_PX + _LOOSE_SHARE * np.abs(along)
    return float(((off < loose) & (np.abs(without_shake(x, y, beside)) < loose)).mean())


def measure_views(source: SceneSource) -> Measurements | None:
    """Measurements from a few small views; None if there are too few, or they are too small."""
    if min(source.height_px, source.width_px) < SMALLEST_PX:
        return None
    grey = grey_views(source)
    lines = [[grey(*at) for at in line] for line in present_lines(source) if len(line) > 1]
    if not lines:
        return None
    if max(map(len, lines)) == 2:
        pairs = [_pair(*line) for line in lines]
        return Measurements(
            explained=float(np.median([pair.explained for pair in pairs])),
            moved_px=max(pair.moved_px for pair in pairs),
            far=pairs[0].far if len(pairs) == 1 else None,
        )
    shares = [
        _triple(*line[at - 1 : at + 2])
        for line in lines
        for at in {max(1, len(line) // 5), len(line) // 2, min(len(line) - 2, 4 * len(line) // 5)}
        if len(line) > 2
    ]
    return Measurements(
        explained=float(np.median(shares)),
        moved_px=max(_moved_px(line[0], line[-1]) for line in lines),
    )


def plausible(source: SceneSource) -> tuple[SceneSource, Measurements | None]:
    """The source, with a note if its views hardly fit together, and measurements of a few views.
    Pictures without motion between them become one view. A format that defines a light field is
    not measured.
    """
    measured = (
        measure_views(source) if not source.certain or source.rows * source.cols == 2 else None
    )
    if measured is None:
        return source, None
    if measured.far is not None:
        share = max(map(abs, measured.far))
        doubt = (
            f"the views are too far apart ({share:.0%} of the width): no views are made between"
            " them"
        )
        doubts = filter(None, (source.doubt, doubt))
        return attrs.evolve(source, doubt="; ".join(doubts)), measured
    if measured.explained < FITS:
        return attrs.evolve(source, notes=(*source.notes, HARDLY_FIT)), measured
    if measured.moved_px < _NOTHING_PX:
        return attrs.evolve(
            source,
            rows=1,
            cols=1,
            read=lambda frame, row, col: source.read(frame, *source.middle),
            small=None,
            missing=frozenset(),
            turn=GridTransform(),
            turn_by="there is one view",
            coordinates=None,
            truth={},
            doubt="nothing moves between these pictures: one of them is shown",
        ), measured
    return source, measured


WORTH_DB = 0.25  # minimum gain of a costlier method: a smaller one is invisible
WARPED_PX = 0.5  # minimum disparity to warp if no view can be held out
# Minimum share of a pair's disparity that both views confirm: profiling/results/synthesis.md
CONFIRMED = 0.5
BLEND_PX = 2.0  # maximum disparity at which a cross-fade shows hardly any double edges


def best_method(scores: Mapping[str, float], reach_px: float, has_disparity: bool) -> str:
    """The method that `auto` selects for a scene of several views.

    scores: PSNR in dB of held-out views by method. Selects the cheapest method that no costlier
    one beats by WORTH_DB. Without scores, the largest disparity, reach_px, decides.
    """
    if scores:
        enough_db = max(scores.values()) - WORTH_DB
        return next(name for name in reversed(METHODS) if scores.get(name, -np.inf) >= enough_db)
    if has_disparity and reach_px >= WARPED_PX:
        return "warp2"
    return "blend" if reach_px <= BLEND_PX else "nearest"


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
    used = {  # where the settings have defaults; the depth order is state of the session
        f"scene.{name}": value
        for name, value in values.items()
        if name != "invert_depth" and getattr(scene, name) == options()[f"scene.{name}"].default
    }
    scene = updated(attrs.evolve(config.Config(), scene=scene), used).scene
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
    for (row, col), read in () if source.rendered else source.truth.items():
        values = read()
        most = float(np.abs(values).max())  # NaN if one of them is
        if values.shape != size or not most <= max(size):
            raise UserError(
                f"{source.path}: true disparity of the view in row {row} column {col} has"
                f" {values.shape[1]}x{values.shape[0]} values of up to {most:g} px per view, but"
                f" the views have {size[1]}x{size[0]} px",
                "remove the map to have disparity estimated",
            )
