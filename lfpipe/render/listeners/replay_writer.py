"""The pictures that a replay keeps: a digest of each, a few for people, and as many as fit for a
comparison.

Runs in the render stage. Pictures for comparison are packets in folder/pictures: every composed one
while they take less than KEPT_BYTES, then those of every second, fourth, ... frame, so that two
runs always have frames in common.
"""

import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfpipe.files.safe_files import write_file
from lfpipe.render.presenter import Listener, Presentation
from lfpipe.sequence.eyes import read_truth
from lfpipe.sequence.packets import PacketWriter, encoded
from lfpipe.transport.ring import Stamp

KEPT_BYTES = 8 << 20  # a reference is committed
PICTURES = "pictures"


class ReplayWriter(Listener):
    """folder: of the run's results. sequence: its folder, whose true eyes determine the worst
    picture. pictures: keep them.
    """

    def __init__(
        self,
        folder: Path,
        sequence: str,
        pictures: bool,
        lost: Callable[[str], None],
    ) -> None:
        """lost: called with the reason if the disk is full."""
        self._folder = folder
        self._pictures = pictures
        self._lost = lost
        self._truth = read_truth(Path(sequence))
        self._first_ns: int | None = None
        self._digest = ""
        self._stride = 1
        self._kept = dict[int, tuple[Stamp, bytes]]()
        self._named: dict[str, NDArray[np.uint8]] = {}  # first, last and worst picture
        self._worst_px = -1.0

    def handed_over(self, presentation: Presentation) -> None:
        """Stores the picture; adds eyes_filtered and its digest to the trace line."""
        if presentation.eyes is None:
            return
        stamp = presentation.eyes.stamp
        self._first_ns = stamp.t_sensor_ns if self._first_ns is None else self._first_ns
        picture = presentation.picture
        if picture is not None:
            if presentation.composed:
                self._digest = f"{zlib.crc32(picture.data):08x}"
                if self._pictures:
                    self._store(stamp, picture)
                if not self._named:
                    self._named["first"] = picture.copy()
                self._named["last"] = picture
            error_px = self._error_px(presentation)
            if error_px > self._worst_px:  # false without ground truth
                self._named["worst"] = picture.copy()
                self._worst_px = error_px
        filtered_px = presentation.eyes.record.filtered_px
        presentation.more["eyes_filtered"] = {"left": filtered_px[:2], "right": filtered_px[2:]}
        presentation.more["picture"] = self._digest

    def _error_px(self, presentation: Presentation) -> float:
        if not self._truth:
            return -1.0
        used_px = np.reshape(presentation.viewpoints.eyes_px, (2, 2))
        seen_ns = presentation.display_time.seen_ns - (self._first_ns or 0)
        return float(self._truth.error_px(used_px, seen_ns))

    def _store(self, stamp: Stamp, picture: NDArray[np.uint8]) -> None:
        if stamp.source_seq % self._stride:
            return
        self._kept[stamp.source_seq] = (stamp, encoded(picture))
        while (
            sum(len(kept) for _, kept in self._kept.values()) > KEPT_BYTES and len(self._kept) > 1
        ):
            self._stride *= 2
            self._kept = {seq: kept for seq, kept in self._kept.items() if seq % self._stride == 0}

    def close(self) -> None:
        """Writes the pictures."""
        try:
            (self._folder / PICTURES).mkdir()
            writer = PacketWriter(self._folder / PICTURES)
            for seq, (stamp, data) in sorted(self._kept.items()):
                writer.append(
                    data, "png", seq, stamp.epoch, stamp.t_sensor_ns - (self._first_ns or 0), 0
                )
            writer.close()
            for name, picture in self._named.items():
                write_file(self._folder / f"{name}.png", encoded(picture))
        except OSError as error:
            self._lost(f"{self._folder}: {error.strerror}")
