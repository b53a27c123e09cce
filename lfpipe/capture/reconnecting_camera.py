"""A camera that may be unplugged, stall and come back: whoever reads it waits with a limit, never in the driver's hands.

All that touches the device runs in a thread, one for each connection, for a dead one may block in any call: to open it, to wait
for a frame, even to close it. A connection that ends is followed by another, first after BACKOFF_S, then after twice as long
each time, up to MAX_BACKOFF_S.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.source import Frame, Source, SourceInfo, decoding
from lfpipe.errors import UserError

WAIT_S = 0.1  # the longest that `read` keeps its caller
STALL_S = 1.0  # a camera without a frame for so long is lost; the slowest one there may be gives 1 Hz
BACKOFF_S, MAX_BACKOFF_S = 0.5, 5.0
FIRST_S = 8.0  # how long the constructor waits for the first connection
HUNG_S = 15.0  # a driver that keeps us longer than this is left by ending the process; five times that is more than a minute


class CameraLost(TimeoutError):
    """Raised once when frames stop, with the reason; what follows are TimeoutErrors until a frame comes again."""


class _Connection:
    """Opens a camera, reads a frame whenever one is asked for, and closes the camera at the first failure, all in its thread."""

    def __init__(self, open_: Callable[[], Source]) -> None:
        self._open = open_
        self._slots: queue.SimpleQueue[NDArray[np.uint8] | None] = queue.SimpleQueue()
        self._told: queue.SimpleQueue[Frame | Exception] = queue.SimpleQueue()
        self._asked = False
        self.info: SourceInfo | None = None  # of the camera, once it is open
        self.settled = threading.Event()  # it is open, or could not be opened
        self.since_ns = time.monotonic_ns()  # when what is under way in the thread began
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()

    def frame(self, out: NDArray[np.uint8], wait_s: float) -> Frame | None:
        """The next frame, in out, which belongs to the thread until it has come; None where it has not after wait_s.

        Raises what ended the connection; out is the caller's again.
        """
        if not self._asked:
            self._asked, self.since_ns = True, time.monotonic_ns()
            self._slots.put(out)
        try:
            told = self._told.get(timeout=wait_s)
        except queue.Empty:
            return None
        self._asked = False
        if isinstance(told, Exception):
            raise told
        return told

    def end(self, wait_s: float) -> None:
        """Has the camera closed, where its driver lets us."""
        self._slots.put(None)
        self._thread.join(wait_s)

    def _run(self) -> None:
        try:
            with decoding("camera"):
                source = self._open()
        except Exception as error:  # it belongs to whoever waits for a frame, whatever it is
            self._told.put(error)
            self.settled.set()
            return
        self.info = source.info
        self.settled.set()
        failure: Exception | None = None
        while failure is None and (out := self._slots.get()) is not None:
            try:
                with decoding(source.info.name):
                    frame = source.read(out)
                assert frame is not None, "a camera has no end"
                self._told.put(frame)
            except Exception as error:
                failure = error
        source.close()  # before it is told, so that the next connection does not find the camera busy
        if failure is not None:
            self._told.put(failure)


class ReconnectingCamera:
    """A source without an end. source_seq counts on over all connections; info is of the last one that gave a frame."""

    def __init__(self, info: SourceInfo, open_: Callable[[], Source]) -> None:
        """info: what is taken to hold until the camera says otherwise. open_: opens it, raises UserError where it cannot.

        Returns when the camera is open, or could not be opened, or after FIRST_S.
        """
        self.info, self._open = info, open_
        self._seq = self._first_seq = 0  # of the next frame; of the first one of this connection
        self._lost = False
        self._backoff_s, self._next_ns = BACKOFF_S, 0
        self._connection: _Connection | None = _Connection(open_)
        self._connection.settled.wait(FIRST_S)
        self.info = self._connection.info or info
        self._fresh_ns = time.monotonic_ns()  # when the last frame came

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `Source.read`; waits WAIT_S at the most. out must be the same array until a frame has come.

        Raises CameraLost or TimeoutError where none has, UserError where the driver keeps us for HUNG_S.
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
            raise self._without(getattr(error, "message", str(error))) from None
        if frame is None:
            if t_ns - connection.since_ns > HUNG_S * 1e9:
                raise UserError(f"{self.info.name}: its driver has not answered for {HUNG_S:g} s", "plug it out and in again")
            silent_s = (t_ns - self._fresh_ns) / 1e9
            raise self._without(f"{self.info.name}: no frame for {silent_s:.1f} s") if silent_s > STALL_S else TimeoutError
        self.info = connection.info or self.info
        self._lost, self._fresh_ns, self._backoff_s = False, time.monotonic_ns(), BACKOFF_S
        self._seq = self._first_seq + frame.source_seq + 1
        return attrs.evolve(frame, source_seq=self._seq - 1)

    def _without(self, why: str) -> TimeoutError:
        """The error to raise where no frame can be had; the first time it is the one that says so."""
        first, self._lost = not self._lost, True
        return CameraLost(why) if first else TimeoutError(why)

    def close(self) -> None:
        if self._connection is not None:
            self._connection.end(WAIT_S)
