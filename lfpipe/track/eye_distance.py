"""The distance between the eyes: the viewer's own in mm, learnt from the size of the iris, and in px for `lfpipe calibrate`.

The visible iris is 11.7 +- 0.5 mm wide, so the result is accurate to 4 %. People's distances differ by +-10 % from the mean, 63
mm.
"""

from collections import deque

import numpy as np

from lfpipe.track.engine import Face
from lfpipe.transport.clock import SECOND_NS

IRIS_MM = 11.7
WINDOW_NS = 4 * SECOND_NS
LEAST_NS, LEAST_COUNT = SECOND_NS, 20  # shortest time observed, fewest samples
SPREAD = 0.05  # a distance is reported if half of the samples are within this share of the median
PLAUSIBLE_MM = (45.0, 80.0)  # adults and children; anything else is a wrong measurement
CHANGED_MM = 1.0  # smallest change that is reported
EVERY = 8  # samples between two updates of the median
GAUGE_FRAMES, GAUGE_SPREAD = 45, 0.05  # per measurement; quartiles further apart than this share of the median: they moved


class EyeDistance:
    """Running median over frontal faces. mm: the distance once it is steady, 0.0 before; it is kept while there is no face."""

    def __init__(self) -> None:
        self.mm = 0.0
        self._seen: deque[tuple[int, float]] = deque()
        self._count = 0

    def reset(self) -> None:
        """Discards the samples: the next face may be another person's."""
        self._seen.clear()

    def update(self, t_ns: int, face: Face) -> float:
        """Adds the face of a frame and returns `mm`. Ignores faces without a known iris, and values that are not numbers."""
        apart_px = float(np.hypot(*(face.eyes_px[0] - face.eyes_px[1])))
        if not (face.iris_px > 0 and 0 < apart_px < np.inf):
            return self.mm
        if self._seen and t_ns < self._seen[-1][0]:
            self.reset()  # the clock was set back
        self._seen.append((t_ns, IRIS_MM * apart_px / face.iris_px))
        while t_ns - self._seen[0][0] > WINDOW_NS:
            self._seen.popleft()
        self._count += 1
        if self._count % EVERY == 0 and len(self._seen) >= LEAST_COUNT and t_ns - self._seen[0][0] >= LEAST_NS:
            low, middle, high = np.percentile([mm for _, mm in self._seen], (25, 50, 75)).tolist()
            steady = high - low <= 2 * SPREAD * middle and PLAUSIBLE_MM[0] <= middle <= PLAUSIBLE_MM[1]
            if steady and abs(middle - self.mm) >= CHANGED_MM:
                self.mm = middle
        return self.mm


class EyeGauge:
    """Distance between the eyes in px over the last GAUGE_FRAMES frames with a face: median and spread."""

    def __init__(self) -> None:
        self._apart_px: deque[float] = deque(maxlen=GAUGE_FRAMES)

    def add(self, face: Face | None) -> None:
        """Adds a frame's face; ignores a frame without one."""
        if face is not None:
            self._apart_px.append(float(np.hypot(*(face.eyes_px[0] - face.eyes_px[1]))))

    @property
    def full(self) -> bool:
        """Whether GAUGE_FRAMES frames are collected."""
        return len(self._apart_px) == GAUGE_FRAMES

    @property
    def median_px(self) -> float:
        """0 before the first face."""
        return float(np.median(self._apart_px or [0.0]))

    @property
    def steady(self) -> bool:
        """Whether the viewer kept still enough for a reliable median."""
        low, middle, high = np.percentile(self._apart_px or [0.0], (25, 50, 75))
        return bool(high - low <= GAUGE_SPREAD * middle > 0)
