"""Reads the frames of a live session for a recorder: in order, as the source's own JPEGs if it delivers them."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lfpipe.transport.context import Context
from lfpipe.transport.packet_ring import PacketInput
from lfpipe.transport.ring import Stamp


class FrameReader:
    """width_px, height_px: of the stored frames; for JPEGs, the source's own size."""

    def __init__(self, context: Context) -> None:
        self._row, self._frames = context.row, context.input("frames")
        part = context.options.packets
        self.shape: tuple[int, ...] = self._frames.reader.shape
        self.height_px, self.width_px = self.shape[:2]
        self._packets, self._begun = None, True  # type: tuple[PacketInput | None, bool]
        if part:
            try:
                self._packets = PacketInput(context.spec.session, part)
            except FileNotFoundError:
                return  # stopped before it began
            self.width_px, self.height_px = context.options.jpeg_px or (0, 0)

    def skip(self) -> None:
        """Frames published until now are neither recorded nor counted as lost. Nor are frames before the first JPEG."""
        self._frames.skip()
        self._begun = False

    def take(self, spare: Callable[[], NDArray[np.uint8]]) -> tuple[Stamp, NDArray[np.uint8] | bytes] | None:
        """The next frame: its JPEG, or its picture copied to an array of `shape` from spare; None if there is no new frame."""
        while (peeked := self._frames.peek(in_order=True)) is not None:
            stamp, slot = peeked
            packet = self._packets.of(stamp) if self._packets else None
            if packet is not None:
                self._begun = True
                return stamp, packet
            if self._packets is not None and self._packets.ended:
                return None  # the recording is being stopped; capture has already stopped sending JPEGs
            if self.shape[:2] != (self.height_px, self.width_px):
                self._row["drops"] += self._begun  # it is scaled, so it does not fit this recording
                continue
            picture = spare()
            np.copyto(picture, slot)
            if self._frames.still_valid(stamp):
                return stamp, picture
        return None

    def close(self) -> None:
        """Unmaps the packets."""
        if self._packets is not None:
            self._packets.close()
