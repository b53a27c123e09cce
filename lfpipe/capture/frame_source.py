"""The protocol of camera, file and demo sources, and frames rotated upright for a camera that is
mounted otherwise.
"""

from typing import Protocol

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.files.codecs import BrokenFrame, fit_note
from lfpipe.transport.ring import StampKind

_TURNS = {90: cv2.ROTATE_90_CLOCKWISE, 180: cv2.ROTATE_180, 270: cv2.ROTATE_90_COUNTERCLOCKWISE}


def undecodable(what: str, error: BrokenFrame | MemoryError | cv2.error) -> BrokenFrame:
    """A decoder's failure or lack of memory as the user's error. what: file or device."""
    if isinstance(error, BrokenFrame):
        return error
    if isinstance(error, MemoryError) or error.code == -4:  # cv::Error::StsNoMem
        return BrokenFrame(
            f"{what}: decoding needs more memory than allowed or available",
            "use a smaller picture or video",
        )
    return BrokenFrame(f"{what}: cannot be decoded", "save or record it again")


@attrs.frozen
class SourceInfo:
    """Properties of an open source."""

    name: str
    size_px: tuple[int, int]
    """(width, height) of its own frames."""
    rate_hz: float
    """What it delivers."""
    live: bool
    """A device, not a recording."""
    jpeg: bool = False  # its frames are JPEGs, each with its `Frame.packet`
    eyes: str = ""  # folder of the recording, if it holds the eyes of the mouse instead of frames
    # to show the user once: scaled frames, another rate than requested, ...
    notes: tuple[str, ...] = ()


@attrs.frozen
class Frame:
    """Stamps of a frame that `read` wrote."""

    source_seq: int
    t_sensor_ns: int
    """Middle of the exposure, or the scheduled time of a file."""
    t_read_ns: int
    """When the frame left the driver or, for a recording played without a pace, the disk; 0 for any
    other recording, whose frame is due at t_sensor_ns and not before."""
    packet: NDArray[np.uint8] | None = attrs.field(default=None, eq=False, repr=False)
    """The JPEG it was decoded from, uint8 (n,), if it has the source's own size."""
    stamp: StampKind = StampKind.SCHEDULED
    """What t_sensor_ns was derived from."""
    offset_ns: int = 0
    """Of cameras in a row: between their first and their last frame of this picture."""


class FrameSource(Protocol):
    """A series of frames. Errors of the device or the file are UserError."""

    @property
    def info(self) -> SourceInfo: ...

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """Decodes the next frame into out, uint8 (height, width, 3) BGR, scaling if sizes differ;
        returns None at the end.

        May block for the next frame of a device, 1 s at most (then raises TimeoutError); never
        sleeps for a recording. Raises BrokenFrame for a frame of a recording that cannot be
        decoded; its number is then missing.
        """

    def close(self) -> None: ...


class OrientedSource:
    """Another source's frames, rotated clockwise by camera.rotate degrees, then mirrored if
    camera.mirror is set.

    It passes on no JPEGs, because those are not rotated; recordings are therefore upright.
    """

    def __init__(self, source: FrameSource, camera: config.Camera) -> None:
        self._source = source
        self._camera = camera
        self._unturned = np.empty((camera.height_px, camera.width_px, 3), np.uint8)

    @property
    def info(self) -> SourceInfo:
        """Info of the other source, with the rotated size."""
        inner = attrs.evolve(self._source.info, jpeg=False)
        if self._camera.rotate % 180 == 0:
            return inner
        return attrs.evolve(inner, size_px=inner.size_px[::-1])

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `FrameSource.read`."""
        frame = self._source.read(self._unturned)
        if frame is None:
            return None
        rotate = self._camera.rotate
        picture = cv2.rotate(self._unturned, _TURNS[rotate]) if rotate else self._unturned
        np.copyto(out, picture[:, ::-1] if self._camera.mirror else picture)
        return attrs.evolve(frame, packet=None)

    def close(self) -> None:
        self._source.close()


def size_notes(size_px: tuple[int, int], camera: config.Camera) -> list[str]:
    """Describes how frames of that size become those of the configuration; empty if they
    have its size.
    """
    slot_px = (camera.width_px, camera.height_px)
    return [] if size_px == slot_px else [fit_note(size_px, slot_px)]


def as_read(pictures: NDArray[np.uint8], camera: config.Camera) -> NDArray[np.uint8]:
    """Upright pictures, (n, height, width), in the sensor's order of readout: row by row from the
    first.
    """
    unmirrored = pictures[:, :, ::-1] if camera.mirror else pictures
    return np.rot90(unmirrored, camera.rotate // 90, axes=(1, 2))


STALL_S, STALL_PERIODS = 0.9, 3  # longest wait for a frame of a camera: whichever is longer


def stall_s(rate_hz: float) -> float:
    """How long a camera may deliver no frame until it counts as lost."""
    return max(STALL_S, STALL_PERIODS / rate_hz)
