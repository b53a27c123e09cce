"""The protocol that a camera, a file and the demo share."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.transport.stamp_kind import StampKind

NO_MEMORY = -4  # cv::Error::StsNoMem


class BrokenFrame(UserError):
    """Raised by `read` for a frame that cannot be decoded: it is lost, the next call continues after it."""


@contextmanager
def decoding(what: str) -> Iterator[None]:
    """Turns a decoder's failure or lack of memory into BrokenFrame. what: file or device."""
    try:
        yield
    except (MemoryError, cv2.error) as error:
        if isinstance(error, MemoryError) or error.code == NO_MEMORY:
            why, remedy = "decoding needs more memory than allowed or available", "use a smaller picture or video"
        else:
            why, remedy = "cannot be decoded", "save or record it again"
        raise BrokenFrame(f"{what}: {why}", remedy) from None


@attrs.frozen
class SourceInfo:
    """Properties of an open source. width_px, height_px: its own size. rate_hz: what it delivers. live: a device, not a
    recording.
    """

    name: str
    width_px: int
    height_px: int
    rate_hz: float
    live: bool
    jpeg: bool = False  # its frames are JPEGs, each with its `Frame.packet`
    notes: tuple[str, ...] = ()  # to show the user once: scaled frames, another rate than requested, ...


@attrs.frozen
class Frame:
    """Stamps of a frame that `read` wrote. t_sensor_ns: middle of the exposure, or the scheduled time of a file.

    t_read_ns: when the frame left the driver or, for a recording played without a pace, the disk; 0 for any other
    recording, whose frame is due at t_sensor_ns and not before. packet: the JPEG it was decoded from, uint8 (n,), if
    it has the source's own size. stamp: what t_sensor_ns was derived from.
    """

    source_seq: int
    t_sensor_ns: int
    t_read_ns: int
    packet: NDArray[np.uint8] | None = attrs.field(default=None, eq=False, repr=False)
    stamp: StampKind = StampKind.SCHEDULED


class FrameSource(Protocol):
    """A series of frames. Errors of the device or the file are UserError."""

    @property
    def info(self) -> SourceInfo: ...

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """Decodes the next frame into out, uint8 (height, width, 3) BGR, scaling if sizes differ; returns None at the end.

        May block for the next frame of a device, 1 s at most (then raises TimeoutError); never sleeps for a recording. Raises
        BrokenFrame for a frame of a recording that cannot be decoded; its number is then missing.
        """
        ...

    def close(self) -> None: ...
