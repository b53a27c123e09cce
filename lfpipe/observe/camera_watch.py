"""Reads a camera in parallel with the window: small grey pictures with stamps, and the newest picture for display."""

import threading

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.frame_source import BrokenFrame, FrameSource
from lfpipe.errors import UserError
from lfpipe.transport.stamp_kind import StampKind

SMALL_PX, INSET_PX = 64, 240  # widths
MOST_UNSTAMPED, UNSTAMPED_SHARE = 5, 0.1


class CameraWatch(threading.Thread):
    """Runs in its own thread. inset: the newest picture. failure: why it ended."""

    def __init__(self, source: FrameSource, frame_px: tuple[int, int]) -> None:
        super().__init__(daemon=True)
        self._source, self._lock, self._ended = source, threading.Lock(), threading.Event()
        self._frame = np.empty((frame_px[1], frame_px[0], 3), np.uint8)
        self._frames: list[tuple[int, NDArray[np.uint8]]] = []
        self.inset: NDArray[np.uint8] | None = None
        self._unstamped = 0
        self.failure: UserError | None = None

    def run(self) -> None:
        height, width = self._frame.shape[:2]
        small_px, inset_px = (SMALL_PX, SMALL_PX * height // width), (INSET_PX, INSET_PX * height // width)
        while not self._ended.is_set():
            try:
                frame = self._source.read(self._frame)
            except (TimeoutError, BrokenFrame):
                continue
            except UserError as error:
                self.failure = error
                return
            if frame is None:
                self.failure = UserError("the source ended", "use a camera: a recording does not see this screen")
                return
            if frame.stamp in (StampKind.SCHEDULED, StampKind.READ):
                self._unstamped += 1
                continue
            small = cv2.cvtColor(cv2.resize(self._frame, small_px, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY)
            inset = cv2.resize(self._frame, inset_px, interpolation=cv2.INTER_AREA)
            with self._lock:
                self._frames.append((frame.t_sensor_ns, np.asarray(small, np.uint8)))
                self.inset = np.asarray(inset, np.uint8)

    @property
    def stamped(self) -> bool:
        """Whether the driver stamps the frames: nearly all; single frames without a stamp are left out."""
        return self._unstamped < MOST_UNSTAMPED or self._unstamped < len(self._frames) * UNSTAMPED_SHARE

    def frames(self, since_ns: int) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
        """Stamps (n,) and pictures (n, height, width) from since_ns on."""
        with self._lock:
            kept = [each for each in self._frames if each[0] >= since_ns]
        pictures = np.stack([picture for _, picture in kept]) if kept else np.empty((0, 1, 1), np.uint8)
        return np.array([t_ns for t_ns, _ in kept], np.int64), pictures

    def close(self) -> None:
        self._ended.set()
        self.join()
        self._source.close()
