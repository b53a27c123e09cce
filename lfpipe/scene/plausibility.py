"""Measures a few small views before all of them are packed: whether they form a light field, and
whether anything moves between them.
"""

import logging
from collections.abc import Callable
from itertools import pairwise

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.scene.classification import EXPLAINED, Measurements, SceneKind
from lfpipe.scene.optical_flow import (
    FloatMap,
    Grey,
    Mask,
    displaced,
    flow,
    grey_views,
    present_lines,
    returned_flow,
    robust_fit,
    textured,
    without_shake,
)
from lfpipe.scene.source import GridTransform, SceneSource

log = logging.getLogger(__name__)

_SMALLEST_PX = 48  # side of views: the flow needs a few patches
_LOOSE_PX, _LOOSE_SHARE = 1.0, 0.2  # tolerance of the flow
_STILL_PX = 1.0  # smaller motion counts as none
_OFF_PX = 0.5  # deviation from a common motion above which pixels are near and count less
_SHARPER = 2.5  # ratio of sharpness of two pictures, of neighbours in light fields at most 2.1
_ROUND = 1.3  # ratio of residual motion in the two directions: below it, there is no direction
_REACH, _FEWEST_POINTS = 8, 100  # views from the middle; pixels to fit motion to
# views; share of the pixels that move between two of them seen half-way round
_SHORTEST_CIRCLE, _STAYS = 8, 0.5
_CLOSING = 2.0  # step from the last view to the first over the median step
# minimum correlation of a matched block, and its lead over the second-best position
_FOUND, _LEADS = 0.75, 0.08
_FEWEST_BLOCKS, _MISSED = 6, 0.4  # matched blocks; share of them that the flow misses
# of one background: px by which the motion of half of it differs, below that of neighbours in light
# fields; share of all detail beside it; share of a block's detail that must be seen again
_ALIKE_PX, _BESIDE, _SEEN = 1.0, 0.15, 0.3
_LEVEL = 0.01  # deviation of blocks across the line of cameras, in heights of the picture


@attrs.frozen(kw_only=True)
class Motion:
    """Motion between two views, px at the edge of the picture."""

    parallax_px: float
    depth_px: float  # left without a shift, turn and zoom, in the middle half of all detail
    size_px: float  # of growing or shrinking
    directed: bool  # whether most of it is along one line

    @property
    def change(self) -> str:
        """A change that exceeds that of the viewpoint; "" if there is none."""
        if self.size_px > max(_STILL_PX, self.parallax_px):
            return (
                "the pictures differ in size, as when focus breathes, the lens zooms or the camera"
                " comes nearer"
            )
        return "" if self.directed else "their motion has no common direction"


def _motion(a: Grey, b: Grey) -> Motion | None:
    """Motion between two views; None if too few pixels are visible in both."""
    ahead, confirmed = returned_flow(a, b)
    sure = confirmed & textured(a)
    if np.count_nonzero(sure) < _FEWEST_POINTS:
        return None
    y, x = np.nonzero(sure)
    half = a.shape[1] / 2
    x, y = (x - half) / half, (y - a.shape[0] / 2) / half
    one = np.ones_like(x)
    none = np.zeros_like(x)
    values = ahead[sure].T.ravel().astype(np.float64)
    matrix = np.concatenate([np.stack([one, none, x, -y], 1), np.stack([none, one, y, x], 1)])
    fit = robust_fit(matrix, values, _OFF_PX)
    # A receding plane moves along the line of cameras only; size changes along both axes alike.
    wider, taller = (
        robust_fit(np.stack([x, y, one], 1), axis, _OFF_PX)[k]
        for k, axis in enumerate(values.reshape(2, -1))
    )
    # along x and y; a fit that increases the motion is ignored
    left_px, depth_px = (
        np.minimum(_spread_px(values, share), _spread_px(values - matrix @ fit, share))
        for share in (5, 25)
    )
    shift_px = float(np.hypot(*fit[:2]))
    crosswise = left_px.min() > _STILL_PX and left_px.max() < _ROUND * left_px.min() > 2 * shift_px
    return Motion(
        parallax_px=max(shift_px, float(left_px.max())),
        depth_px=float(depth_px.max()),
        size_px=min(abs(wider), abs(taller)) if wider * taller > 0 else 0.0,
        directed=not crosswise,
    )


def _spread_px(values: NDArray[np.float64], share: int) -> NDArray[np.float64]:
    """The spread of a motion (all x before all y), by axis, without a share (%) at both ends."""
    ends = np.percentile(values.reshape(2, -1), (share, 100 - share), axis=1)
    return np.asarray(np.ptp(ends, axis=0), np.float64)


def _change(views: list[Grey]) -> str:
    """A change of the views of a line that a camera moving sideways does not cause; "" if there is
    none.
    """
    middle = (len(views) - 1) // 2
    here = views[middle]
    for away in (1, -1, _REACH) if len(views) > 2 else (1,):
        there = views[min(len(views) - 1, middle + away)]
        motion = _motion(here, there)
        if motion is None:
            continue
        if motion.change:
            return motion.change
        still = motion.parallax_px < _STILL_PX
        if (still or away < _REACH) and _focus_differs(here, there, motion.parallax_px):
            return "they differ in focus or exposure, not in viewpoint"
    return ""


def _moved_px(detail: Mask, ahead: FloatMap, confirmed: Mask) -> float:
    """Motion of nearly all detail common to two views, by the flow between them; infinity if there
    is too little.
    """
    sure = confirmed & detail
    if np.count_nonzero(sure) < max(_FEWEST_POINTS, 0.5 * np.count_nonzero(detail)):
        return np.inf
    return float(np.percentile(np.hypot(*ahead[sure].T), 97))


def _found(a: Grey, b: Grey, y: int, x: int, side: int) -> tuple[int, int] | None:
    """The position (y, x) in b of the block of a at (y, x), at any x and nearly the same y; None
    unless the match is unique.
    """
    top = max(0, y - side // 4)
    strip = b[top : y + side + side // 4]
    alike = cv2.matchTemplate(strip, a[y : y + side, x : x + side], cv2.TM_CCOEFF_NORMED)
    down, across = (int(k) for k in np.unravel_index(int(alike.argmax()), alike.shape))
    best = float(alike[down, across])
    alike[:, max(0, across - side // 2) : across + side // 2 + 1] = -1
    clear = best > _FOUND and best - float(alike.max()) > _LEADS
    return (top + down, across) if clear else None


def _found_back(a: Grey, b: Grey, y: int, x: int, side: int) -> tuple[int, int] | None:
    """As `_found`, if the block there is found at (y, x) in turn."""
    there = _found(a, b, y, x, side)
    back = there and _found(b, a, *there, side)
    return there if back and max(abs(back[0] - y), abs(back[1] - x)) <= 2 else None


def _blocks(a: Grey, b: Grey, ahead: FloatMap) -> tuple[float, float] | None:
    """The range of motion along x, in shares of the width, of blocks of a that are matched in b and
    back, but that the flow misses; None if the flow finds them, or they are not in b: they move
    up and down, or all alike while others are not found.
    """
    height, width = a.shape
    side = min(height, width) // 7
    moves, missed, lost = [], [], []
    for y in np.linspace(side // 2, height - side - side // 2, 6).astype(int).tolist():
        for x in np.linspace(0, width - side, 8).astype(int).tolist():
            if a[y : y + side, x : x + side].std() <= 8:
                continue
            there = _found_back(a, b, y, x, side)
            if there is None:
                lost.append(x)
                continue
            move = float(there[1] - x)
            flowed = float(np.median(ahead[y : y + side, x : x + side, 0]))
            moves.append((move, float(there[0] - y)))
            missed.append(abs(flowed - move) > max(2.0, 0.2 * abs(move)))
    if len(moves) < _FEWEST_BLOCKS or np.mean(missed) < _MISSED:
        return None
    spread = np.percentile(moves, (5, 25, 50, 75, 95), axis=0).tolist()
    (low, top), (less, _), (middle, _), (more, _), (high, bottom) = spread
    beside = sum(0 <= x + middle <= width - side for x in lost)
    if bottom - top > max(2.0, _LEVEL * height) or (
        more - less < _ALIKE_PX and beside > _BESIDE * (beside + len(moves))
    ):
        return None
    return low / width, high / width


def _one_background(a: Grey, b: Grey, confirmed: Mask) -> bool:
    """Whether all that two pictures have in common moves alike, and other parts are not found."""
    detail = textured(a)
    motion = _motion(a, b)
    side = min(a.shape) // 7
    size = a.shape[1] // side, a.shape[0] // side
    share, seen = (
        cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        for mask in (detail, detail & confirmed)
    )
    if motion is None or motion.depth_px >= _ALIKE_PX:
        return False
    use = share > share.mean() / 4
    unseen = np.argwhere(use & (seen < _SEEN * share))
    lost = [1 for y, x in (unseen * side).tolist() if _found_back(a, b, y, x, side) is None]
    return len(lost) > _BESIDE * int(np.count_nonzero(use))


def _pair(a: Grey, b: Grey) -> Measurements:
    """As `_triple`, for two views: one is predicted from the other; the share is of its detail
    found there.
    """
    ahead, confirmed = returned_flow(a, b)
    detail = textured(a)
    explained = float(confirmed[detail].mean()) if detail.any() else 1.0
    missed_motion = _blocks(a, b, ahead) if explained < EXPLAINED else None
    change = _change([a, b])
    if not change and missed_motion is None and _one_background(a, b, confirmed):
        change = "half of what they show stays in place, and other parts differ"
    return Measurements(
        held_out_db=cv2.PSNR(displaced(b, ahead), a),
        explained=explained,
        change=change,
        moved_px=_moved_px(detail, ahead, confirmed),
        missed_motion=missed_motion,
    )


def _triple(before: Grey, middle: Grey, after: Grey) -> Measurements:
    """PSNR of the middle view predicted from the others, and the share of its detail that one
    disparity explains.
    """
    half = flow(before, after) * np.float32(0.5)
    sideways = float(np.abs(half[..., 0]).mean()) >= float(np.abs(half[..., 1]).mean())
    half[..., 1 if sideways else 0] = 0
    predicted = (displaced(before, -half).astype(np.float32) + displaced(after, half)) / 2
    edge = max(1, min(middle.shape) // 20)
    inner = slice(edge, -edge), slice(edge, -edge)
    moved_px = float(np.percentile(np.abs(half), 99))
    held_out = cv2.PSNR(predicted[inner], middle[inner].astype(np.float32))
    detail = textured(middle)
    if not detail.any():
        return Measurements(held_out_db=held_out, explained=1.0, moved_px=moved_px)
    to_before, to_after = (flow(middle, other)[detail] for other in (before, after))
    y, x = np.nonzero(detail)
    along, beside = (to_after[:, k] for k in ((0, 1) if sideways else (1, 0)))
    off = np.hypot(*(without_shake(x, y, (to_before + to_after)[:, k]) for k in (0, 1)))
    loose = _LOOSE_PX + _LOOSE_SHARE * np.abs(along)
    explained = float(((off < loose) & (np.abs(without_shake(x, y, beside)) < loose)).mean())
    return Measurements(held_out_db=held_out, explained=explained, moved_px=moved_px)


def _focus_differs(a: Grey, b: Grey, parallax_px: float) -> bool:
    """Whether two pictures differ in focus: what is in both is much sharper in one. Parallax beyond
    a block hides that.
    """
    side = max(8, min(a.shape) // 8)
    if parallax_px > side:
        return False
    sharp, other = (
        cv2.blur(np.square(cv2.Laplacian(view, cv2.CV_32F, ksize=3)), (side, side))
        for view in (a, b)
    )
    ahead, confirmed = returned_flow(a, b)
    other = np.asarray(displaced(other, ahead), np.float32)
    most = np.maximum(sharp, other)
    use = confirmed & (most > max(30.0, float(np.median(most))))
    if np.count_nonzero(use) < _FEWEST_POINTS:
        return False
    ratio = np.log2((sharp[use] + 5) / (other[use] + 5))
    return bool(np.median(np.abs(ratio)) > np.log2(_SHARPER))


def _is_circle(line: list[Grey]) -> str:
    """The reason to treat a line of views as a circle, "" if it is none: the last view is a
    neighbour of the first, and either the middle view shows the other side of the scene or the
    camera's path is closed.
    """
    first, second, middle, last = (line[k] for k in (0, 1, len(line) // 2, -1))
    detail = textured(first)
    back = flow(first, last)[detail]
    ahead = flow(first, second)[detail]
    step_px = np.hypot(*ahead.T)
    moving = step_px > _LOOSE_PX
    if np.count_nonzero(moving) >= _FEWEST_POINTS:
        off = np.hypot(*(back + ahead)[moving].T)
        comes = float((off < _LOOSE_PX + _LOOSE_SHARE * step_px[moving]).mean())
        stays = float(returned_flow(first, middle)[1][detail][moving].mean())
        if comes > EXPLAINED and stays < _STAYS:
            return "the last picture follows the first one: a turntable, or a walk around something"
    if _goes_round(line):
        return "the camera walks on a circle, not along a line or over a grid"
    return ""


def _goes_round(line: list[Grey]) -> bool:
    """Whether the camera's path goes once around its middle and ends where it began: all static
    parts, followed from view to view, follow one path, scaled by nearness, which is the first
    principal component of the motion.
    """
    chosen = sorted({round(at) for at in np.linspace(0, len(line) - 1, 13)})
    start = np.argwhere(textured(line[0]))[:, ::-1].astype(np.float32)
    at, seen, tracks = start, np.ones(len(start), bool), []
    for k, following in pairwise(chosen):
        ahead, confirmed = returned_flow(line[k], line[following])
        x, y = np.clip(np.rint(at), 0, np.array(ahead.shape[1::-1]) - 1).astype(int).T
        seen &= confirmed[y, x]
        at = at + ahead[y, x]
        tracks.append((at - start).T)
    if np.count_nonzero(seen) < _FEWEST_POINTS:
        return False
    motion = np.stack(tracks)[..., seen].reshape(2 * len(tracks), -1)
    path = np.linalg.eigh(motion @ motion.T)[1][:, -1].reshape(-1, 2)
    path = np.concatenate([np.zeros((1, 2)), path])
    steps = np.hypot(*np.diff(path, axis=0).T)
    away = path - (path.min(axis=0) + path.max(axis=0)) / 2
    angle = np.arctan2(away[:, 1], away[:, 0])
    turns = (np.diff(np.append(angle, angle[0])) + np.pi) % (2 * np.pi) - np.pi
    return bool(
        np.hypot(*path[-1]) < _CLOSING * np.median(steps)
        and abs(float(turns.sum())) > np.pi
        and np.mean(np.sign(turns) == np.sign(turns.sum())) > 0.9
    )


def measure_views(source: SceneSource) -> Measurements | None:
    """Measurements from a few small views; None if there are too few, or they are too small."""
    if min(source.height_px, source.width_px) < _SMALLEST_PX:
        return None
    grey: Callable[[int, int], Grey] = grey_views(source)
    lines = [line for line in present_lines(source) if len(line) >= 3]
    if not lines:
        pairs = [
            _pair(grey(*line[0]), grey(*line[1]))
            for line in present_lines(source)
            if len(line) == 2
        ]
        if not pairs:
            return None
        return Measurements.median(
            pairs,
            change=next((pair.change for pair in pairs if pair.change), ""),
            moved_px=max(pair.moved_px for pair in pairs),
            missed_motion=pairs[0].missed_motion if len(pairs) == 1 else None,
        )
    triples = [_triple(*(grey(*line[k + len(line) // 2]) for k in (-1, 0, 1))) for line in lines]
    if not all(triple.fine for triple in triples):
        for line in lines:
            for middle in {
                max(1, len(line) // 5),
                min(len(line) - 2, len(line) - 1 - len(line) // 5),
            } - {len(line) // 2}:
                triples.append(_triple(*(grey(*line[middle + k]) for k in (-1, 0, 1))))
    # the middle of the lines
    around = [line[max(0, len(line) // 2 - _REACH) : len(line) // 2 + _REACH + 1] for line in lines]
    changes = [_change([grey(*place) for place in views]) for views in around]
    change = next(filter(None, changes), "")
    line = lines[0]
    if len(lines) == 1 and len(line) >= _SHORTEST_CIRCLE:
        change = _is_circle([grey(*place) for place in line]) or change
    moved_px = max(triple.moved_px for triple in triples)
    if moved_px < _STILL_PX:  # between neighbours; the ends may differ by more
        ends = [(grey(*line[0]), grey(*line[-1])) for line in lines]
        moved_px = max(_moved_px(textured(a), *returned_flow(a, b)) for a, b in ends)
    return Measurements.median(triples, change=change, moved_px=moved_px)


def plausible(source: SceneSource, force: bool) -> tuple[SceneSource, Measurements | None]:
    """The source, checked by measurements of a few views, and the measurements. Pictures without
    motion between them become one view. Raises UserError if the pictures are not a light field;
    with `force`, or in a format that defines a light field, this is only a note.
    """
    measured = (
        measure_views(source) if not source.certain or source.rows * source.cols == 2 else None
    )
    if measured is None:
        return source, None
    log.info(
        "%s: quality when predicting views from their neighbours %.1f dB; one disparity explains"
        " the motion of %.0f%% of the detail; motion up to %.1f px",
        source.path,
        measured.held_out_db,
        100 * measured.explained,
        measured.moved_px,
    )
    found = measured.classification
    refused = found.kind is SceneKind.NOT_A_LIGHT_FIELD
    if found.kind is SceneKind.LIGHT_FIELD:
        return source, measured
    if refused and not force and not source.certain:
        grid = f"{source.rows}x{source.cols} views of layout {source.layout}"
        anyway = "open it anyway with --set scene.force=true"
        if len(source.files) > 1:
            anyway = (
                f"give the folder of one scene, or one of the pictures: {source.files[0]}; {anyway}"
            )
        raise UserError(f"{source.path}: {found.reason} (read as {grid})", anyway)
    if found.kind is SceneKind.ONE_VIEW:
        source = _as_one(source)
    return attrs.evolve(
        source, doubt="; ".join(filter(None, (source.doubt, found.reason)))
    ), measured


def _as_one(source: SceneSource) -> SceneSource:
    """The source reduced to its middle view."""
    at = source.middle
    return attrs.evolve(
        source,
        rows=1,
        cols=1,
        read=lambda frame, row, col: source.read(frame, *at),
        small=None,
        missing=frozenset(),
        turn=GridTransform(),
        turn_by="there is one view",
        coordinates=None,
        truth={},
        doubt="",
    )
