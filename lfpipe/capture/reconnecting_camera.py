"""A camera that may be unplugged, stall and return: readers wait with a limit and never block in
the driver.

One thread makes all calls of the camera, because a dead device may block any of them: open, read,
even close. After a failure it opens the camera again: after BACKOFF_S, then after twice as long
each time, up to MAX_BACKOFF_S.
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
# a camera without a frame for the longer of these is lost; longer than `camera` waits
STALL_S, STALL_PERIODS = 1.0, 3.5
BACKOFF_S, MAX_BACKOFF_S = 0.5, 5.0
FIRST_S = 8.0  # longest wait of the constructor until the camera is open
# a driver call longer than this ends the process; five restarts take more than a minute
HUNG_S = 15.0


class CameraLost(TimeoutError):
    """Raised once when frames stop, with the reason; TimeoutErrors follow until the next frame."""


class ReconnectingCamera:
    """An endless source.

    source_seq continues over all connections; info: of the camera as it was opened last.
    """

    def __init__(self, info: SourceInfo, open_: Callable[[], FrameSource]) -> None:
        """info: assumed until the camera is open. open_: opens it, or raises UserError.

        Returns when the camera is open or failed to open, after at most FIRST_S.
        """
        self.info = info
        self._open = open_
        # where to write the next frame
        self._requests: queue.SimpleQueue[NDArray[np.uint8] | None] = queue.SimpleQueue()
        # one for each request
        self._answers: queue.SimpleQueue[Frame | Exception] = queue.SimpleQueue()
        self._requested = self._lost = False
        self._opened = threading.Event()
        self._ended = threading.Event()
        # start of the thread's present call; 0: it makes none
        self._called_ns = time.monotonic_ns()
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()
        self._opened.wait(FIRST_S)
        # when the last frame came, and the present one was asked for
        self._fresh_ns = self._asked_ns = time.monotonic_ns()

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `FrameSource.read`; waits at most WAIT_S. out belongs to the thread until a frame has
        come: pass the same again.

        Raises CameraLost or TimeoutError without a frame, UserError if the driver blocks for
        HUNG_S.
        """
        if not self._requested:
            self._requested = True
            self._asked_ns = time.monotonic_ns()
            self._requests.put(out)
        try:
            answer = self._answers.get(timeout=WAIT_S)
        except queue.Empty:
            t_ns = time.monotonic_ns()
            called_ns = self._called_ns
            if called_ns and t_ns - called_ns > HUNG_S * 1e9:
                why = f"{self.info.name}: its driver has not answered for {HUNG_S:g} s"
                raise UserError(why, "unplug the camera and plug it in again") from None
            # a session that works less asks for fewer frames
            silent_s = (t_ns - max(self._fresh_ns, self._asked_ns)) / 1e9
            if silent_s <= max(STALL_S, STALL_PERIODS / self.info.rate_hz):
                raise TimeoutError from None
            raise self._no_frame(f"{self.info.name}: no frame for {silent_s:.1f} s") from None
        self._requested = False
        if isinstance(answer, UserError | TimeoutError):
            raise self._no_frame(getattr(answer, "message", str(answer)))
        if isinstance(answer, Exception):
            raise answer
        self._lost = False
        self._fresh_ns = time.monotonic_ns()
        return answer

    def _no_frame(self, why: str) -> TimeoutError:
        """The error to raise without a frame: CameraLost the first time."""
        first = not self._lost
        self._lost = True
        return CameraLost(why) if first else TimeoutError(why)

    def _run(self) -> None:
        backoff_s = BACKOFF_S
        next_seq = 0
        while not self._ended.is_set():
            source: FrameSource | None = None
            out: NDArray[np.uint8] | None = None
            self._called_ns = time.monotonic_ns()
            try:
                source = self._open()
                first_seq = next_seq
                self.info = source.info
                self._opened.set()
                while (out := self._requested_next()) is not None:
                    frame = source.read(out)
                    assert frame is not None, "a camera never ends"
                    next_seq = first_seq + frame.source_seq + 1
                    backoff_s = BACKOFF_S
                    self._answers.put(attrs.evolve(frame, source_seq=next_seq - 1))
                failure: Exception | None = None
            except (MemoryError, cv2.error) as error:
                failure = undecodable("camera", error)
            except Exception as error:  # raised by `read`, whatever it is
                failure = error
            if source is not None:
                source.close()  # before reporting
            self._called_ns = 0
            self._opened.set()
            if failure is not None and (out is not None or self._requests.get() is not None):
                self._answers.put(failure)
            self._ended.wait(backoff_s)
            backoff_s = min(2 * backoff_s, MAX_BACKOFF_S)

    def _requested_next(self) -> NDArray[np.uint8] | None:
        """Waits for the next request; None at the end."""
        self._called_ns = 0
        out = self._requests.get()
        self._called_ns = time.monotonic_ns()
        return out

    def close(self) -> None:
        """Closes the camera, unless its driver blocks."""
        self._ended.set()
        self._requests.put(None)
        self._thread.join(WAIT_S)
