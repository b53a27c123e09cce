"""Disparity of neighbouring views of a live light field, frame by frame.

Only the views in need are estimated, in pairs along the lines of the grid, at half the resolution.
Optical flow (dense inverse search, see `lfpipe.scene.optical_flow`) follows how two cameras stand
and which disparities there are, now and then; semi-global matching (Hirschmueller 2008) finds them,
every second row; then each pixel takes that of a neighbour if it fits better, and least squares
find the rest.
"""

import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import LiveSource
from lfpipe.live.alignment import FAST_FRAMES, Alignment, aligned
from lfpipe.live.colours import Colours, matched
from lfpipe.live.records import (
    RANGE_PERCENT,
    Pair,
    View,
    cut,
    disparity_record,
    map_size,
    views_of,
)
from lfpipe.scene.disparity import quantised
from lfpipe.scene.optical_flow import FloatMap, Grey, Mask, grid_xy

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
# Between the disparity of a point in both views, which agree; of a pair's points that agree.
RETURN_PX, AGREE_SHARE = 0.5, 0.6
# disparity of the nearest, and frames in a row below it, by which two cameras are swapped
BEHIND_PX, BEHIND_FRAMES = -2.0, 30
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
        found: dict[View, FloatMap] = {}
        agreement = 0.0
        for pair in pairs:
            a, b = pair
            da, db, agree = self._pair(pair, shown[a], shown[b], coarse or len(pairs) > FINE_PAIRS)
            found = {a: da, b: db} | found
            agreement = max(agreement, float(agree.mean()))
            if agree.mean() > AGREE_SHARE and self._live.rows == 1 and not self._live.drawn:
                self.colours.add(
                    b[1],
                    wanted=shown[a][SAMPLE][agree],
                    found=_seen(smalls[b], np.float32(0.5) * da)[SAMPLE][agree],
                )
        self._frames += 1
        self.strange_frames = self.strange_frames + 1 if agreement < AGREE_SHARE else 0
        if self.alignment is not None and self.strange_frames:
            # forgets what it was measured from, down to a few frames
            self.alignment.frames = (self.alignment.frames + 4) // 2
        most_px = max(float(np.abs(disparity).max()) for disparity in found.values())
        step_px = FINEST_PX * 2 ** math.ceil(math.log2(max(most_px / MOST_STEPS / FINEST_PX, 1)))
        record = disparity_record(
            self._live, {view: quantised(px, step_px) for view, px in found.items()}, step_px
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
        if self._behind == BEHIND_FRAMES:
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
        agree = np.abs(da - _seen(db, da))[SAMPLE] < RETURN_PX
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


def _seen(picture: NDArray[Any], disparity: FloatMap) -> NDArray[Any]:
    """What the neighbour to the right shows of each point."""
    xx, yy = grid_xy(*disparity.shape)
    at = xx - disparity
    return cv2.remap(picture, at, yy, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _misfit(a: Grey, b: Grey, disparity: FloatMap) -> NDArray[np.uint16]:
    return np.asarray(
        cv2.boxFilter(cv2.absdiff(a, _seen(b, disparity)), cv2.CV_16U, FIT_PX, normalize=False),
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
    pull = cv2.blur(slope * cv2.subtract(_seen(b, disparity), a, dtype=cv2.CV_32F), LEAST_PX)
    step_px = pull / (cv2.blur(slope * slope, LEAST_PX) + np.float32(FLATNESS))
    return np.asarray(np.clip(step_px, -STEP_PX, STEP_PX), np.float32)
