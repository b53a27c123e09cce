"""The newest frame of a live light field as a LightField."""

import math
from collections.abc import Iterable

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import LiveSource, SceneSummary
from lfpipe.eyes import low_pass_gain
from lfpipe.live.alignment import aligned
from lfpipe.live.colours import matched
from lfpipe.live.records import View, cut, disparity_dtype, map_size
from lfpipe.scene.disparity import border_range
from lfpipe.scene.lightfield import UNKNOWN, Disparity, DisparitySource, LightField, Manifest

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
        if not count:
            return
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
