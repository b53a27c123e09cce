"""The pictures that a replay keeps: a digest of each, a few for people, and as many as fit for a comparison.

Runs in the render stage. Pictures for comparison are packets in folder/pictures: every composed one while they take less than
KEPT_BYTES, then those of every second, fourth, ... frame, so that two runs always have frames in common.
"""

import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfpipe.eyes import Eyes
from lfpipe.files.output import marked_picture
from lfpipe.sequence.eyes import read_truth
from lfpipe.sequence.packets import PacketWriter, encoded
from lfpipe.transport.ring import Stamp

KEPT_BYTES = 8 << 20  # a reference is committed
PICTURES = "pictures"


class ReplayWriter:
    """folder: of the run's results. sequence: its folder, whose true eyes determine the worst picture. pictures: keep them."""

    def __init__(self, folder: Path, sequence: str, pictures: bool) -> None:
        self.folder, self._pictures = folder, pictures
        self._truth = read_truth(Path(sequence))
        self._first_ns: int | None = None
        self._digest = ""
        self._stride, self._kept = 1, dict[int, tuple[Stamp, bytes]]()
        self._named: dict[str, NDArray[np.uint8]] = {}  # first, last and worst picture
        self._worst_px = -1.0

    def keep(
        self,
        stamp: Stamp,
        filtered_px: Eyes,
        used_px: Eyes,
        t_shown_ns: int,
        picture: NDArray[np.uint8] | None,
        composed: bool,
    ) -> dict[str, Any]:
        """Adds a shown picture; returns additional fields for its line of the trace: eyes_filtered and picture."""
        self._first_ns = stamp.t_sensor_ns if self._first_ns is None else self._first_ns
        if picture is not None:
            if composed:
                self._digest = f"{zlib.crc32(picture.data):08x}"
                if self._pictures:
                    self._store(stamp, picture)
                if not self._named:
                    self._named["first"] = picture.copy()
                self._named["last"] = picture
            error_px = (
                self._truth.error_px((used_px[:2], used_px[2:]), t_shown_ns - self._first_ns)
                if self._truth
                else -1.0
            )
            if error_px > self._worst_px:  # false where the truth is not seen
                self._named["worst"], self._worst_px = picture.copy(), float(error_px)
        return {
            "eyes_filtered": {"left": filtered_px[:2], "right": filtered_px[2:]},
            "picture": self._digest,
        }

    def _store(self, stamp: Stamp, picture: NDArray[np.uint8]) -> None:
        if stamp.source_seq % self._stride:
            return
        _, data = encoded(picture, fast=False)
        self._kept[stamp.source_seq] = (stamp, data)
        while (
            sum(len(kept) for _, kept in self._kept.values()) > KEPT_BYTES and len(self._kept) > 1
        ):
            self._stride *= 2
            self._kept = {seq: kept for seq, kept in self._kept.items() if seq % self._stride == 0}

    def close(self) -> None:
        """Writes the pictures. Raises OSError if there is no room."""
        (self.folder / PICTURES).mkdir()
        writer = PacketWriter(self.folder / PICTURES)
        for seq, (stamp, data) in sorted(self._kept.items()):
            writer.append(
                data, "png", seq, stamp.epoch, stamp.t_sensor_ns - (self._first_ns or 0), 0
            )
        writer.close()
        for name, picture in self._named.items():
            _, data = encoded(picture, fast=False)
            (self.folder / f"{name}.png").write_bytes(marked_picture(data))
