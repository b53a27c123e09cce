"""Where frames come from: the protocol that a camera, a file and the demo share."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError

NO_MEMORY = -4  # cv::Error::StsNoMem


class BrokenFrame(UserError):
    """Raised by `read` for a frame that cannot be decoded: it is lost, and the next call goes on after it."""


@contextmanager
def decoding(what: str) -> Iterator[None]:
    """Raises BrokenFrame where a decoder fails in its own way or runs out of memory. what: file or device."""
    try:
        yield
    except (MemoryError, cv2.error) as error:
        if isinstance(error, MemoryError) or error.code == NO_MEMORY:
            why, remedy = "decoding takes more memory than is allowed or there", "a smaller picture or video"
        else:
            why, remedy = "cannot be decoded", "write or record it anew"
        raise BrokenFrame(f"{what}: {why}", remedy) from None


@attrs.frozen
class SourceInfo:
    """What a source turned out to be after opening. width_px, height_px: its own size. rate_hz is what it will deliver; live: a
    device, not a recording.
    """

    name: str
    width_px: int
    height_px: int
    rate_hz: float
    live: bool
    jpeg: bool = False  # its frames come as JPEGs, each with its `Frame.packet`
    notes: tuple[str, ...] = ()  # what a person should know once: scaled frames, another rate than asked, ...


@attrs.frozen
class Frame:
    """Stamps of a frame that `read` wrote. t_sensor_ns: kernel stamp, or the scheduled time of a file.

    t_read_ns: when the frame left the driver or, of a recording that is played without a pace, the disk; 0 for any other
    recording, whose frame is due at t_sensor_ns and not before. packet: the JPEG that it was decoded from, uint8 (n,), where it
    came as one of the source's own size.
    """

    source_seq: int
    t_sensor_ns: int
    t_read_ns: int
    packet: NDArray[np.uint8] | None = attrs.field(default=None, eq=False, repr=False)


class Source(Protocol):
    """One picture after the other. Errors of the device or the file are UserError."""

    @property
    def info(self) -> SourceInfo: ...

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """Decodes the next frame into out, uint8 (height, width, 3) BGR, scaling where sizes differ; None at the end.

        May block for the next frame of a device, 1 s at most (then raises TimeoutError); never sleeps for a recording. Raises
        BrokenFrame for a frame of a recording that cannot be decoded; it has a number, which is then missing.
        """
        ...

    def close(self) -> None: ...
