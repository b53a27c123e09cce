"""Writes a recording to disk in a thread of its own, so that a slow disk does not block reading the ring."""

import queue
import threading
from collections.abc import Iterator
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.host.processes import yield_to_others
from lfpipe.sequence.packets import PacketWriter, encoded
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.ring import Stamp

ROOM_BYTES = 128 << 20  # buffer of frames to encode: some seconds, so that a slow disk loses no frame
SLOW_NS = SECOND_NS // 2  # a longer time per frame is reported

Frame = NDArray[np.uint8] | bytes
Work = tuple[Stamp, str, Frame, int]


@attrs.frozen
class Stored:
    """The outcome of a frame. kept: it was recorded; otherwise its time stamp was not after the previous one."""

    stamp: Stamp
    t_taken_ns: int
    t_stored_ns: int
    kept: bool


class Store:
    """Packets are stored unchanged. Pictures are stored as PNG, or raw if more than a quarter of the buffer is in use.

    failure: why storing ended, in words; "" if it has not. checksums, count: valid after `close`.
    """

    def __init__(self, folder: Path, shape: tuple[int, ...]) -> None:
        """Raises OSError if the files cannot be written."""
        self._shape = shape
        self._writer = PacketWriter(folder)
        self._room = max(8, ROOM_BYTES // int(np.prod(shape)))
        self._work: queue.SimpleQueue[Work | None] = queue.SimpleQueue()
        self._done: queue.SimpleQueue[Stored] = queue.SimpleQueue()
        self._spare: list[NDArray[np.uint8]] = []
        self._put = self._taken = 0  # frame counts; each is written by one thread only
        self._last_ns, self._busy_ns, self._hurry = 0, 0, False
        self.failure = ""
        self._thread = threading.Thread(target=self._run, name="store")
        self._thread.start()

    @property
    def count(self) -> int:
        """Number of stored frames."""
        return self._writer.count

    @property
    def full(self) -> bool:
        """Whether the buffer is full."""
        return self._put - self._taken >= self._room

    @property
    def slow(self) -> bool:
        """Whether the disk has blocked the thread for at least SLOW_NS."""
        busy_ns = self._busy_ns
        return bool(busy_ns) and now_ns() - busy_ns > SLOW_NS

    def spare(self) -> NDArray[np.uint8]:
        """An array for a picture. `put` takes ownership of it."""
        return self._spare.pop() if self._spare else np.empty(self._shape, np.uint8)

    def put(self, stamp: Stamp, codec: str, frame: Frame) -> None:
        """frame: a packet of that codec or, for codec "", a picture in an array of `spare`."""
        self._put += 1
        self._work.put((stamp, codec, frame, now_ns()))

    def results(self) -> Iterator[Stored]:
        """The outcomes of frames since the last call."""
        while not self._done.empty():
            yield self._done.get()

    def _run(self) -> None:
        # Yields to threads that wake up for a live picture. A lower priority would be wrong: preempted while it holds the GIL,
        # this thread would block the other one.
        yield_to_others()
        while (work := self._work.get()) is not None:
            self._busy_ns = now_ns()
            try:
                if not self.failure:
                    self._write(work)
            except OSError as error:
                self.failure = str(error.strerror or error)
            except Exception as error:  # the session continues without the recording
                self.failure = f"{type(error).__name__}: {error}".rstrip(": ")
            self._busy_ns = 0
            self._taken += 1
            if not isinstance(work[2], bytes):
                self._spare.append(work[2])

    def _write(self, work: Work) -> None:
        stamp, codec, frame, t_taken_ns = work
        kept = stamp.t_sensor_ns > self._last_ns  # a repeated stamp means a repeated frame, which could not be replayed
        if kept:
            hurry = self._hurry or self._put - self._taken > self._room // 4
            codec, packet = (codec, frame) if isinstance(frame, bytes) else encoded(frame, fast=hurry)
            self._writer.append(packet, codec, stamp.source_seq, stamp.epoch, stamp.t_sensor_ns, stamp.t_read_ns)
            self._last_ns = stamp.t_sensor_ns
        self._done.put(Stored(stamp, t_taken_ns, now_ns(), kept))

    def close(self) -> dict[str, str]:
        """Waits until everything is on disk. The rest is not compressed, so that a session ends quickly.

        Returns the checksums of the files that `PacketWriter` wrote.
        """
        self._hurry = True
        self._work.put(None)
        self._thread.join()
        self._writer.close()
        return self._writer.checksums()
