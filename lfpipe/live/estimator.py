"""Disparity of neighbouring views of a live light field, frame by frame.

Only the views in need are estimated, in pairs along the lines of the grid, by optical flow in both
directions at half the resolution (dense inverse search, see `lfpipe.scene.optical_flow`). Each
frame starts from the last one's result. The flow stops at a quarter of the resolution; least
squares of the difference, along the line of the grid, take it to half.
"""

from collections.abc import Mapping, Sequence

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import LiveSource
from lfpipe.live.alignment import Alignment
from lfpipe.live.records import Pair, View, cut, views_of
from lfpipe.scene.disparity import quantised
from lfpipe.scene.optical_flow import FloatMap, Grey, grid_xy

# Of dense inverse search: finest scale, stride of patches, descents, smoothings.
FINE, COARSE = (1, 4, 6, 0), (2, 4, 16, 5)
FINE_PAIRS = 2  # more, where the viewpoint is between two rows, take the coarse one
PATCH_PX = 8
# Of the refinement: passes; px by which one moves, for the picture is linear within them; squared
# grey levels per px^2 below which a picture says little.
PASSES, PASS_PX, FLATNESS = 2, 0.5, 8.0
RETURN_PX = 1.0  # between the disparity of a point in both views, which agree
# Between two frames, in grey levels: below, a pixel has not changed but for the camera's noise, and
# KEPT of its last disparity remains, unless that differs by MOVED_PX.
NOISE_LEVELS, KEPT, MOVED_PX = 6.0, 0.75, 1.0
# Of a pair's pixels that agree: 0.74 to 1 were measured in pairs of ten light fields, up to 4 views
# apart, and 0.02 to 0.34 in fifteen pairs of unrelated pictures.
AGREE_SHARE = 0.5
# disparity of the nearest, and frames in a row below it, by which two cameras are swapped
BEHIND_PX, BEHIND_FRAMES = -2.0, 30
RANGE_PERCENT = (1.0, 99.0)  # of the disparities that count as farthest and nearest
STEPS_PX = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0)  # of stored disparity, which has 8 bits
SMALLER_STEP = 0.7  # share of a smaller step's range that must suffice before it is used
UNTURNED = np.eye(2, 3, dtype=np.float32)


@attrs.frozen
class Found:
    """Disparity of views of one frame."""

    maps: Mapping[View, NDArray[np.int8]]
    """As in `LightField.disparity`, in steps of step_px."""
    step_px: float
    range_px: tuple[float, float]
    """Farthest and nearest."""
    positions: NDArray[np.float64] = attrs.field(factory=lambda: np.full((2, 2), np.nan))
    """As in the record of disparity."""

    @classmethod
    def of(
        cls, maps: Mapping[View, NDArray[np.int8]], step_px: float, positions: NDArray[np.float64]
    ) -> "Found":
        """Of known maps."""
        sample = np.concatenate([one[::4, ::4].ravel() for one in maps.values()])
        low, high = (np.percentile(sample, RANGE_PERCENT) * step_px).tolist()
        return cls(maps, step_px, (low, high), positions)

    def write(
        self,
        record: NDArray[np.void],
        align: NDArray[np.float32] = UNTURNED,
        swapped: bool = False,
    ) -> NDArray[np.void]:
        """Fills a record of disparity; returns it."""
        record["count"] = len(self.maps)
        record["scale_px"] = self.step_px
        record["low_px"], record["high_px"] = self.range_px
        record["positions"] = self.positions
        record["align"] = align
        record["swapped"] = swapped
        for k, (view, disparity) in enumerate(self.maps.items()):
            record["views"][k] = view
            record["maps"][k] = disparity
        return record


class _PairState:
    """The last frame of a pair of views."""

    def __init__(self, flows: tuple[FloatMap, FloatMap]) -> None:
        self.flows = flows
        self.disparities: tuple[FloatMap, FloatMap] | None = None
        self.greys: tuple[Grey, Grey] | None = None


class Estimator:
    """Disparity of the views in need, and the alignment of a pair of cameras."""

    def __init__(self, live: LiveSource, aligns: bool) -> None:
        """aligns: whether the views are those of two cameras, which may be turned."""
        self._live = live
        self._engines = [_engine(*FINE), _engine(*COARSE)]
        self._states: dict[Pair, _PairState] = {}
        placed = live.placement
        self.alignment = Alignment(live.width_px, live.height_px, placed) if aligns else None
        self.swapped = placed is not None and placed.swapped
        """Whether the left camera delivers the right view, as in the record of disparity."""
        self.strange_frames = 0
        """In a row, whose views do not show one scene."""
        self._agreement = 0.0  # of the last pair: share of its pixels that agree in both directions
        self._behind = 0  # frames in a row in which everything is behind infinity
        self._step_px = STEPS_PX[1]

    def estimate(
        self, frame: NDArray[np.uint8], pairs: Sequence[Pair], coarse: bool = False
    ) -> Found:
        """Disparity of the views of some pairs in a frame, uint8 (height, width, 3) BGR."""
        greys = {view: self._grey(frame, view) for view in views_of(pairs)}
        engine = self._engines[coarse or len(pairs) > FINE_PAIRS]
        found: dict[View, FloatMap] = {}
        agreement = 0.0
        for pair in pairs:
            a, b = pair
            both = self._pair(pair, greys[a], greys[b], engine)
            for view, disparity in zip(pair, both, strict=True):
                found.setdefault(view, disparity)
            agreement = max(agreement, self._agreement)
        self.strange_frames = self.strange_frames + 1 if agreement < AGREE_SHARE else 0
        self._states = {pair: state for pair, state in self._states.items() if pair in pairs}
        sample = np.concatenate([one[::4, ::4].ravel() for one in found.values()])
        low, high = np.percentile(sample, RANGE_PERCENT).tolist()
        self._set_step(max(abs(low), abs(high)))
        if self.alignment is not None:
            self._follow_order(high)
        maps = {view: quantised(disparity, self._step_px) for view, disparity in found.items()}
        return Found(maps, self._step_px, (low, high))

    def _follow_order(self, nearest_px: float) -> None:
        """Exchanges two cameras that deliver each other's view: with parallel ones, nothing is
        farther than infinity, which has disparity 0.
        """
        self._behind = self._behind + 1 if nearest_px < BEHIND_PX else 0
        if self._behind == BEHIND_FRAMES:
            self.swapped = not self.swapped
            self.alignment = Alignment(self._live.width_px, self._live.height_px)
            self._states.clear()

    def _grey(self, frame: NDArray[np.uint8], view: View) -> Grey:
        """A view in grey at half its size, aligned."""
        live = self._live
        size = (live.width_px + 1) // 2, (live.height_px + 1) // 2
        view_px = cut(frame, live, view, self.swapped)
        whole = cv2.cvtColor(view_px, cv2.COLOR_BGR2GRAY)
        grey = np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA), np.uint8)
        if self.alignment is not None and view[1] == live.cols - 1:
            return self.alignment.apply(grey, 0.5)
        return grey

    def _pair(
        self, pair: Pair, a: Grey, b: Grey, engine: cv2.DISOpticalFlow
    ) -> tuple[FloatMap, FloatMap]:
        zeros = np.zeros((*a.shape, 2), np.float32)
        state = self._states.setdefault(pair, _PairState((zeros, zeros.copy())))
        ahead, back = state.flows
        ahead = np.asarray(engine.calc(a, b, ahead), np.float32)
        back = np.asarray(engine.calc(b, a, back), np.float32)
        state.flows = ahead, back
        if self.alignment is not None:
            self.alignment.add(a, 2 * ahead)
        axis = 0 if pair[0][0] == pair[1][0] else 1
        two = np.float32(2)
        there, here = ahead[..., axis], back[..., axis]
        if engine is self._engines[0]:
            there, here = _refined(a, b, there, axis), _refined(b, a, here, axis)
        da, db = -two * there, two * here
        seen_by_a = _moved(db, there, axis)
        self._agreement = float(np.mean(np.abs(da - seen_by_a)[::4, ::4] < RETURN_PX))
        disparities = da, db
        if state.disparities is not None and state.greys is not None:
            disparities = (
                _steadied(disparities[0], state.disparities[0], a, state.greys[0]),
                _steadied(disparities[1], state.disparities[1], b, state.greys[1]),
            )
        state.disparities, state.greys = disparities, (a, b)
        return disparities

    def _set_step(self, most_px: float) -> None:
        """Follows the range of disparity; a smaller step only well within its range."""
        fits = next((step for step in STEPS_PX if most_px <= 127 * step), STEPS_PX[-1])
        if fits > self._step_px or most_px <= SMALLER_STEP * 127 * fits:
            self._step_px = fits


def _engine(finest: int, stride: int, descents: int, smoothings: int) -> cv2.DISOpticalFlow:
    engine = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    engine.setFinestScale(finest)
    engine.setPatchSize(PATCH_PX)
    engine.setPatchStride(stride)
    engine.setGradientDescentIterations(descents)
    engine.setVariationalRefinementIterations(smoothings)
    return engine


def _moved(picture: FloatMap, by_px: FloatMap, axis: int) -> FloatMap:
    """A picture sampled by_px away along an axis; nothing beyond its border."""
    xx, yy = grid_xy(*picture.shape)
    x, y = (xx + by_px, yy) if axis == 0 else (xx, yy + by_px)
    return np.asarray(cv2.remap(picture, x, y, cv2.INTER_LINEAR), np.float32)


def _refined(a: Grey, b: Grey, flow_px: FloatMap, axis: int) -> FloatMap:
    """Flow from a to b along an axis, by least squares over 5x5 px (Lucas and Kanade 1981)."""
    there = b.astype(np.float32)
    slopes = np.asarray(cv2.Scharr(there, cv2.CV_32F, 1 - axis, axis, scale=1 / 32), np.float32)
    for _ in range(PASSES):
        slope = _moved(slopes, flow_px, axis)
        wrong = a - _moved(there, flow_px, axis)
        pull = cv2.blur(slope * wrong, (5, 5))
        step_px = pull / (cv2.blur(slope * slope, (5, 5)) + np.float32(FLATNESS))
        flow_px = flow_px + np.clip(step_px, -PASS_PX, PASS_PX)
    return flow_px


def _steadied(new: FloatMap, last: FloatMap, grey: Grey, last_grey: Grey) -> FloatMap:
    """New disparity, low-passed where the picture stands still, so that noise does not flicker."""
    still = cv2.absdiff(grey, last_grey) <= NOISE_LEVELS
    still &= np.abs(new - last) < MOVED_PX
    return np.where(still, new + np.float32(KEPT) * (last - new), new)
