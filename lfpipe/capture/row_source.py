"""Several cameras in a row as one source: their frames of the same moment side by side."""

from collections.abc import Sequence

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.frame_source import Frame, FrameSource
from lfpipe.errors import UserError

# Channels follow those of the first camera by a gain, of which this share is taken from each frame:
# within seconds, without reacting to what only one camera sees.
GAIN_SHARE, LARGEST_GAIN = 0.02, 1.5
TOLD_GAIN = 0.05  # a larger change is reported
SMALL_PX = (32, 24)  # at which brightness is compared


class RowSource:
    """Frames of cameras in a row. One that is further than half a frame from the first camera's is
    left out; brightness and white balance follow those of the first camera.
    """

    def __init__(self, sources: Sequence[FrameSource]) -> None:
        """sources: from left to right, open, of frames of one size."""
        self._sources = sources
        first = sources[0].info
        width, height = first.size_px
        sizes_px = [source.info.size_px for source in sources]
        if any(w * height != h * width for w, h in sizes_px):  # others are scaled
            sizes = ", ".join(f"{w}x{h}" for w, h in sizes_px)
            raise UserError(
                f"cameras in a row deliver {sizes} px", "choose one size with ?size=WxH"
            )
        self._half_ns = round(0.5e9 / max(first.rate_hz, 1.0))
        self._pictures = [np.empty((height, width, 3), np.uint8) for _ in sources]
        self._gains = np.ones((len(sources), 3))
        self._told_gains = self._gains.copy()
        self.offset_ns = 0
        """Between the first and the last frame of the newest picture."""
        name = ",".join(source.info.name for source in sources)
        self.info = attrs.evolve(
            first, name=name, size_px=(width * len(sources), height), jpeg=False
        )

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `FrameSource.read`."""
        frames = [
            source.read(picture)
            for source, picture in zip(self._sources, self._pictures, strict=True)
        ]
        while True:
            known = [frame for frame in frames if frame is not None]
            if len(known) < len(frames):
                return None
            stamps = [frame.t_sensor_ns for frame in known]
            oldest = int(np.argmin(stamps))
            self.offset_ns = max(stamps) - min(stamps)
            if self.offset_ns <= self._half_ns:
                break
            frames[oldest] = self._sources[oldest].read(self._pictures[oldest])
        for k, tile in enumerate(np.split(out, len(frames), axis=1)):
            self._match(k)
            cv2.multiply(self._pictures[k], np.append(self._gains[k], 1.0), dst=tile)
        self._report()
        first = known[0]
        return attrs.evolve(first, packet=None)

    def _match(self, k: int) -> None:
        """Follows the brightness of the first camera's channels."""
        if k == 0:
            return
        left, right = (
            cv2.resize(self._pictures[i], SMALL_PX, interpolation=cv2.INTER_AREA)
            .reshape(-1, 3)
            .mean(axis=0)
            + 1.0
            for i in (0, k)
        )
        gain = np.clip(left / right, 1 / LARGEST_GAIN, LARGEST_GAIN)
        self._gains[k] += GAIN_SHARE * (gain - self._gains[k])

    def _report(self) -> None:
        """States the gains in `info`, anew once they have changed."""
        if np.abs(self._gains - self._told_gains).max() > TOLD_GAIN:
            self._told_gains = self._gains.copy()
            gains = (
                f"camera {k} matched to the first: blue x{blue:.2f}, green x{green:.2f}, red"
                f" x{red:.2f}"
                for k, (blue, green, red) in enumerate(self._gains[1:].tolist(), 2)
            )
            self.info = attrs.evolve(self.info, notes=(*self._sources[0].info.notes, *gains))

    def close(self) -> None:
        for source in self._sources:
            source.close()
