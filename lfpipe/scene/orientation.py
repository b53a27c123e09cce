"""From file order to canonical order (row 0 top camera, column 0 left camera), with the evidence and its certainty."""

from __future__ import annotations

import math
from itertools import product
from statistics import NormalDist

import attrs
import numpy as np

from lfpipe import config
from lfpipe.scene.disparity import SMALLEST_PX, mismatch
from lfpipe.scene.flow_check import Axis, examine_axis, lower_is_nearer, same_way
from lfpipe.scene.grey_views import LOOK_PX, grey_views, present_lines
from lfpipe.scene.source import SceneSource, Turn

_FLAT_PX = 0.05  # per step: smaller flow is noise
_ALONG = 2.0  # motion along an axis over motion across it
_ALIKE = 0.4  # correlation of rows and columns of a grid in order
_TOGETHER = 60  # pixels with evidence of occlusion that count as one vote
_UNEVEN, _UNEVEN_SURE = 0.25, 0.75  # motion across over motion along, as of a hand-held camera, and the certainty it allows
_LOWER, _LOWER_SHARE = 0.35, 0.4  # correlation above which lower parts count as nearer, and its weight
_SURE, _GUESS = 0.9, 0.6  # below these: undecided, with the likelier order shown; undecided, with the order of the files
_HELP = "scene.flip=rows, cols or both and scene.transpose=yes turn it"


@attrs.frozen
class Orientation:
    """turn: from file order to canonical. by: "override", "coordinates", "truth", "layout", "flow" or "nothing"; sure: 0..1;
    said: sentences a person can use; undecided: what the evidence does not settle, "" for nothing;
    detected: the turn without the user's setting, where that differs. disparity_px: lowest and highest that flow showed, px of
    a view per canonical grid step, or None."""

    turn: Turn
    by: str
    sure: float
    said: str
    undecided: str = ""
    detected: Turn | None = None
    disparity_px: tuple[float, float] | None = None

    @property
    def facts(self) -> dict[str, object]:
        """As manifests and `lfpipe scene info` have it."""
        return {"by": self.by, "sure": self.sure, "said": self.said, "undecided": self.undecided}

    @property
    def base(self) -> Turn:
        """The turn without the user's setting: true disparity holds with it."""
        return self.turn if self.detected is None else self.detected


def _by_flow(source: SceneSource) -> Orientation:
    """Orientation from flow between a few views."""
    if min(source.height_px, source.width_px) < SMALLEST_PX:
        return Orientation(Turn(), "nothing", 0.0, "the views are too small for optical flow", f"the whole order; {_HELP}")
    grey = grey_views(source, LOOK_PX)
    by_col, by_row = (examine_axis(lambda k, line=line: grey(*line[k]), len(line)) for line in present_lines(source))  # type: ignore[misc]
    axes = [axis for axis in (by_col, by_row) if axis is not None and axis.along_px > _FLAT_PX]
    if not axes:
        return Orientation(Turn(), "nothing", 0.0, "the views hardly differ", f"the whole order; {_HELP}")
    grown = source.width_px / grey(*present_lines(source)[0][0]).shape[1]
    if by_row is not None and by_col is not None and len(axes) == 2:
        return _two_axes(by_row, by_col, grown)
    axis = axes[0]
    if axis.along_px < _ALONG * axis.across_px:
        said = "the views move across the line as much as along it"
        return Orientation(Turn(), "nothing", 0.2, said, f"the whole order; {_HELP}")
    sign, sure, why = _half_turn([(axis, 1)])
    still = "" if by_row is None or by_col is None else "whether the grid is one: along one side of it the views hardly differ"
    # The line of views runs sideways (columns) or up and down (rows) once it is turned.
    turn = Turn(sign < 0 and not axis.sideways, sign < 0 and axis.sideways, axis.sideways != (axis is by_col))
    said = f"one line of views, {'side by side' if axis.sideways else 'above one another'}; {why}"
    undecided = "; ".join(filter(None, (still, _open("its direction", sure))))
    sure = min(sure, 0.5) if still else sure
    return Orientation(turn, "flow", sure, said, undecided, disparity_px=_range_px(axis, sign * grown))


def _open(what: str, sure: float) -> str:
    """What is undecided where the half-turn is not sure; "" where it is."""
    likely = "; what is shown is the likelier one" if sure > 0.5 else ""
    return "" if sure >= _SURE else f"{what} (near and far exchanged){likely}; {_HELP}"


def _half_turn(axes: list[tuple[Axis, int]]) -> tuple[int, float, str]:
    """(1 or -1 for the first axis, certainty, reason) of axes with their relative signs: by occlusion, and by height, because
    lower parts are usually nearer.

    Pixels at one edge agree with each other, so _TOGETHER of them count as one vote (normal approximation of a majority). No
    majority is surer than its share: glow, blur and repetition mislead whole scenes, however many their pixels. The two odds
    multiply, because the two kinds of evidence are independent.
    """
    votes = [(a.right, a.wrong) if sign > 0 else (a.wrong, a.right) for a, sign in axes]
    right, wrong = (sum(side) for side in zip(*votes, strict=True))
    hidden = NormalDist().cdf((right - wrong) / math.sqrt(_TOGETHER * max(1, right + wrong)))
    share = right / max(1, right + wrong)
    hidden = min(hidden, max(share, 0.5)) if right > wrong else max(hidden, min(share, 0.5))
    lower = lower_is_nearer(axes)
    lower = 0.5 + _LOWER_SHARE * lower if abs(lower) > _LOWER else 0.5
    ahead = hidden * lower / max(1e-9, hidden * lower + (1 - hidden) * (1 - lower))
    uneven = max(axis.across_px / max(axis.along_px, 1e-6) for axis, _ in axes)
    sure = min(max(ahead, 1 - ahead), _UNEVEN_SURE if uneven > _UNEVEN else 1.0)
    if sure < _GUESS:
        return 1, 0.5, "nothing decides the half-turn, which exchanges near and far (`lfpipe scene sheet` shows both)"
    sign = 1 if ahead > 0.5 else -1
    said = []
    if sign * (right - wrong) > 0:
        said.append(f"near surfaces hide far ones so in {max(right, wrong) / (right + wrong):.0%} of {right + wrong} pixels")
    if sign * (lower - 0.5) > 0:
        said.append("what stands lower in the pictures is nearer so, as it usually is")
    return sign, sure, "; ".join(said)


def _range_px(axis: Axis, grown: float) -> tuple[float, float]:
    """Lowest and highest disparity of an axis, in px of the stored view; grown: its size over that of the look, and the sign."""
    low, high = sorted(float(value) * grown for value in np.percentile(axis.disparity, (1, 99)))
    return low, high


def _two_axes(by_row: Axis, by_col: Axis, grown: float) -> Orientation:
    transpose = all(axis.along_px > _ALONG * axis.across_px for axis in (by_col, by_row))
    transpose = transpose and not by_col.sideways and by_row.sideways
    # After a transpose the file's rows are the canonical columns.
    across, down = (by_row, by_col) if transpose else (by_col, by_row)
    alike = same_way(across, down)
    if by_col.sideways == by_row.sideways or abs(alike) < _ALIKE:
        said = f"rows and columns of views hardly agree (correlation {alike:+.2f})"
        return Orientation(Turn(), "nothing", 0.2, said, f"rows against columns, and the half-turn; {_HELP}")
    relative = -1 if alike < 0 else 1
    sign, half_sure, why = _half_turn([(across, 1), (down, relative)])
    turn = Turn(rows=sign * relative < 0, cols=sign < 0, transpose=transpose)
    said = f"motion along rows and columns agrees with correlation {alike:+.2f}; {why}"
    sure = min(half_sure, 0.5 + abs(alike) / 2)
    return Orientation(turn, "flow", sure, said, _open("the half-turn", sure), disparity_px=_range_px(across, sign * grown))


def _by_truth(source: SceneSource) -> tuple[Turn, float] | None:
    """The turn under which a true map matches its neighbours best, and its lead over the runner-up."""
    inner = [p for p in source.truth if 0 < p[0] < source.rows - 1 and 0 < p[1] < source.cols - 1]
    if not inner or min(source.height_px, source.width_px) < SMALLEST_PX:
        return None
    row, col = min(inner, key=lambda p: abs(p[0] - source.rows // 2) + abs(p[1] - source.cols // 2))
    disparity = source.truth[row, col]()
    grey = grey_views(source)
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
    """The turn to canonical order: from the user's setting, else from coordinates or the layout, checked by true disparity, else
    from flow between a few views. Doubts of the layout are part of `undecided`."""
    found = _found(source)
    if source.doubt:
        undecided = "; ".join(filter(None, (source.doubt, found.undecided)))
        found = attrs.evolve(found, sure=min(found.sure, 0.5), undecided=undecided)
    turn = found.turn
    if scene.flip != "auto":
        turn = attrs.evolve(turn, rows=scene.flip in ("rows", "both"), cols=scene.flip in ("cols", "both"))
    if scene.transpose != "auto":
        turn = attrs.evolve(turn, transpose=scene.transpose == "yes")
    if scene.flip != "auto" or (scene.transpose != "auto" and turn != found.turn):
        said = f"set by scene.flip or scene.transpose; without that: {found.said}"
        return Orientation(turn, "override", 1.0, said, source.doubt, detected=found.turn)
    return found


def _found(source: SceneSource) -> Orientation:
    """Orientation without the user's setting."""
    if source.rows * source.cols == 1:
        return Orientation(Turn(), "layout", 1.0, "there is one view")
    truth = _by_truth(source)
    if source.turn is not None and not source.turn_firm and truth is None:
        flow = _by_flow(source)
        if flow.turn == source.turn:
            return Orientation(flow.turn, "layout", max(_SURE, flow.sure), f"{source.turn_by}; {flow.said}")
        if flow.sure >= _SURE:
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
