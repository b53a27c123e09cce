"""Several cameras in a row as one source: their frames of the same moment side by side."""

from collections.abc import Sequence

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.frame_source import Frame, FrameSource
from lfpipe.files.decoding import fit_area, fit_note, fitted

JITTER_NS = 2_000_000  # of stamps: a frame that is nearer by less is no better
MOST_SKIPPED = 8  # frames of a camera, whose driver may have kept as many


class RowSource:
    """Frames of cameras in a row: of each camera, the one that is nearest in time to those of the
    others.
    """

    def __init__(self, sources: Sequence[FrameSource], tile_px: tuple[int, int]) -> None:
        """sources: from left to right, open. tile_px: the most of a picture that one may take."""
        self._sources = sources
        first = sources[0].info
        _, _, width, height = fit_area(first.size_px, tile_px)
        self._periods_ns = [round(1e9 / max(source.info.rate_hz, 1.0)) for source in sources]
        self._pictures = [np.empty((height, width, 3), np.uint8) for _ in sources]
        sizes_px = {source.info.size_px for source in sources} - {(width, height)}
        scaled = [fit_note(size_px, (width, height)) for size_px in sorted(sizes_px)]
        notes = tuple(dict.fromkeys([*first.notes, *scaled]))
        name = ",".join(source.info.name for source in sources)
        self.info = attrs.evolve(
            first, name=name, size_px=(width * len(sources), height), jpeg=False, notes=notes
        )

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `FrameSource.read`."""
        frames = [self._next(k) for k in range(len(self._sources))]
        for _ in range(MOST_SKIPPED):
            if None in frames or not (late := self._late([f.t_sensor_ns for f in frames if f])):
                break
            for k in late:
                frames[k] = self._next(k)
        known = [frame for frame in frames if frame is not None]
        if len(known) < len(frames):
            return None
        for k, tile in enumerate(np.split(out, len(known), axis=1)):
            fitted(self._pictures[k], tile)
        stamps = [frame.t_sensor_ns for frame in known]
        return attrs.evolve(known[0], packet=None, offset_ns=max(stamps) - min(stamps))

    def _next(self, k: int) -> Frame | None:
        return self._sources[k].read(self._pictures[k])

    def _late(self, stamps: list[int]) -> list[int]:
        """The cameras whose next frames are nearer to the frames of the others; [] if these frames
        are the nearest that there are.
        """
        order = sorted(range(len(stamps)), key=stamps.__getitem__)

        def spread_ns(late: int) -> int:
            after = [stamps[k] + self._periods_ns[k] * (k in order[:late]) for k in order]
            return max(after) - min(after)

        best = min(range(len(order)), key=spread_ns)
        return order[:best] if spread_ns(best) < spread_ns(0) - JITTER_NS else []

    def close(self) -> None:
        for source in self._sources:
            source.close()
