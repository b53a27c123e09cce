"""A camera that may be unplugged, stall and return: readers wait with a limit and never block in the driver.

Each connection makes all its calls in its own thread, because a dead device may block any of them: open, read, even close. After
a connection ends, the next begins after BACKOFF_S, then after twice as long each time, up to MAX_BACKOFF_S.
"""

import queue
import threading
import time
from collections.abc import Callable

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.frame_source import Frame, FrameSource, SourceInfo, undecodable
from lfpipe.errors import UserError

WAIT_S = 0.1  # longest wait of `read`
STALL_S, STALL_PERIODS = 1.0, 3.5  # a camera without a frame for the longer of these is lost; longer than `camera` waits
BACKOFF_S, MAX_BACKOFF_S = 0.5, 5.0
FIRST_S = 8.0  # longest wait of the constructor for the first connection
HUNG_S = 15.0  # a driver call longer than this ends the process; five restarts take more than a minute


class CameraLost(TimeoutError):
    """Raised once when frames stop, with the reason; TimeoutErrors follow until the next frame."""


class _Connection:
    """Opens a camera, reads frames on request and closes the camera at the first failure, all in its thread."""

    def __init__(self, open_: Callable[[], FrameSource]) -> None:
        self._open = open_
        self._slots: queue.SimpleQueue[NDArray[np.uint8] | None] = queue.SimpleQueue()
        self._results: queue.SimpleQueue[Frame | Exception] = queue.SimpleQueue()
        self._requested = False
        self.info: SourceInfo | None = None  # set once the camera is open
        self.opened = threading.Event()  # open, or failed to open
        self.since_ns = time.monotonic_ns()  # start of the thread's present call
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()

    def frame(self, out: NDArray[np.uint8], wait_s: float) -> Frame | None:
        """The next frame, written to out, which belongs to the thread until then; None after wait_s without one.

        Raises the error that ended the connection; out then belongs to the caller again.
        """
        if not self._requested:
            self._requested, self.since_ns = True, time.monotonic_ns()
            self._slots.put(out)
        try:
            result = self._results.get(timeout=wait_s)
        except queue.Empty:
            return None
        self._requested = False
        if isinstance(result, Exception):
            raise result
        return result

    def end(self, wait_s: float) -> None:
        """Closes the camera, unless its driver blocks."""
        self._slots.put(None)
        self._thread.join(wait_s)

    def _run(self) -> None:
        source: FrameSource | None = None
        failure: Exception | None = None
        try:
            source = self._open()
            self.info = source.info
            self.opened.set()
            while (out := self._slots.get()) is not None:
                frame = source.read(out)
                assert frame is not None, "a camera has no end"
                self._results.put(frame)
        except (MemoryError, cv2.error) as error:
            failure = undecodable("camera", error)
        except Exception as error:  # raised by `frame`, whatever it is
            failure = error
        if source is not None:
            source.close()  # before reporting, so that the next connection does not find the camera busy
        if failure is not None:
            self._results.put(failure)
        self.opened.set()


class ReconnectingCamera:
    """An endless source. source_seq continues over all connections; info: of the last connection that delivered a frame."""

    def __init__(self, info: SourceInfo, open_: Callable[[], FrameSource]) -> None:
        """info: assumed until the camera is open. open_: opens it, or raises UserError.

        Returns when the camera is open or failed to open, after at most FIRST_S.
        """
        self.info, self._open = info, open_
        self._seq = self._first_seq = 0  # of the next frame; of this connection's first frame
        self._lost = False
        self._backoff_s, self._next_ns = BACKOFF_S, 0
        self._connection: _Connection | None = _Connection(open_)
        self._connection.opened.wait(FIRST_S)
        self.info = self._connection.info or info
        self._fresh_ns = time.monotonic_ns()  # when the last frame came

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `FrameSource.read`; waits at most WAIT_S. out must be the same array until a frame has come.

        Raises CameraLost or TimeoutError without a frame, UserError if the driver blocks for HUNG_S.
        """
        t_ns = time.monotonic_ns()
        if self._connection is None:
            if t_ns < self._next_ns:
                time.sleep(min((self._next_ns - t_ns) / 1e9, WAIT_S))
                raise TimeoutError
            self._connection, self._first_seq = _Connection(self._open), self._seq
        connection = self._connection
        try:
            frame = connection.frame(out, WAIT_S)
        except (UserError, TimeoutError) as error:
            self._connection = None
            self._next_ns = time.monotonic_ns() + int(self._backoff_s * 1e9)
            self._backoff_s = min(2 * self._backoff_s, MAX_BACKOFF_S)
            raise self._no_frame(getattr(error, "message", str(error))) from None
        if frame is None:
            if t_ns - connection.since_ns > HUNG_S * 1e9:
                why = f"{self.info.name}: its driver has not answered for {HUNG_S:g} s"
                raise UserError(why, "unplug the camera and plug it in again")
            silent_s = (t_ns - self._fresh_ns) / 1e9
            if silent_s <= max(STALL_S, STALL_PERIODS / self.info.rate_hz):
                raise TimeoutError
            raise self._no_frame(f"{self.info.name}: no frame for {silent_s:.1f} s")
        self.info = connection.info or self.info
        self._lost, self._fresh_ns, self._backoff_s = False, time.monotonic_ns(), BACKOFF_S
        self._seq = self._first_seq + frame.source_seq + 1
        return attrs.evolve(frame, source_seq=self._seq - 1)

    def _no_frame(self, why: str) -> TimeoutError:
        """The error to raise without a frame: CameraLost the first time."""
        first, self._lost = not self._lost, True
        return CameraLost(why) if first else TimeoutError(why)

    def close(self) -> None:
        if self._connection is not None:
            self._connection.end(WAIT_S)
