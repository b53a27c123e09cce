"""From file order to canonical order (row 0 top camera, column 0 left camera), with the evidence.

In canonical order a step to the next column moves everything sideways by -d and a step to the next row moves it upwards by the
same d. So the direction of motion shows a transpose, and the sign of the correlation of the two the flip of one axis: pictures
prove both. The half-turn changes neither; it exchanges near and far. Formats, coordinates and true disparity say it; pictures
show it only where a near surface visibly hides a far one.
"""

import math
from collections.abc import Callable
from itertools import product

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.scene.disparity import border_range, mismatch, view_disparity
from lfpipe.scene.grey_views import LOOK_PX, grey_views, present_lines
from lfpipe.scene.optical_flow import SMALLEST_PX, FloatMap, Grey, Mask, confirmed, flow, textured
from lfpipe.scene.source import SceneSource, Turn

UNMISTAKABLE, AGAINST = 10, 10  # places; see `hides`
LEAST_PX, ALONG = 0.05, 2.0  # motion per step that is no noise; motion along a line of views over motion across it
ALIKE = 0.4  # least correlation of the disparities along rows and along columns of a grid in order
TRUTH_LEADS = 0.2  # share by which true disparity matches better in one order than in all others
SPREAD_PX, OVERLAP_PX = 3.0, 1.5  # flow that separates surfaces; one lands on another that is this much nearer
DIFFERENT, SAME, WRONG = 10, 3, 6  # grey levels between two surfaces; between a surface and what is seen
SIDE, MAJORITY = 20, 3  # places along the shorter side of a view, with one vote each; its pixels must agree by this many
FEWEST = 200  # reliable pixels; fewer mean nothing
_TURN_HELP = "scene.flip=rows or cols and scene.transpose=yes turn it"
_DEPTH_HELP = "near and far: press d in the window, or set scene.half_turn=yes, if they are exchanged"


@attrs.frozen
class Orientation:
    """turn: from file order to canonical. by: "override", "coordinates", "truth", "layout", "flow" or "nothing". said: sentences
    a person can use. undecided: what the evidence does not settle, "" for nothing. half_turn_sure: whether it settles near and
    far. detected: the turn without the user's setting, where that differs. disparity_px: lowest and highest that flow showed, px
    of a view per canonical grid step, or None; border_px: the same at the left and right border, zeros if not known."""

    turn: Turn
    by: str
    said: str
    undecided: str = ""
    half_turn_sure: bool = True
    detected: Turn | None = None
    disparity_px: tuple[float, float] | None = None
    border_px: tuple[float, float] = (0.0, 0.0)

    @property
    def sure(self) -> bool:
        return not self.undecided

    def facts(self, cols: int) -> dict[str, object]:
        """As manifests and `lfpipe scene info` have it. cols: of the canonical grid."""
        half_turn = {"half_turn": self.half_turn(cols), "half_turn_sure": self.half_turn_sure}
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


@attrs.frozen
class Axis:
    """One axis of the file grid, seen from its middle view.

    sideways: views differ along x (else along y). disparity: float32 (h, w), px per step as if file order were canonical.
    reliable: bool (h, w), where the flow is confirmed. along_px, across_px: motion per step along the axis and across it.
    right, wrong: places where the hidden surface is the farther one, and the nearer one.
    """

    sideways: bool
    disparity: FloatMap
    reliable: Mask
    along_px: float
    across_px: float
    right: int
    wrong: int


def hides(right: int, wrong: int) -> int:
    """1 if near surfaces hide far ones unmistakably, -1 if far ones hide near ones, 0 if that stays open.

    right, wrong: places. UNMISTAKABLE of them must agree, and each against cancels AGAINST: where glow, blur and repetition
    mislead, many places are wrong at once. Right / wrong places of ../shared/data/lightfields: antinous 101 / 1,
    stillLife 74 / 1, lytro 50 / 3, newshot01 43 / 2, monasroom 49 / 0, all sure; quilt 80 / 28 and lego knights 136 / 29
    (repetition), toys 6 / 0, airplane 0 / 2 and illum_field 0 / 0 stay open. Made layers: 75 / 0, 33 / 0, 260 / 0, 22 / 0,
    31 / 0 sure; 0 / 0 open.
    """
    if right - AGAINST * wrong >= UNMISTAKABLE:
        return 1
    return -1 if wrong - AGAINST * right >= UNMISTAKABLE else 0


def orient(source: SceneSource, scene: config.Scene) -> Orientation:
    """The turn to canonical order: from the user's setting, else from coordinates or the layout, checked by true disparity, else
    from flow between a few views. Doubts of the layout are part of `undecided`."""
    found = _detected(source)
    if source.doubt:
        found = attrs.evolve(found, undecided="; ".join(filter(None, (source.doubt, found.undecided))), half_turn_sure=False)
    turn = found.turn
    if scene.flip != "auto":
        turn = attrs.evolve(turn, rows=scene.flip in ("rows", "both"), cols=scene.flip in ("cols", "both"))
    if scene.transpose != "auto":
        turn = attrs.evolve(turn, transpose=scene.transpose == "yes")
    if scene.flip != "auto" or (scene.transpose != "auto" and turn != found.turn):
        said = f"set by scene.flip or scene.transpose; without that: {found.said}"
        return Orientation(turn, "override", said, source.doubt, detected=found.turn)
    return found


def _detected(source: SceneSource) -> Orientation:
    """Orientation without the user's setting."""
    if source.rows * source.cols == 1:
        return Orientation(Turn(), "layout", "there is one view")
    if source.turn is None:
        return _by_flow(source)
    truth, lead = _by_truth(source)
    if truth not in (None, source.turn) and lead > TRUTH_LEADS:
        said = f"{source.turn_by}, but true disparity lands on the neighbouring views only when turned otherwise"
        return Orientation(truth, "truth", said)
    if source.turn_firm or truth is not None:
        by = "coordinates" if source.coordinates is not None else "layout"
        landing = "; true disparity lands on the neighbouring views so" if truth == source.turn else ""
        return Orientation(source.turn, by, source.turn_by + landing)
    flow_says = _by_flow(source)
    if flow_says.turn == source.turn:
        return Orientation(flow_says.turn, "layout", f"{source.turn_by}; {flow_says.said}")
    if flow_says.sure:
        return attrs.evolve(flow_says, said=f"{source.turn_by}, but this one is turned: {flow_says.said}")
    return Orientation(source.turn, "layout", f"{source.turn_by}; {flow_says.said}", flow_says.undecided, False)


def _by_truth(source: SceneSource) -> tuple[Turn | None, float]:
    """The turn under which a true map matches its neighbours best, and its lead over the runner-up; (None, 0.0) without a map."""
    inner = [
        (r, c) for r, c in source.truth
        if 0 < r < source.rows - 1 and 0 < c < source.cols - 1 and not {(r, c + 1), (r + 1, c)} & source.missing
    ]  # fmt: skip
    if not inner or min(source.height_px, source.width_px) < SMALLEST_PX:
        return None, 0.0
    row, col = min(inner, key=lambda p: abs(p[0] - source.rows // 2) + abs(p[1] - source.cols // 2))
    disparity = source.truth[row, col]()
    grey = grey_views(source)
    here, beside = grey(row, col), {s: grey(row + s[0], col + s[1]) for s in ((0, 1), (1, 0))}
    errors: dict[Turn, float] = {}
    for turn in (Turn(*flags) for flags in product((False, True), repeat=3)):
        for step, there in beside.items():
            down, across = step[::-1] if turn.transpose else step
            canonical = -down if turn.rows else down, -across if turn.cols else across
            errors[turn] = errors.get(turn, 0.0) + float(mismatch(here, there, disparity, *canonical).mean())
    best, second = sorted(errors, key=lambda turn: errors[turn])[:2]
    return best, 1 - errors[best] / max(errors[second], 1e-9)


def _by_flow(source: SceneSource) -> Orientation:
    """Orientation from flow between a few views."""

    def unknown(said: str, what: str = "the order of the views") -> Orientation:
        return Orientation(Turn(), "nothing", said, f"{what}; {_TURN_HELP}; {_DEPTH_HELP}", False)

    if min(source.height_px, source.width_px) < SMALLEST_PX:
        return unknown("the views are too small for optical flow")
    grey, lines = grey_views(source, LOOK_PX), present_lines(source)
    by_col, by_row = (examine_axis(lambda k, line=line: grey(*line[k]), len(line)) for line in lines)  # type: ignore[misc]
    moving = [axis for axis in (by_col, by_row) if axis is not None and axis.along_px > LEAST_PX]
    if not moving:
        return unknown("the views hardly differ")
    across, down = (next((axis for axis in moving if axis.sideways == sideways), None) for sideways in (True, False))
    undecided, relative = "", 1
    if len(moving) == 2:
        alike = same_way(*moving)
        if across is None or down is None or abs(alike) < ALIKE:
            return unknown(f"rows and columns of views hardly agree (correlation {alike:+.2f})", "rows against columns")
        relative, said = -1 if alike < 0 else 1, f"motion along rows and columns agrees with correlation {alike:+.2f}"
    else:
        if moving[0].along_px < ALONG * moving[0].across_px:
            return unknown("the views move across the line as much as along it")
        said = f"one line of views, {'side by side' if across else 'above one another'}"
        if by_col is not None and by_row is not None:
            undecided = "whether the grid is one: along one side of it the views hardly differ"
    signs = [1 if axis is across or across is None else relative for axis in moving]
    right, wrong = (
        sum(side) for side in zip(*((a.right, a.wrong)[::sign] for a, sign in zip(moving, signs, strict=True)), strict=True)
    )
    verdict = hides(right, wrong)
    if verdict:
        said += f"; near surfaces hide far ones in {max(right, wrong)} of {right + wrong} places"
    else:
        undecided = "; ".join(filter(None, (undecided, _DEPTH_HELP)))
    sign = verdict or 1
    transpose = moving[0].sideways != (moving[0] is by_col)
    turn = Turn(down is not None and sign * relative < 0, across is not None and sign < 0, transpose)
    grown = sign * source.width_px / grey(*lines[0][0]).shape[1]
    depth = (across or moving[0]).disparity * np.float32(grown)
    low, high = (float(value) for value in np.percentile(depth, (1, 99)))
    return Orientation(turn, "flow", said, undecided, bool(verdict), disparity_px=(low, high), border_px=border_range(depth))


def examine_axis(grey: Callable[[int], Grey], count: int) -> Axis | None:
    """Evidence from the views grey(0) .. grey(count - 1) along one axis of the grid; None if there are fewer than two."""
    if count < 2:
        return None
    base = count // 2
    here, sides = grey(base), [side for side in (1, -1) if 0 <= base + side < count]
    detail = textured(here)
    # Motion grows with the step: choose a step with enough motion.
    near_px = float(_motion_px(flow(here, grey(base + sides[0])), detail).max())
    step = max(1, min(int(SPREAD_PX / max(near_px, 0.1)) + 1, *(base if side < 0 else count - 1 - base for side in sides)))
    others = [(side * step, grey(base + side * step)) for side in sides]
    flows = [flow(here, there) for _, there in others]
    returned = [confirmed(ahead, flow(there, here)) for ahead, (_, there) in zip(flows, others, strict=True)]
    x_px, y_px = (_motion_px(flows[0], returned[0] & detail) / step).tolist()
    sideways, reliable = x_px >= y_px, np.logical_or.reduce(returned)
    disparity = view_disparity(here, [(there, 0.0 if sideways else steps, steps if sideways else 0.0) for steps, there in others])
    low, high = np.percentile(disparity, (5, 95))
    fars = [far for far in {0, base // 2, (base + count - 1) // 2, count - 1} if abs(far - base) * (high - low) > 2]
    sharp = _sharpened(disparity, here) if fars else disparity
    votes = sum((_votes(here, sharp, reliable, grey(far), far - base, sideways) for far in fars), np.zeros(here.shape, np.int32))
    side = max(4, min(here.shape) // SIDE)
    rows, cols = (size // side for size in here.shape)
    places = votes[: rows * side, : cols * side].reshape(rows, side, cols, side).sum(axis=(1, 3))
    right, wrong = (int(np.count_nonzero(sign * places >= MAJORITY)) for sign in (1, -1))
    return Axis(sideways, disparity, reliable & detail, max(x_px, y_px), min(x_px, y_px), right, wrong)


def same_way(a: Axis, b: Axis) -> float:
    """Correlation of the two axes' disparities at pixels reliable in both: near 1 in a well-ordered grid, near -1 with one axis
    reversed."""
    use = a.reliable & b.reliable
    first, second = a.disparity[use], b.disparity[use]
    if len(first) < FEWEST:
        return 0.0
    varied = min(first.std(), second.std()) >= 1e-6
    alike = float(np.corrcoef(first, second)[0, 1]) if varied else 0.0
    # A flat wall has nothing to correlate, but it moves as one, by the same amount along both axes.
    if abs(alike) < 0.5 and all(abs(v.mean()) > max(0.3, 3 * v.std()) for v in (first, second)):
        ratio = float(first.mean() / second.mean())
        return math.copysign(0.9, ratio) if 0.5 < abs(ratio) < 2 else alike
    return alike


def _motion_px(flow_px: FloatMap, use: Mask) -> NDArray[np.float64]:
    """Amount of motion along x and y, float64 (2,): the spread between surfaces and their common motion, because a flat wall
    moves as one. flow_px: float32 (h, w, 2); use: pixels that count, if they are enough."""
    values = flow_px[use] if np.count_nonzero(use) >= FEWEST else flow_px.reshape(-1, 2)
    low, middle, high = np.percentile(values, (5, 50, 95), axis=0)
    return np.asarray(high - low + np.abs(middle), np.float64)


def _sharpened(disparity_px: FloatMap, picture: Grey) -> FloatMap:
    """The map with its edges moved to those of the picture (weighted median), because occlusion shows only at edges."""
    low, high = (float(v) for v in np.percentile(disparity_px, (0.5, 99.5)))
    if high - low < 1e-3:
        return disparity_px
    steps = np.clip((disparity_px - low) * np.float32(255 / (high - low)), 0, 255).astype(np.uint8)
    sharp = cv2.ximgproc.weightedMedianFilter(picture, steps, 7, sigma=12.0)
    return np.asarray(sharp, np.float32) * np.float32((high - low) / 255) + np.float32(low)


def _splat(order: NDArray[np.intp], disparity_px: FloatMap, steps: int, sideways: bool) -> NDArray[np.intp]:
    """The pixel of a view that lands on each pixel of the view `steps` further; of several, the last in `order`; -1 for none."""
    height, width = disparity_px.shape
    y, x = np.divmod(order, width)
    shift = np.rint(disparity_px.ravel()[order] * np.float32(steps)).astype(np.intp)
    x, y = (x - shift, y) if sideways else (x, y - shift)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    out = np.full(height * width, -1, np.intp)
    out[(y * width + x)[inside]] = order[inside]
    return out


def _votes(here: Grey, disparity_px: FloatMap, reliable: Mask, there: Grey, steps: int, sideways: bool) -> NDArray[np.int32]:
    """By pixel of a view, int32 (h, w): 1 where two surfaces meet in the view `steps` further and that shows the nearer one,
    -1 where it shows the farther one."""
    near_last = np.argsort(disparity_px.ravel(), kind="stable")
    front = _splat(near_last, disparity_px, steps, sideways)
    back = _splat(near_last[::-1], disparity_px, steps, sideways)
    colour, depth, known = here.ravel().astype(np.float32), disparity_px.ravel(), reliable.ravel()
    meet = (front >= 0) & ((depth[front] - depth[back]) * abs(steps) > OVERLAP_PX)
    meet &= (np.abs(colour[front] - colour[back]) > DIFFERENT) & known[front] & known[back]
    seen = (front >= 0) & known[front] & (colour[front] > DIFFERENT)
    # Exposure may differ from view to view by more than surfaces do.
    gain = float(np.median(colour[front[seen]] / np.maximum(there.ravel()[seen], 1))) if seen.any() else 1.0
    around = np.ones((3, 3), np.uint8)  # one px of tolerance: the splat rounds
    low, high = (np.float32(gain) * edge(there, around).ravel()[meet] for edge in (cv2.erode, cv2.dilate))
    front_off, back_off = (np.abs(np.clip(values, low, high) - values) for values in (colour[front[meet]], colour[back[meet]]))
    out = np.zeros(here.size, np.int32)
    np.add.at(out, front[meet], (front_off < SAME) & (back_off > WRONG))
    np.subtract.at(out, front[meet], (back_off < SAME) & (front_off > WRONG))
    return out.reshape(here.shape)
