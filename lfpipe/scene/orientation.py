"""The transform from file order to canonical order (row 0: top camera, column 0: left camera).

In canonical order, a step to the next column moves a point by -d along x, and a step to the next
row by -d along y. The direction of motion reveals a transposed grid; the sign of the correlation
of the two motions reveals one flipped axis. Flipping both axes changes neither: it inverts depth.
Formats and camera coordinates define the depth order; pictures show it only where near surfaces
occlude far ones (`_votes`).
"""

import math
from collections.abc import Callable

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.scene.disparity import depth_range, view_disparity
from lfpipe.scene.lightfield import Depth, OrderSource, OrientationFacts
from lfpipe.scene.optical_flow import (
    SMALLEST_PX,
    FloatMap,
    Grey,
    Mask,
    flow,
    grey_views,
    present_lines,
    returned_flow,
    textured,
)
from lfpipe.scene.source import GridTransform, SceneSource

UNMISTAKABLE, AGAINST = (
    16,
    10,
)  # agreeing positions required, and how many of them one opposing position cancels
# grey levels between two surfaces; between a surface and the observed view
DIFFERENT, SAME, WRONG = 10, 3, 6
# positions along the shorter side of a view, one vote each; its pixels must agree by this many
SIDE, MAJORITY = 20, 3


def hides(right: int, wrong: int) -> int:
    """1 if near surfaces clearly occlude far ones, -1 for the reverse, 0 if ambiguous.

    right, wrong: counts of positions. Glow, blur and repetition mislead at many positions at once.
    Real light fields: antinous 104 / 1, stillLife 76 / 3, monasroom 57 / 0 and lytro 46 / 2 are
    certain; newshot01 44 / 4, quilt 77 / 42, lego knights 82 / 10, toys 4 / 0, airplane 0 / 2 and
    illum_field 0 / 0 stay ambiguous. Of 170 synthetic, reordered and disturbed sets none is wrong.
    """
    return int(right - AGAINST * wrong >= UNMISTAKABLE) - int(
        wrong - AGAINST * right >= UNMISTAKABLE
    )


def places(
    view: Callable[[int], Grey], count: int, disparity_px: FloatMap, reliable: Mask, sideways: bool
) -> tuple[int, int]:
    """(right, wrong): numbers of positions where two surfaces meet and the outermost views of a
    line show the nearer or the farther one, respectively.

    view(0) .. view(count - 1): the line; disparity_px: of its middle view, float32 (h, w), per
    step; reliable: where it holds.
    """
    here = view(count // 2)
    low, high = np.percentile(disparity_px, (5, 95))
    ends = [end for end in (0, count - 1) if abs(end - count // 2) * (high - low) > 2]
    if not ends:
        return 0, 0
    sharp = _sharpened(disparity_px, here)
    votes = np.zeros(here.shape, np.int32)
    for end in ends:
        votes += _votes(here, sharp, reliable, view(end), end - count // 2, sideways)
    side = max(4, min(here.shape) // SIDE)
    rows, cols = (size // side for size in here.shape)
    sums = votes[: rows * side, : cols * side].reshape(rows, side, cols, side).sum(axis=(1, 3))
    return int(np.count_nonzero(sums >= MAJORITY)), int(np.count_nonzero(sums <= -MAJORITY))


def _sharpened(disparity_px: FloatMap, picture: Grey) -> FloatMap:
    """The map with its edges moved to those of the picture (weighted median), because occlusion
    shows only at edges.
    """
    low, high = (float(v) for v in np.percentile(disparity_px, (0.5, 99.5)))
    steps = np.clip((disparity_px - low) * np.float32(255 / (high - low)), 0, 255).astype(np.uint8)
    sharp = cv2.ximgproc.weightedMedianFilter(picture, steps, 7, sigma=12.0)
    return np.asarray(sharp, np.float32) * np.float32((high - low) / 255) + np.float32(low)


def _votes(
    here: Grey, disparity_px: FloatMap, reliable: Mask, there: Grey, steps: int, sideways: bool
) -> NDArray[np.int32]:
    """Votes by pixel of a view, int32 (h, w): 1 if two surfaces meet in the view `steps` further
    and that view shows the nearer one, -1 if it shows the farther one.
    """
    height, width = here.shape
    far_first = np.argsort(disparity_px, axis=None, kind="stable")
    y, x = np.divmod(far_first, width)
    shift = np.rint(disparity_px.ravel()[far_first] * np.float32(steps)).astype(np.intp)
    x, y = (x - shift, y) if sideways else (x, y - shift)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    landing = (y * width + x)[inside]
    start = far_first[inside]
    # the nearest and the farthest pixel that lands on each one
    front, back = np.full((2, here.size), -1, np.intp)
    front[landing] = start
    back[landing[::-1]] = start[::-1]
    colour = here.ravel().astype(np.float32)
    depth = disparity_px.ravel()
    holds = reliable.ravel()
    meet = (
        (front >= 0)
        # px: a surface that lands on another is that much nearer
        & ((depth[front] - depth[back]) * abs(steps) > 1.5)
        & holds[front]
        & holds[back]
    )
    meet &= np.abs(colour[front] - colour[back]) > DIFFERENT
    front = front[meet]
    back = back[meet]
    target = there.ravel()[meet]
    front_off, back_off = np.abs(colour[front] - target), np.abs(colour[back] - target)
    out = np.zeros(here.size, np.int32)
    np.add.at(out, front, (front_off < SAME) & (back_off > WRONG))
    np.subtract.at(out, front, (back_off < SAME) & (front_off > WRONG))
    return out.reshape(here.shape)


ALONG = 2.0  # motion along a line of views over motion across it
ALIKE = 0.4  # minimum correlation of disparities along rows and columns of an ordered grid
SPREAD_PX = 3.0  # flow that separates surfaces
FEWEST = 200  # reliable pixels; fewer are not significant
_TURN_HELP = "scene.flip=rows or cols and scene.transpose=yes correct it"
_DEPTH_HELP = (
    "depth order: press d in the window, or set scene.invert_depth=yes, if the depth looks inverted"
)


@attrs.frozen(kw_only=True)
class Orientation:
    """The order of the views, and its basis."""

    turn: GridTransform  # from file order to canonical order
    by: OrderSource
    reason: str  # for people
    undecided: str = ""  # any ambiguity left
    depth_order_sure: bool = True
    detected: GridTransform | None = None  # `turn` without the user's setting, if that differs
    depth: Depth | None = None  # of the middle view, in the order of the pack

    @property
    def sure(self) -> bool:
        return not self.undecided

    @property
    def invert_depth(self) -> bool:
        """Whether the order of the pack inverts depth. An order set by the user is packed as is."""
        return self.by is not OrderSource.OVERRIDE and self.turn.cols

    @property
    def packed(self) -> GridTransform:
        """The transform of a pack, without inverted depth, which is session state."""
        return (
            GridTransform(not self.turn.rows, False, self.turn.transpose)
            if self.invert_depth
            else self.turn
        )

    @property
    def truth_sign(self) -> int:
        """Sign of true disparity in the order of the pack; 0 if the user's order is neither the
        detected one nor its inverse.
        """
        holds = self.detected or self.turn
        changed = {self.packed.rows != holds.rows, self.packed.cols != holds.cols}
        if self.packed.transpose != holds.transpose or len(changed) > 1:
            return 0
        return -1 if True in changed else 1

    def facts(self, stated_inverted: bool | None) -> OrientationFacts:
        """The facts for manifests and `lfpipe scene info`; a stated depth order is certain."""
        return OrientationFacts(
            by=self.by,
            sure=self.sure,
            reason=self.reason,
            undecided=self.undecided,
            invert_depth=self.invert_depth if stated_inverted is None else stated_inverted,
            depth_order_sure=self.depth_order_sure or stated_inverted is not None,
        )


@attrs.frozen(kw_only=True)
class Axis:
    """One axis of the file grid, measured from its middle view."""

    sideways: bool  # views differ along x, else along y
    disparity: FloatMap  # (h, w), px per step as if file order were canonical
    reliable: NDArray[np.bool_]  # (h, w), where the flow is confirmed
    along_px: float  # motion per step along the axis
    across_px: float  # motion per step across it
    right: int  # number of positions where the occluded surface is the farther one
    wrong: int  # number of positions where it is the nearer one


def orient(source: SceneSource, scene: config.Scene) -> Orientation:
    """The transform to canonical order: from the user's setting, else from coordinates or the
    layout, else from optical flow between a few views. Includes the ambiguities of the layout.
    """
    best = _detected(source)
    if source.doubt:
        best = attrs.evolve(
            best,
            undecided="; ".join(filter(None, (source.doubt, best.undecided))),
            depth_order_sure=False,
        )
    turn = best.turn
    if scene.flip != "auto":
        turn = attrs.evolve(
            turn, rows=scene.flip in ("rows", "both"), cols=scene.flip in ("cols", "both")
        )
    if scene.transpose != "auto":
        turn = attrs.evolve(turn, transpose=scene.transpose == "yes")
    if scene.flip != "auto" or (scene.transpose != "auto" and turn != best.turn):
        best = Orientation(
            turn=turn,
            by=OrderSource.OVERRIDE,
            reason=f"set by scene.flip or scene.transpose; without that: {best.reason}",
            undecided=source.doubt,
            detected=best.turn,
        )
    unknown = (
        best.depth is None and best.by is not OrderSource.NOTHING and source.rows * source.cols > 1
    )
    return attrs.evolve(best, depth=_depth(source, best)) if unknown else best


def _depth(source: SceneSource, order: Orientation) -> Depth | None:
    """The depth range of the middle view: from its true map, else from the flow to a neighbour."""
    row, col = source.middle
    if order.truth_sign and (row, col) in source.truth:
        return depth_range(source.truth[row, col]() * np.float32(order.truth_sign))
    sideways = order.packed.grid(source.rows, source.cols)[1] > 1
    back = order.packed.cols if sideways else order.packed.rows
    grey = grey_views(source)
    line = present_lines(source)[0 if sideways != order.packed.transpose else 1]
    if len(line) < 2 or min(source.height_px, source.width_px) < SMALLEST_PX:
        return None
    here, there = (grey(*place) for place in line[len(line) // 2 - 1 :][:2])
    moved = flow(here, there)[..., 0 if sideways else 1]
    return depth_range(moved * np.float32((1 if back else -1) * source.width_px / moved.shape[1]))


def _detected(source: SceneSource) -> Orientation:
    """Orientation without the user's setting."""
    if source.rows * source.cols == 1:
        return Orientation(turn=GridTransform(), by=OrderSource.LAYOUT, reason="there is one view")
    if source.turn is None:
        return _by_flow(source)
    stated = Orientation(
        turn=source.turn,
        by=OrderSource.LAYOUT if source.coordinates is None else OrderSource.COORDINATES,
        reason=source.turn_by,
    )
    if source.turn_firm:
        return stated
    by_flow = _by_flow(source)
    if by_flow.turn == source.turn:
        return attrs.evolve(
            stated, reason=f"{stated.reason}; {by_flow.reason}", depth=by_flow.depth
        )
    depth_inverted = attrs.evolve(source.turn, rows=not source.turn.rows, cols=not source.turn.cols)
    proven = (
        by_flow.by is OrderSource.FLOW
        and min(source.rows, source.cols) > 1
        and by_flow.turn != depth_inverted
    )
    if by_flow.sure or proven:
        return attrs.evolve(
            by_flow, reason=f"{stated.reason}, but this one is turned: {by_flow.reason}"
        )
    return attrs.evolve(
        stated,
        reason=f"{stated.reason}; {by_flow.reason}",
        undecided=by_flow.undecided,
        depth_order_sure=False,
    )


def _by_flow(source: SceneSource) -> Orientation:
    """Orientation from flow between a few views."""

    def unknown(reason: str, what: str = "the order of the views") -> Orientation:
        return Orientation(
            turn=GridTransform(),
            by=OrderSource.NOTHING,
            reason=reason,
            undecided=f"{what}; {_TURN_HELP}; {_DEPTH_HELP}",
            depth_order_sure=False,
        )

    if min(source.height_px, source.width_px) < SMALLEST_PX:
        return unknown("the views are too small for optical flow")
    grey = grey_views(source)
    across, down = (
        measure_axis(lambda k, line=line: grey(*line[k]), len(line))  # type: ignore[misc]
        for line in present_lines(source)
    )
    moving = [axis for axis in (across, down) if axis is not None and axis.along_px > 0]
    if not moving:
        return unknown("the views hardly differ")
    transpose = moving[0].sideways != (moving[0] is across)
    undecided = ""
    relative = 1
    if len(moving) == 2:
        alike = same_way(*moving)
        if moving[0].sideways == moving[1].sideways or abs(alike) < ALIKE:
            return unknown(
                f"rows and columns of views hardly agree (correlation {alike:+.2f})",
                "the direction of rows relative to columns",
            )
        relative = -1 if alike < 0 else 1
        reason = f"motion along rows and columns agrees with correlation {alike:+.2f}"
        moving.sort(key=lambda axis: not axis.sideways)
    else:
        if moving[0].along_px < ALONG * moving[0].across_px:
            return unknown("the views move across the line as much as along it")
        reason = (
            f"one line of views, {'side by side' if moving[0].sideways else 'above one another'}"
        )
        if across is not None and down is not None:
            undecided = "whether this is a grid: along one side, the views hardly differ"
    votes = [
        (axis.right, axis.wrong)[::sign] for axis, sign in zip(moving, (1, relative), strict=False)
    ]
    right, wrong = (sum(side) for side in zip(*votes, strict=True))
    sign = hides(right, wrong)
    if sign:
        reason += f"; near surfaces hide far ones in {max(right, wrong)} of {right + wrong} places"
    else:
        undecided = "; ".join(filter(None, (undecided, _DEPTH_HELP)))
    turn = GridTransform((sign or 1) * relative < 0, sign < 0, transpose)
    depth = moving[0].disparity * np.float32(source.width_px / moving[0].disparity.shape[1])
    return Orientation(
        turn=turn,
        by=OrderSource.FLOW,
        reason=reason,
        undecided=undecided,
        depth_order_sure=bool(sign),
        depth=depth_range(depth),
    )


def measure_axis(view: Callable[[int], Grey], count: int) -> Axis | None:
    """Measurements from the views view(0) .. view(count - 1) along one axis of the grid; None if
    there are fewer than two.
    """
    if count < 2:
        return None
    base = count // 2
    here = view(base)
    sides = [side for side in (1, -1) if 0 <= base + side < count]
    detail = textured(here)
    # where edges cross x, and where they cross y: flow along an edge is arbitrary
    across, down = (np.abs(cv2.Sobel(here, cv2.CV_32F, *way)) for way in ((1, 0), (0, 1)))
    crossed = [detail & (across >= down), detail & (down >= across)]
    # Motion grows with the step: choose a step with enough motion.
    moved, confirmed = returned_flow(here, view(base + sides[0]))
    near_px = float(_motion_px(moved, confirmed, crossed).max())
    step = max(
        1,
        min(
            int(SPREAD_PX / max(near_px, 0.1)) + 1,
            *(base if side < 0 else count - 1 - base for side in sides),
        ),
    )
    others = [(side * step, view(base + side * step)) for side in sides]
    flows = [returned_flow(here, there) for _, there in others]
    x_px, y_px = (_motion_px(*flows[0], crossed) / step).tolist()
    sideways = x_px >= y_px
    reliable = np.logical_or.reduce([confirmed for _, confirmed in flows])
    disparity = view_disparity(
        here,
        [
            (there, 0.0 if sideways else steps, steps if sideways else 0.0)
            for steps, there in others
        ],
    )
    right, wrong = places(view, count, disparity, reliable, sideways)
    return Axis(
        sideways=sideways,
        disparity=disparity,
        reliable=reliable & detail,
        along_px=max(x_px, y_px),
        across_px=min(x_px, y_px),
        right=right,
        wrong=wrong,
    )


def same_way(a: Axis, b: Axis) -> float:
    """Correlation of the two axes' disparities at pixels reliable in both: near 1 in a well-ordered
    grid, near -1 with one axis reversed.
    """
    use = a.reliable & b.reliable
    first = a.disparity[use]
    second = b.disparity[use]
    if len(first) < FEWEST:
        return 0.0
    varied = min(first.std(), second.std()) >= 1e-6
    alike = float(np.corrcoef(first, second)[0, 1]) if varied else 0.0
    # A flat wall has no disparity differences to correlate, but moves equally along both axes.
    if abs(alike) < 0.5 and all(abs(v.mean()) > max(0.3, 3 * v.std()) for v in (first, second)):
        ratio = float(first.mean() / second.mean())
        return math.copysign(0.9, ratio) if 0.5 < abs(ratio) < 2 else alike
    return alike


def _motion_px(flow_px: FloatMap, confirmed: Mask, crossed: list[Mask]) -> NDArray[np.float64]:
    """Amount of motion along x and y, float64 (2,), where edges cross each: the spread between
    surfaces, and their common motion for flat walls; 0 if few edges do. Flow along edges that runs
    free leaves hardly any of it confirmed.
    """
    out = np.zeros(2)
    for axis, edges in enumerate(crossed):
        use = confirmed & edges
        values = flow_px[use if np.count_nonzero(use) >= FEWEST else edges, axis]
        if len(values) >= FEWEST:
            low, middle, high = np.percentile(values, (5, 50, 95))
            out[axis] = high - low + abs(middle)
    return out
