"""From file order to canonical order (row 0 top camera, column 0 left camera), with the evidence and how sure it is."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from itertools import product

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.scene.disparity import SMALLEST_PX, Grey, mismatch
from lfpipe.scene.flow_check import Axis, examine_axis, same_way
from lfpipe.scene.source import SceneSource, Turn

_LUMA = np.array([[0.299, 0.587, 0.114]], np.float32)
_DARK = 0.2  # mean of a view below which it is lifted
_FLOW_WINS = 0.75  # certainty above which flow overrides the convention of a layout
_FLOW_PX = 1 << 21  # of a view: more tells nothing about the order of views
_FLAT_PX = 0.05  # per step: below this the flow is noise
_HELP = "scene.flip=rows, cols or both and scene.transpose=yes turn it"


@attrs.frozen
class Orientation:
    """turn: from file order to canonical. by: "override", "coordinates", "truth", "layout", "flow" or "nothing"; sure: 0..1;
    said: sentences a person can use; undecided: what the evidence does not settle, "" for nothing;
    detected: the turn without the user's setting, where that differs."""

    turn: Turn
    by: str
    sure: float
    said: str
    undecided: str = ""
    detected: Turn | None = None

    @property
    def base(self) -> Turn:
        """The turn without the user's setting: true disparity holds with it."""
        return self.turn if self.detected is None else self.detected


def _greys(source: SceneSource, most_px: float = math.inf) -> Callable[[int, int], Grey]:
    """Views by file place as the flow wants them: grey, 8 bit, and dark (linear-light) scenes lifted so that it finds texture.

    Those of more than most_px are made smaller.
    """
    scale = min(1.0, math.sqrt(most_px / (source.height_px * source.width_px)))

    def share(row: int, col: int) -> NDArray[np.float32]:
        picture = source.read(0, row, col)
        if scale < 1:
            picture = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        plane = picture if picture.ndim == 2 else cv2.transform(picture, _LUMA)
        return np.asarray(np.minimum(plane.astype(np.float32) * np.float32(1 / source.max_value), 1), np.float32)

    there = min(product(range(source.rows), range(source.cols)), key=lambda place: (place in source.missing, -sum(place)))
    lift = 0.5 if float(share(*there).mean()) < _DARK else 1.0

    @lru_cache(maxsize=64)
    def grey(row: int, col: int) -> Grey:
        return np.asarray(np.rint(255 * share(row, col) ** np.float32(lift)), np.uint8)

    return grey


def _by_flow(source: SceneSource) -> Orientation:
    """Orientation from flow between a few views."""
    if min(source.height_px, source.width_px) < SMALLEST_PX:
        return Orientation(Turn(), "nothing", 0.0, "the views are too small for optical flow", f"the whole order; {_HELP}")
    rows, cols, grey = source.rows, source.cols, _greys(source, _FLOW_PX)
    by_col = examine_axis(lambda c: grey(rows // 2, c), cols)
    by_row = examine_axis(lambda r: grey(r, cols // 2), rows)
    axes = [axis for axis in (by_row, by_col) if axis is not None and axis.along_px > _FLAT_PX]
    if not axes:
        return Orientation(Turn(), "nothing", 0.0, "the views hardly differ", f"the whole order; {_HELP}")
    if by_row is not None and by_col is not None and len(axes) == 2:
        return _two_axes(by_row, by_col)
    axis = axes[0]
    transpose = axis.sideways != (axis is by_col)
    turned = _signed([axis], [1])
    flip = turned[0] < 0
    # The line of views runs sideways (columns) or up and down (rows) once it is turned.
    turn = Turn(rows=flip and not axis.sideways, cols=flip and axis.sideways, transpose=transpose)
    said = f"one line of views, {'side by side' if axis.sideways else 'above one another'}; {turned[2]}"
    return Orientation(turn, "flow", turned[1], said, "" if turned[1] > 0.5 else f"its direction; {_HELP}")


def _signed(axes: list[Axis], relative: list[int]) -> tuple[int, float, str]:
    """(1 or -1 for the first axis, how sure, why), from occlusion and one-way motion of axes whose signs are tied by
    `relative`."""
    right = sum(a.right if r > 0 else a.wrong for a, r in zip(axes, relative, strict=True))
    wrong = sum(a.wrong if r > 0 else a.right for a, r in zip(axes, relative, strict=True))
    total = attrs.evolve(axes[0], right=right, wrong=wrong)
    if total.sign:
        share = max(right, wrong) / (right + wrong)
        return total.sign, share, f"near surfaces hide far ones so in {share:.0%} of {right + wrong} pixels"
    ways = {a.one_way * r for a, r in zip(axes, relative, strict=True)} - {0}
    if len(ways) == 1:
        return ways.pop(), 0.8, "everything moves one way, as parallel cameras see it"
    return 1, 0.5, "nothing decides the half-turn, which exchanges near and far"


def _two_axes(by_row: Axis, by_col: Axis) -> Orientation:
    transpose = by_col.along_px > 2 * by_col.across_px and by_row.along_px > 2 * by_row.across_px and not by_col.sideways
    transpose = transpose and by_row.sideways
    clear = by_col.sideways != by_row.sideways
    # After a transpose the file's rows are the canonical columns.
    across, down = (by_row, by_col) if transpose else (by_col, by_row)
    alike = same_way(across, down)
    relative = -1 if alike < 0 else 1
    sign, half_sure, why = _signed([across, down], [1, relative])
    turn = Turn(rows=sign * relative < 0, cols=sign < 0, transpose=transpose)
    if not clear or abs(alike) < 0.4:
        said = f"rows and columns of views hardly agree (correlation {alike:+.2f})"
        return Orientation(Turn(), "nothing", 0.2, said, f"rows against columns, and the half-turn; {_HELP}")
    said = f"motion along rows and columns agrees with correlation {alike:+.2f}; {why}"
    undecided = "" if half_sure > 0.5 else f"the half-turn (near and far exchanged); {_HELP}"
    return Orientation(turn, "flow", min(half_sure, abs(alike)), said, undecided)


def _by_truth(source: SceneSource) -> tuple[Turn, float] | None:
    """The turn under which a true map lands best on its neighbours, and how much better than the runner-up it does."""
    inner = [p for p in source.truth if 0 < p[0] < source.rows - 1 and 0 < p[1] < source.cols - 1]
    if not inner or min(source.height_px, source.width_px) < SMALLEST_PX:
        return None
    row, col = min(inner, key=lambda p: abs(p[0] - source.rows // 2) + abs(p[1] - source.cols // 2))
    disparity = source.truth[row, col]()
    grey = _greys(source)
    here, beside = grey(row, col), {s: grey(row + s[0], col + s[1]) for s in ((0, 1), (1, 0))}
    found: dict[Turn, float] = {}
    for flip_rows, flip_cols, transpose in product((False, True), repeat=3):
        total = 0.0
        for (d_row, d_col), there in beside.items():
            down, across = (d_col, d_row) if transpose else (d_row, d_col)
            down, across = (-down if flip_rows else down), (-across if flip_cols else across)
            total += float(mismatch(here, there, disparity, down, across).mean())
        found[Turn(flip_rows, flip_cols, transpose)] = total
    best, second = sorted(found, key=lambda turn: found[turn])[:2]
    return best, 1 - found[best] / max(found[second], 1e-9)


def orient(source: SceneSource, scene: config.Scene) -> Orientation:
    """The way to canonical order: the user's setting first, then coordinates or the layout, checked by true disparity, then
    flow between a few views."""
    found = _found(source)
    turn = found.turn
    if scene.flip != "auto":
        turn = attrs.evolve(turn, rows=scene.flip in ("rows", "both"), cols=scene.flip in ("cols", "both"))
    if scene.transpose != "auto":
        turn = attrs.evolve(turn, transpose=scene.transpose == "yes")
    if scene.flip != "auto" or (scene.transpose != "auto" and turn != found.turn):
        said = f"set by scene.flip or scene.transpose; without that: {found.said}"
        return Orientation(turn, "override", 1.0, said, detected=found.turn)
    return found


def _found(source: SceneSource) -> Orientation:
    """Orientation without the user's setting."""
    if source.rows * source.cols == 1:
        return Orientation(Turn(), "layout", 1.0, "there is one view")
    truth = _by_truth(source)
    if source.turn is not None and not source.turn_firm and truth is None:
        flow = _by_flow(source)
        if flow.turn == source.turn:
            return Orientation(flow.turn, "layout", max(0.9, flow.sure), f"{source.turn_by}; {flow.said}")
        if flow.sure > _FLOW_WINS:
            return attrs.evolve(flow, said=f"{source.turn_by}, but this one is turned: {flow.said}")
        return Orientation(source.turn, "layout", 0.7, f"{source.turn_by}; {flow.said}", flow.undecided)
    if source.turn is not None:
        by = "coordinates" if source.coordinates is not None else "layout"
        if truth is not None and truth[0] != source.turn and truth[1] > 0.2:
            said = f"{source.turn_by}, but true disparity lands on the neighbouring views only when turned otherwise"
            return Orientation(truth[0], "truth", 0.9, said)
        agrees = truth is not None and truth[0] == source.turn
        said = source.turn_by + ("; true disparity lands on the neighbouring views so" if agrees else "")
        return Orientation(source.turn, by, 1.0 if agrees or by == "coordinates" else 0.9, said)
    return _by_flow(source)
