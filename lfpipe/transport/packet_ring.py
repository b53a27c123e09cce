"""The rings of original JPEGs of frames, from capture to the recorder. They exist only while a
recording runs.

A slot contains one packet of variable length and the frame's stamps. (epoch, source_seq) identify
the frame decoded from it. The packet is published before the frame.
"""

import contextlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfpipe.config import SessionOptions
from lfpipe.host.files import is_missing
from lfpipe.host.segment import SHM_DIR
from lfpipe.transport import ring
from lfpipe.transport.ring import Stamp
from lfpipe.transport.session import Session


def packet_dtype(most_bytes: int) -> np.dtype[Any]:
    """One slot: a packet of up to most_bytes."""
    return np.dtype([("bytes", "<i8"), ("data", "u1", (most_bytes,))])


class PacketOutput:
    """The writing end; an option of the session names the ring, if there is any."""

    def __init__(self, session: Session, option: str) -> None:
        self._session = session
        self._option = option
        self._name = ""
        self._ring: ring.Writer | None = None

    def set_options(self, options: SessionOptions) -> None:
        """Opens and closes the ring as options require; cheap if nothing changes."""
        name = getattr(options, self._option)
        if name == self._name:
            return
        self.close()
        self._name = name
        if self._name:
            with contextlib.suppress(FileNotFoundError):  # removed before use
                self._ring = ring.Writer(self._session.segment(self._name))

    def publish(
        self,
        packet: NDArray[np.uint8] | None,
        source_seq: int,
        t_sensor_ns: int,
        t_read_ns: int,
        epoch: int,
    ) -> None:
        """Publishes packet, uint8 (n,), if a recording runs and the packet fits.

        epoch: of the frame.
        """
        if self._ring is None or packet is None:
            return
        slot = self._ring.begin()
        if packet.size <= slot["data"].size:
            slot["bytes"][...] = packet.size
            slot["data"][: packet.size] = packet
            self._ring.publish(source_seq, t_sensor_ns, t_read_ns, epoch)

    def close(self) -> None:
        """Unmaps the ring."""
        if self._ring is not None:
            self._ring.close()
        self._ring = None


class PacketInput:
    """The reading end. Raises FileNotFoundError if the ring has been removed."""

    def __init__(self, session: Session, name: str) -> None:
        self._name = session.segment(name)
        self._ring = ring.Reader(self._name)
        self._ring.last_seq = 0  # the packet of the first frame may already be there
        self._at = (-1, -1)
        self._data: bytes | None = None

    def of(self, stamp: Stamp) -> bytes | None:
        """The packet of the frame with that stamp; None if there was none, or it is overwritten.

        Call it in order of frames.
        """
        frame = (stamp.epoch, stamp.source_seq)
        while self._at < frame and (peeked := self._ring.peek(in_order=True)) is not None:
            packet_stamp, slot = peeked
            self._at = (packet_stamp.epoch, packet_stamp.source_seq)
            data = slot["data"][: int(slot["bytes"])].tobytes() if self._at >= frame else None
            self._data = data if self._ring.still_valid(packet_stamp) else None
        return self._data if self._at == frame else None

    @property
    def ended(self) -> bool:
        """Whether the ring has been removed: later frames have no packets. Its name is never used
        again.
        """
        return is_missing(SHM_DIR / self._name)

    def close(self) -> None:
        """Unmaps the ring."""
        self._ring.close()
