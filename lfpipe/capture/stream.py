"""A camera in the network, through OpenCV and FFmpeg, which give no usable time stamps: a frame's
time is the time of reading it.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.capture.frame_source import Frame, SourceInfo, size_notes
from lfpipe.errors import UserError, redacted
from lfpipe.files.decoding import fitted
from lfpipe.host.terminal import opencv_logging
from lfpipe.transport.clock import now_ns
from lfpipe.transport.ring import StampKind

OPEN_MS, READ_MS = 8000, 2000  # until an address, or a frame, counts as not there
RATES_HZ = (1.0, 120.0)  # a stream that claims another rate does not know it


class NetworkStream:
    """An open stream; for the methods see `FrameSource`."""

    def __init__(self, address: str, camera: config.Camera) -> None:
        """Raises UserError if nothing is delivered there."""
        self._name = redacted(address)
        limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, OPEN_MS, cv2.CAP_PROP_READ_TIMEOUT_MSEC, READ_MS]
        with opencv_logging():
            self._capture = cv2.VideoCapture(address, cv2.CAP_FFMPEG, limits)
            whole, frame = self._capture.read() if self._capture.isOpened() else (False, None)
        if not whole or frame is None:
            self.close()
            raise UserError(
                f"{self._name}: no video is delivered there",
                "check the address in another player: `ffplay ADDRESS`",
            )
        self._seq = -1
        size_px = frame.shape[1::-1]
        claimed_hz = float(self._capture.get(cv2.CAP_PROP_FPS))
        rate_hz = claimed_hz if RATES_HZ[0] <= claimed_hz <= RATES_HZ[1] else camera.nominal_hz
        notes = ("a network stream has no time stamps: the time of reading is used",)
        self.info = SourceInfo(
            self._name, size_px, rate_hz, live=True, notes=(*notes, *size_notes(size_px, camera))
        )

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `FrameSource.read`. Raises UserError if the stream has ended."""
        whole, frame = self._capture.read()
        if not whole:
            raise UserError(f"{self._name}: delivers no more frames", "check the network")
        t_ns = now_ns()
        self._seq += 1
        fitted(np.asarray(frame, np.uint8), out)
        return Frame(self._seq, t_ns, t_ns, None, StampKind.READ)

    def close(self) -> None:
        """Closes the connection."""
        self._capture.release()
