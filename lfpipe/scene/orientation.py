"""From file order to canonical order (row 0 top camera, column 0 left camera), with the evidence and its certainty."""

import math
from itertools import product
from statistics import NormalDist

import attrs
import numpy as np

from lfpipe import config
from lfpipe.scene.axis_evidence import LOWER, Axis, examine_axis, lower_is_nearer, same_way
from lfpipe.scene.disparity import mismatch
from lfpipe.scene.grey_views import LOOK_PX, grey_views, present_lines
from lfpipe.scene.optical_flow import SMALLEST_PX
from lfpipe.scene.source import SceneSource, Turn

_FLAT_PX = 0.05  # per step: smaller flow is noise
_ALONG = 2.0  # motion along an axis over motion across it
_ALIKE = 0.4  # correlation of rows and columns of a grid in order
_TOGETHER = 16  # places with evidence of occlusion in a line of views that count as one vote; half as many in a grid
_UNEVEN = 0.67  # loss of certainty by motion across a line of views over motion along it; half of that in a grid
_LOWER_SHARE = 0.45  # weight of the correlation of height with disparity
_TRUTH_LEADS = 0.2  # share by which true disparity matches better in one order than in all others
_SURE, _GUESS = 0.9, 0.7  # below these: undecided, with the likelier order shown; undecided, with the order of the files
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

    def facts(self, cols: int) -> dict[str, object]:
        """As manifests and `lfpipe scene info` have it. cols: of the canonical grid."""
        half_turn = {"half_turn": self.half_turn(cols), "half_turn_sure": not self.undecided}
        return {"by": self.by, "sure": self.sure, "said": self.said, "undecided": self.undecided, **half_turn}

    def half_turn(self, cols: int) -> bool:
        """Whether a canonical grid of this many columns is a half-turn of what a pack holds; "override" is packed as asked."""
        return self.by != "override" and (self.turn.cols if cols > 1 else self.turn.rows)

    def packed(self, cols: int) -> "Orientation":
        """The same with the turn of a pack: without the half-turn, which the session decides."""
        half = self.half_turn(cols)
        turn = attrs.evolve(self.turn, rows=self.turn.rows != half, cols=self.turn.cols != half)
        return attrs.evolve(self, turn=turn, detected=self.base)

    @property
    def base(self) -> Turn:
        """The turn without the user's setting: true disparity holds with it."""
        return self.turn if self.detected is None else self.detected


def _unknown(said: str, sure: float = 0.2, what: str = "the whole order") -> Orientation:
    return Orientation(Turn(), "nothing", sure, said, f"{what}; {_HELP}")


def _by_flow(source: SceneSource) -> Orientation:
    """Orientation from flow between a few views."""
    if min(source.height_px, source.width_px) < SMALLEST_PX:
        return _unknown("the views are too small for optical flow", 0.0)
    grey, lines = grey_views(source, LOOK_PX), present_lines(source)
    by_col, by_row = (examine_axis(lambda k, line=line: grey(*line[k]), len(line)) for line in lines)  # type: ignore[misc]
    moving = [axis for axis in (by_col, by_row) if axis is not None and axis.along_px > _FLAT_PX]
    if not moving:
        return _unknown("the views hardly differ", 0.0)
    across, down = (next((axis for axis in moving if axis.sideways == sideways), None) for sideways in (True, False))
    if len(moving) == 2:
        alike = same_way(*moving)
        if across is None or down is None or abs(alike) < _ALIKE:
            said = f"rows and columns of views hardly agree (correlation {alike:+.2f})"
            return _unknown(said, what="rows against columns, and the half-turn")
        said = f"motion along rows and columns agrees with correlation {alike:+.2f}"
        relative, sure, what = -1 if alike < 0 else 1, 0.5 + abs(alike) / 2, "the half-turn"
    else:
        if moving[0].along_px < _ALONG * moving[0].across_px:
            return _unknown("the views move across the line as much as along it")
        said = f"one line of views, {'side by side' if across else 'above one another'}"
        relative, sure, what = 1, 1.0, "its direction"
    sign, half_sure, why = _half_turn([(axis, 1 if axis is across else relative) for axis in moving])
    sure, undecided = min(sure, half_sure), []
    if len(moving) == 1 and by_col is not None and by_row is not None:
        sure = min(sure, 0.5)
        undecided.append("whether the grid is one: along one side of it the views hardly differ")
    if sure < _SURE:
        likely = "; what is shown is the likelier one" if half_sure > 0.5 else ""
        undecided.append(f"{what} (near and far exchanged){likely}; {_HELP}")
    transpose = moving[0].sideways != (moving[0] is by_col)
    turn = Turn(down is not None and sign * relative < 0, across is not None and sign < 0, transpose)
    grown = sign * source.width_px / grey(*lines[0][0]).shape[1]
    low, high = sorted(float(value) * grown for value in np.percentile((across or moving[0]).disparity, (1, 99)))
    return Orientation(turn, "flow", sure, f"{said}; {why}", "; ".join(undecided), disparity_px=(low, high))


def _half_turn(axes: list[tuple[Axis, int]]) -> tuple[int, float, str]:
    """(1 or -1 for the first axis, certainty, reason) of axes with their relative signs: by occlusion, and by height, because
    lower parts are usually nearer.

    Places along one edge agree with each other, so _TOGETHER of them count as one vote (normal approximation of a majority). No
    majority is surer than its share: glow, blur and repetition mislead whole scenes, however many their places. The two odds
    multiply, because the two kinds of evidence are independent. Motion across the axis is that of a camera held by hand, whose
    uneven steps put surfaces in wrong places.
    """
    right, wrong = (sum(side) for side in zip(*((a.right, a.wrong)[::sign] for a, sign in axes), strict=True))
    votes = max(1, right + wrong)
    share, hidden = right / votes, NormalDist().cdf((right - wrong) / math.sqrt(_TOGETHER * votes / len(axes)))
    hidden = min(hidden, max(share, 0.5)) if right > wrong else max(hidden, min(share, 0.5))
    lower = sum(sign * lower_is_nearer(axis.disparity, axis.reliable) for axis, sign in axes) / len(axes)
    lower = 0.5 + _LOWER_SHARE * lower if abs(lower) > LOWER else 0.5
    ahead = hidden * lower / max(1e-9, hidden * lower + (1 - hidden) * (1 - lower))
    uneven = max(axis.across_px / max(axis.along_px, 1e-6) for axis, _ in axes)
    sure = min(max(ahead, 1 - ahead), 1 - _UNEVEN * uneven / len(axes))
    if sure < _GUESS:
        return 1, 0.5, "nothing decides the half-turn, which exchanges near and far (`lfpipe scene sheet` shows both)"
    sign = 1 if ahead > 0.5 else -1
    said = []
    if sign * (right - wrong) > 0:
        said.append(f"near surfaces hide far ones so in {max(right, wrong)} of {right + wrong} places")
    if sign * (lower - 0.5) > 0:
        said.append("what stands lower in the pictures is nearer so, as it usually is")
    return sign, sure, "; ".join(said)


def _by_truth(source: SceneSource) -> tuple[Turn | None, float]:
    """The turn under which a true map matches its neighbours best, and its lead over the runner-up; (None, 0.0) without a map."""
    inner = [p for p in source.truth if 0 < p[0] < source.rows - 1 and 0 < p[1] < source.cols - 1]
    if not inner or min(source.height_px, source.width_px) < SMALLEST_PX:
        return None, 0.0
    row, col = min(inner, key=lambda p: abs(p[0] - source.rows // 2) + abs(p[1] - source.cols // 2))
    disparity = source.truth[row, col]()
    grey = grey_views(source)
    here, beside = grey(row, col), {s: grey(row + s[0], col + s[1]) for s in ((0, 1), (1, 0))}
    found: dict[Turn, float] = {}
    for turn in (Turn(*flags) for flags in product((False, True), repeat=3)):
        for step, there in beside.items():
            down, across = step[::-1] if turn.transpose else step
            canonical = -down if turn.rows else down, -across if turn.cols else across
            found[turn] = found.get(turn, 0.0) + float(mismatch(here, there, disparity, *canonical).mean())
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
    if source.turn is None:
        return _by_flow(source)
    truth, lead = _by_truth(source)
    if truth not in (None, source.turn) and lead > _TRUTH_LEADS:
        said = f"{source.turn_by}, but true disparity lands on the neighbouring views only when turned otherwise"
        return Orientation(truth, "truth", 0.9, said)
    if source.turn_firm or truth is not None:
        by = "coordinates" if source.coordinates is not None else "layout"
        said = source.turn_by + ("; true disparity lands on the neighbouring views so" if truth == source.turn else "")
        return Orientation(source.turn, by, 1.0 if truth == source.turn or by == "coordinates" else 0.9, said)
    flow = _by_flow(source)
    if flow.turn == source.turn:
        return Orientation(flow.turn, "layout", max(_SURE, flow.sure), f"{source.turn_by}; {flow.said}")
    if flow.sure >= _SURE:
        return attrs.evolve(flow, said=f"{source.turn_by}, but this one is turned: {flow.said}")
    return Orientation(source.turn, "layout", 0.7, f"{source.turn_by}; {flow.said}", flow.undecided)
