"""A live light field: its disparity, how its cameras stand and differ, and its newest frame as a
LightField.

Only the views in need are estimated, in pairs along the lines of the grid, at half the resolution.
Optical flow (dense inverse search, see `lfpipe.scene.optical_flow`) follows how two cameras stand
and which disparities there are, now and then; semi-global matching (Hirschmueller 2008) finds them,
every second row; then each pixel takes that of a neighbour if it fits better, and least squares
find the rest.

In aligned views of two cameras in a row, flow is horizontal. To first order, a camera that is
turned by r about its axis, points by h lower, enlarges by 1 + e, turns to the side by a and down by
d, and whose lens bends by k, adds the vertical flow

    v(x, y) = h + r * x + y * (e + k * (x^2 + y^2) + a * x + d * y),

x, y and v from the middle of the picture, in halves of its width.

No two cameras expose and balance alike, nor have the same response. Of the points that two views
show, the values in both are sorted, and equal ranks correspond: neither inexact disparity nor noise
displaces ranks by much.
"""

import math
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import LiveSource, Placement, SceneSummary
from lfpipe.eyes import low_pass_gain
from lfpipe.live.records import (
    RANGE_PERCENT,
    UNCHANGED,
    Pair,
    View,
    cut,
    disparity_dtype,
    disparity_record,
    map_size,
    views_of,
)
from lfpipe.scene.disparity import border_range, quantised
from lfpipe.scene.lightfield import UNKNOWN, Disparity, DisparitySource, LightField, Manifest
from lfpipe.scene.optical_flow import RETURN_PX, FloatMap, Grey, Mask, grid_xy, robust_fit, textured

SAMPLES = 800  # pixels of a frame that are compared
FAST_FRAMES = 20  # the mean of as many is taken at first
LATER_SHARE = 0.3  # of a frame afterwards
FIRM = np.eye(6)[3:]  # weighs k, a and d, of which a picture with little texture says nothing


class Alignment:
    """Follows the alignment, frame by frame."""

    def __init__(self, width_px: int, start: Placement | None = None) -> None:
        """start: as it was measured before."""
        self._half_px = width_px / 2
        self.bend = np.zeros(6)
        """h, r, e, k, a, d."""
        self.frames = 0
        """With enough texture."""
        if start is not None:
            turn = math.radians(start.rotation_deg)
            self.bend[:3] = start.height_px / self._half_px, turn, start.scale - 1
            self.frames = FAST_FRAMES

    def add(self, left: Grey, lower_px: FloatMap) -> None:
        """Adds a frame: the left view at half its size, and by how much its points lie lower in
        the aligned right one, in px of the full size.
        """
        at = np.flatnonzero(textured(left))
        if len(at) < SAMPLES // 8:
            return
        at = at[:: max(1, len(at) // SAMPLES)]
        row, col = np.divmod(at, left.shape[1])
        x, y = (2 * col + 1) / left.shape[1] - 1, (2 * row + 1 - left.shape[0]) / left.shape[1]
        matrix = np.column_stack([np.ones(len(at)), x, y, y * (x**2 + y**2), y * x, y * y])
        rest_px = robust_fit(
            np.vstack([matrix, FIRM]),
            np.append(lower_px.ravel()[at], np.zeros(len(FIRM))),
            RETURN_PX,  # of the fit: flow beyond it is wrong or of a moving thing
        )
        self.frames += 1
        share = 1 / self.frames if self.frames <= FAST_FRAMES else LATER_SHARE
        # the flow was measured in a view that is aligned already
        self.bend += share * rest_px / self._half_px

    def placement(self, swapped: bool) -> Placement:
        """Of the right camera against the left one."""
        height, turn, larger = self.bend[:3].tolist()
        return Placement(
            height_px=height * self._half_px,
            rotation_deg=math.degrees(turn),
            scale=1 + larger,
            swapped=swapped,
        )


@lru_cache(maxsize=4)
def _source_positions(height: int, width: int, bend: bytes) -> tuple[FloatMap, FloatMap]:
    """x and y in the delivered right view, float32 (height, width), of an aligned one's pixels."""
    low, turn, larger, lens, across, down = np.frombuffer(bend).tolist()
    half = width / 2
    x = ((np.arange(width) + 0.5) / half - 1).astype(np.float32)
    y = ((np.arange(height)[:, None] + 0.5 - height / 2) / half).astype(np.float32)
    zoom = half * ((1 + larger + lens * x**2 + across * x) + (lens * y**2 + down * y))
    x, y = zoom * x, zoom * y
    return (
        math.cos(turn) * x - math.sin(turn) * y + (half - 0.5),
        math.sin(turn) * x + math.cos(turn) * y + (height / 2 - 0.5 + low * half),
    )


def aligned(picture: NDArray[np.uint8], bend: NDArray[np.float64]) -> NDArray[np.uint8]:
    """The right view of any size, aligned; the border is repeated. bend: that of `Alignment`."""
    if not bend.any():
        return picture
    positions = _source_positions(*picture.shape[:2], bend.tobytes())
    return np.asarray(
        cv2.remap(picture, *positions, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.uint8
    )


RANKS_PERCENT = np.linspace(2, 98, 13)
# a drift of the levels is followed within 0.2 s, by LATER_SHARE; a step, of as many, at once
STEP_LEVELS = 8.0


class Colours:
    """Follows the colours of a row of cameras, frame by frame."""

    def __init__(self, cols: int) -> None:
        self._levels = np.stack([UNCHANGED] * cols).astype(np.float64)

    @property
    def curves(self) -> NDArray[np.uint8]:
        """As in the record of disparity."""
        return np.clip(np.rint(self._levels), 0, 255).astype(np.uint8)

    def add(self, col: int, target: NDArray[np.uint8], values: NDArray[np.uint8]) -> None:
        """Adds a frame: the values (n, 3) of that camera at some points, and their target, those of
        the camera to its left in its final colours.
        """
        ranks = (np.percentile(one[::4], RANKS_PERCENT, axis=0).T for one in (values, target))
        # black is black, and what is brighter than all is so by the gain of the brightest
        curves = [
            np.interp(UNCHANGED[:, 0], [0, *was, 255], [0, *to, to[-1] * 255 / max(was[-1], 1)])
            for was, to in zip(*ranks, strict=True)
        ]
        change = np.stack(curves, axis=1) - self._levels[col]
        self._levels[col] += change * np.clip(np.abs(change).mean() / STEP_LEVELS, LATER_SHARE, 1)


def matched(picture: NDArray[np.uint8], curve: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A picture, BGR, whose values are replaced by those of a curve."""
    if np.array_equal(curve, UNCHANGED):
        return picture
    return np.asarray(cv2.LUT(picture, curve[None]), np.uint8)


FINE_PAIRS = 2  # more, where the viewpoint is between two rows, are not refined
# one of so many frames is searched for flow; smallest side for a fast search
SEARCH_EVERY, FAST_PX = 4, 32
# Of semi-global matching: side of a block; what a small and a large step cost in each of its
# pixels; largest slope that is compared; disparities beyond those that were found last; most of
# them, and of how many there are multiples.
BLOCK_PX, STEPS_COST, SLOPE_LEVELS = 3, (8, 32), 63
MARGIN_PX, MOST, MULTIPLE = 3, 128, 16
# Of the refinement: around a pixel, the nearest and farthest disparities are tried, in this order;
# windows of what fits, and of the least squares; grey levels by which another one must fit better.
TRIED = [
    (extreme, np.ones(near, np.uint8))
    for near in ((7, 3), (3, 1))
    for extreme in (cv2.dilate, cv2.erode)
]
FIT_PX, LEAST_PX, BETTER_LEVELS = (3, 3), (7, 7), 4
# px by which least squares move one, for the picture is linear within them; squared grey levels per
# px^2 below which a picture says little.
STEP_PX, FLATNESS = 0.5, 30.0
SAMPLE = np.s_[::4, ::4]  # pixels that stand for all
# of a pair's points whose disparity in both views agrees, within RETURN_PX
AGREE_SHARE = 0.6
# Disparity of the nearest below which two cameras are swapped, and frames in a row that say so, or
# that say nothing: a camera may begin in black.
BEHIND_PX, SURE_FRAMES = -2.0, 30
FINEST_PX, MOST_STEPS = 1 / 16, 127  # step of stored disparity, and of how many


class Estimator:
    """Disparity of the views in need, and the alignment of a pair of cameras."""

    def __init__(self, live: LiveSource, aligns: bool) -> None:
        """aligns: whether the views are those of two cameras, which may be turned."""
        self._live = live
        # pictures too small for the coarse scales of the fast one end the process
        self._search = cv2.DISOpticalFlow.create(
            cv2.DISOPTICAL_FLOW_PRESET_FAST
            if min(map_size(live)) >= FAST_PX
            else cv2.DISOPTICAL_FLOW_PRESET_MEDIUM
        )
        small, large = (cost * BLOCK_PX**2 for cost in STEPS_COST)
        self._matcher = cv2.StereoSGBM.create(
            blockSize=BLOCK_PX,
            P1=small,
            P2=large,
            preFilterCap=SLOPE_LEVELS,
            mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
        )
        self._frames = 0
        self._flows: dict[Pair, FloatMap] = {}  # of the last search
        placed = live.placement
        self.alignment = Alignment(live.width_px, placed) if aligns else None
        self.swapped = placed is not None and placed.swapped
        """Whether the left camera delivers the right view, as in the record of disparity."""
        self.colours = Colours(live.cols)
        self.strange_frames = 0
        """In a row, whose views do not show one scene."""
        self._behind = 0  # frames in a row in which everything is behind infinity

    def estimate(
        self, frame: NDArray[np.uint8], pairs: Sequence[Pair], coarse: bool = False
    ) -> NDArray[np.void]:
        """The record of the disparity of some pairs of views in a frame, uint8 (height, width, 3)
        BGR.
        """
        smalls = {view: self._small(frame, view) for view in views_of(pairs)}
        shown = {
            view: matched(small, self.colours.curves[view[1]]) for view, small in smalls.items()
        }
        maps: dict[View, FloatMap] = {}
        agreement = 0.0
        for pair in pairs:
            a, b = pair
            da, db, agree = self._pair(pair, shown[a], shown[b], coarse or len(pairs) > FINE_PAIRS)
            maps = {a: da, b: db} | maps
            agreement = max(agreement, float(agree.mean()))
            if agree.mean() > AGREE_SHARE and self._live.rows == 1 and not self._live.drawn:
                self.colours.add(
                    b[1],
                    target=shown[a][SAMPLE][agree],
                    values=_from_right(smalls[b], np.float32(0.5) * da)[SAMPLE][agree],
                )
        self._frames += 1
        self.strange_frames = self.strange_frames + 1 if agreement < AGREE_SHARE else 0
        if self.alignment is not None and self.strange_frames:
            # forgets what it was measured from, down to a few frames
            self.alignment.frames = (self.alignment.frames + 4) // 2
        most_px = max(float(np.abs(disparity).max()) for disparity in maps.values())
        step_px = FINEST_PX * 2 ** math.ceil(math.log2(max(most_px / MOST_STEPS / FINEST_PX, 1)))
        record = disparity_record(
            self._live, {view: quantised(px, step_px) for view, px in maps.items()}, step_px
        )
        record["curves"] = self.colours.curves
        record["swapped"] = self.swapped
        if self.alignment is not None:
            record["bend"] = self.alignment.bend
            self._follow_order(float(record["high_px"]))
        return record

    def _follow_order(self, nearest_px: float) -> None:
        """Exchanges two cameras that deliver each other's view: with parallel ones, nothing is
        farther than infinity, which has disparity 0.
        """
        self._behind = self._behind + 1 if nearest_px < BEHIND_PX else 0
        if self._behind == SURE_FRAMES:
            self.swapped = not self.swapped
            self.alignment = Alignment(self._live.width_px)
            self.colours = Colours(self._live.cols)
            self._flows.clear()

    def _small(self, frame: NDArray[np.uint8], view: View) -> NDArray[np.uint8]:
        """A view at half its size, aligned."""
        small = cv2.resize(
            cut(frame, self._live, view, self.swapped),
            map_size(self._live)[::-1],
            interpolation=cv2.INTER_AREA,
        )
        if self.alignment is not None and view[1] == self._live.cols - 1:
            small = aligned(np.asarray(small, np.uint8), self.alignment.bend)
        return np.asarray(small, np.uint8)

    def _pair(
        self, pair: Pair, left: NDArray[np.uint8], right: NDArray[np.uint8], coarse: bool
    ) -> tuple[FloatMap, FloatMap, Mask]:
        """Disparities of two views, and which pixels of SAMPLE of the first one have the same in
        both.
        """
        a, b = (
            np.asarray(cv2.cvtColor(one, cv2.COLOR_BGR2GRAY), np.uint8) for one in (left, right)
        )
        if below := pair[0][1] == pair[1][1]:
            a, b = a.T.copy(), b.T.copy()
        settling = self.alignment is not None and self.alignment.frames < FAST_FRAMES
        due = pair not in self._flows or settling or self._frames % SEARCH_EVERY == 0
        if due:
            start = self._flows.get(pair, np.zeros((*a.shape, 2), np.float32))
            self._flows[pair] = np.asarray(self._search.calc(a, b, start), np.float32)
        low, high = np.percentile(-self._flows[pair][SAMPLE][..., 0], RANGE_PERCENT).tolist()
        first = math.floor(low) - MARGIN_PX
        count = MULTIPLE * math.ceil((high + MARGIN_PX - first) / MULTIPLE)
        self._matcher.setMinDisparity(first)
        self._matcher.setNumDisparities(min(count, MOST))
        # without refinement, a doubtful value is better than none
        self._matcher.setDisp12MaxDiff(MOST if coarse else 1)
        da = self._matched(a, b, coarse)
        db = self._matched(b[:, ::-1].copy(), a[:, ::-1].copy(), coarse)[:, ::-1].copy()
        agree = np.abs(da - _from_right(db, da))[SAMPLE] < RETURN_PX
        self._flows[pair][SAMPLE][..., 0][agree] = -da[SAMPLE][agree]  # the next range is around it
        if due and self.alignment is not None:
            # flow finds how far lines are from each other that do not match yet, coarsely
            lower = self._flows[pair][..., 1] if settling else -_rest(a, b, da, (0, 1))
            self.alignment.add(a, 2 * lower)
        return (2 * da.T, 2 * db.T, agree) if below else (2 * da, 2 * db, agree)

    def _matched(self, a: Grey, b: Grey, coarse: bool) -> FloatMap:
        """Disparity of a picture whose neighbour b is to the right, in px of both."""
        height, width = a.shape
        low = self._matcher.getMinDisparity()
        left, right = max(low + self._matcher.getNumDisparities(), 0), max(-low, 0)
        lines = [
            cv2.copyMakeBorder(
                cv2.resize(one, (width, (height + 1) // 2), interpolation=cv2.INTER_AREA),
                *(0, 0, left, right),
                cv2.BORDER_REPLICATE,
            )
            for one in (a, b)
        ]
        steps = cv2.medianBlur(self._matcher.compute(*lines)[:, left : left + width], 3)
        disparity = np.asarray(
            cv2.resize(steps.astype(np.float32) / 16, (width, height)), np.float32
        )
        return disparity if coarse else _refined(a, b, disparity)


def _from_right(picture: NDArray[Any], disparity: FloatMap) -> NDArray[Any]:
    """What the neighbour to the right shows of each point."""
    xx, yy = grid_xy(*disparity.shape)
    return cv2.remap(picture, xx - disparity, yy, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _misfit(a: Grey, b: Grey, disparity: FloatMap) -> NDArray[np.uint16]:
    return np.asarray(
        cv2.boxFilter(
            cv2.absdiff(a, _from_right(b, disparity)), cv2.CV_16U, FIT_PX, normalize=False
        ),
        np.uint16,
    )


def _refined(a: Grey, b: Grey, disparity: FloatMap) -> FloatMap:
    """Disparity of neighbours where it fits better, and what remains."""
    best, least = disparity.copy(), _misfit(a, b, disparity)
    for extreme, near in TRIED:
        other = np.asarray(extreme(best, near), np.float32)
        misfit = _misfit(a, b, other) + np.uint16(BETTER_LEVELS)
        cv2.copyTo(other, cv2.compare(misfit, least, cv2.CMP_LT), best)
        cv2.min(least, misfit, least)
    return np.asarray(cv2.medianBlur(best + _rest(a, b, best, (1, 0)), 3), np.float32)


def _rest(a: Grey, b: Grey, disparity: FloatMap, along: tuple[int, int]) -> FloatMap:
    """By what disparity along x or y differs, by least squares (Lucas and Kanade 1981)."""
    slope = cv2.Scharr(a, cv2.CV_32F, *along, scale=1 / 32)
    pull = cv2.blur(slope * cv2.subtract(_from_right(b, disparity), a, dtype=cv2.CV_32F), LEAST_PX)
    step_px = pull / (cv2.blur(slope * slope, LEAST_PX) + np.float32(FLATNESS))
    return np.asarray(np.clip(step_px, -STEP_PX, STEP_PX), np.float32)


METHOD = "warp2"
# Time constant of the range of disparity, by which depth and screen plane are chosen: a hand that
# comes near does not change the depth of everything else.
RANGE_S = 2.0
CHANGED_LEVELS = 12.0  # between two frames: more, and old disparity does not hold
UNKNOWN_AROUND = 3  # px of the map around such a change, too


def summary_of(live: LiveSource, name: str) -> SceneSummary:
    """The summary of a live light field for its session."""
    return SceneSummary(
        pack="",
        name=name,
        rows=live.rows,
        cols=live.cols,
        height_px=live.height_px,
        width_px=live.width_px,
        method=METHOD,
        has_disparity=True,
    )


class LiveViews:
    """A LightField whose views and disparities are replaced frame by frame, in place."""

    def __init__(self, live: LiveSource, name: str) -> None:
        self._live = live
        grid = live.rows, live.cols
        self._views = np.zeros((1, *grid, 3, live.height_px, live.width_px), np.uint8)
        self._maps = np.full((1, *grid, *map_size(live)), UNKNOWN, np.int8)
        self._record = np.zeros((), disparity_dtype(live))
        self._greens: dict[View, NDArray[np.uint8]] = {}  # of the frame of the disparity
        self._range: tuple[float, ...] = ()  # low, high, low and high at the border
        self._t_ns = 0
        manifest = Manifest(
            complete=False,  # its views are compared with nothing
            name=name,
            rows=live.rows,
            cols=live.cols,
            height=live.height_px,
            width=live.width_px,
            channels=3,
            frames=1,
            present=[[1] * live.cols] * live.rows,
            disparity=Disparity(source=DisparitySource.ESTIMATED),
            method=METHOD,
        )
        self.field = LightField.of(manifest, self._views, self._maps)
        """The newest frame."""

    def show(
        self, frame: NDArray[np.uint8], views: Iterable[View], record: NDArray[np.void], t_ns: int
    ) -> LightField:
        """Shows views of a frame, uint8 (height, width, 3) BGR, with the disparity record of this
        frame.
        """
        self.measure(frame, record, t_ns)
        self._fill(frame, views)
        return self.field

    def measure(self, frame: NDArray[np.uint8], record: NDArray[np.void], t_ns: int) -> None:
        """Sets the disparity of a frame, which a later one may be shown with."""
        self._maps[:] = UNKNOWN
        self._greens.clear()
        self._record = record.copy()
        for k in range(int(record["count"])):
            row, col = record["views"][k].tolist()
            self._maps[0, row, col] = record["maps"][k]
            self._greens[row, col] = self._green(frame, (row, col))
        (top, left), (low, right) = record["positions"].tolist()
        drawn = ((top, left), (low, right)) if math.isfinite(top) else None
        self.field = attrs.evolve(self.field, eye_positions=drawn)
        self._follow_range(record, t_ns)

    def show_with_last(self, frame: NDArray[np.uint8], views: Iterable[View]) -> LightField:
        """Shows views of a frame with the disparity that was set last; unknown where the picture
        has changed since.
        """
        side = 2 * UNKNOWN_AROUND + 1
        for view, green in self._greens.items():
            changed = cv2.absdiff(self._green(frame, view), green) > CHANGED_LEVELS
            around = cv2.dilate(changed.astype(np.uint8), np.ones((side, side), np.uint8))
            self._maps[0, view[0], view[1]][around > 0] = UNKNOWN
        self._fill(frame, views)
        self.field = attrs.evolve(self.field)
        return self.field

    def _green(self, frame: NDArray[np.uint8], view: View) -> NDArray[np.uint8]:
        """A view of a frame at the size of its map."""
        green = cut(frame, self._live, view, bool(self._record["swapped"]))[..., 1]
        return np.asarray(
            cv2.resize(green, map_size(self._live)[::-1], interpolation=cv2.INTER_AREA), np.uint8
        )

    def _fill(self, frame: NDArray[np.uint8], views: Iterable[View]) -> None:
        two_cameras = self._live.rows * self._live.cols == 2
        for row, col in views:
            picture = cut(frame, self._live, (row, col), bool(self._record["swapped"]))
            if two_cameras and col == 1:
                picture = aligned(picture, self._record["bend"])
            picture = matched(picture, self._record["curves"][col])
            for channel in range(3):
                cv2.extractChannel(picture, 2 - channel, self._views[0, row, col, channel])

    def _follow_range(self, record: NDArray[np.void], t_ns: int) -> None:
        step_px = float(record["scale_px"])
        count = int(record["count"])
        border = border_range(record["maps"][:count].astype(np.float32) * np.float32(step_px))
        new = (float(record["low_px"]), float(record["high_px"]), *border)
        share = low_pass_gain((t_ns - self._t_ns) / 1e9, RANGE_S) if self._range else 1.0
        self._range = tuple(
            was + share * (now - was) for was, now in zip(self._range or new, new, strict=True)
        )
        self._t_ns = t_ns
        low, high, border_low, border_high = self._range
        self.field = attrs.evolve(
            self.field,
            disparity_scale_px=step_px,
            disparity_min_px=low,
            disparity_max_px=high,
            border_px=(border_low, border_high),
        )
