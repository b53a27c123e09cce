"""A ring of slots in shared memory: one writer, any number of readers, latest wins, no waiting.

    page 0   0  magic "LFRING1\\0"
             8  slots | slot stride | payload bytes | description bytes
           128  published: number of slots ever published, alone on its cache line
           192  epoch: 0 for the ring's first writer; one more for each later writer,
                and for each gap that a writer reports
           256  description: JSON of shape and dtype, so that a reader needs no configuration
    slot i   0  seq | source_seq | epoch | t_sensor_ns | t_read_ns | t_publish_ns | kind | 0
                (8 x int64)
            64  payload
             :  up to the stride, a multiple of 4096

    published = p        slot (p-1) % N is the newest; the writer may be filling slot p % N.
    slot.seq = 0         is being filled, or was left incomplete by a dead writer; it is never read.
    slot.seq = s         contains the s-th slot ever published, s = 1, 2, ...

Write
  1. seq = 0, in slot p % N; fence
  2. payload, stamps, seq = p + 1; fence
  3. published = p + 1

Read
  1. Note p = published; fence.
  2. Copy slot (p-1) % N, which contains number p; fence.
  3. Note q = published again. The writer may now be filling slot q % N, which contained number q -
     N + 1.
  4. The copy is valid if q - p <= N - 2. Otherwise it may be torn: start again.

An in-order reader reads number n, the one after its last, by the same rule with n instead of p; or
the oldest safe one. A killed writer has published only complete slots, and the next writer
continues from the same counter. Slots that a slow reader missed are counted.

Stamps are of one clock for every process: CLOCK_MONOTONIC as int64 nanoseconds. Subtract first,
then convert to float seconds.
"""

import enum
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.eyes import MAX_STEP_NS
from lfpipe.host.files import PAGE as PAGE
from lfpipe.host.files import Segment, create_segment, publish_segment
from lfpipe.host.worker import asleep_ns, fence

# of the machine, not of the process: stamps of different processes are comparable
now_ns = time.monotonic_ns
SECOND_NS = 1_000_000_000
MS_NS = 1_000_000
POLL_S = 0.001  # between two looks at a ring whose writer wakes nobody


def sleep_until(t_ns: int) -> None:
    """Sleeps until an absolute time; returns at once if it has passed."""
    wait_ns = t_ns - now_ns()
    if wait_ns > 0:
        time.sleep(wait_ns / 1e9)


class SleepWatch:
    """Detects that the machine was suspended. asleep: a function like `asleep_ns`."""

    def __init__(self, asleep: Callable[[], int] = asleep_ns) -> None:
        self._asleep = asleep
        self._known_ns = asleep()

    def woke(self) -> bool:
        """Whether the machine was suspended for at least MAX_STEP_NS, the gap after which filters
        are reset, since the last call that returned True.
        """
        slept_ns = self._asleep()
        if slept_ns - self._known_ns < MAX_STEP_NS:
            return False
        self._known_ns = slept_ns
        return True


class Ticker:
    """Absolute deadlines t0 + k * period without drift. Missed deadlines are skipped."""

    def __init__(self, rate_hz: float, t0_ns: int) -> None:
        self._rate_hz = rate_hz
        self._t0_ns = t0_ns
        self._k = 0

    def due_ns(self) -> int:
        """The next deadline."""
        return self._t0_ns + int(self._k * 1e9 / self._rate_hz)

    def advance(self, t_ns: int) -> None:
        """Advances to the first later deadline that is not yet past at t_ns."""
        self._k = max(self._k, int((t_ns - self._t0_ns) * self._rate_hz / 1e9)) + 1


MAGIC = b"LFRING1\0"
# offsets in the header: a cache line for each writer's field
PUBLISHED, EPOCH, DESCRIPTION = 128, 192, 256
SLOT_HEADER = 64  # a cache line


@attrs.frozen
class RingSpec:
    """Shape and type of a slot.

    slots >= 3: a reader then has the period of at least one slot for its copy.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    slots: int = 4

    @property
    def payload_bytes(self) -> int:
        return int(np.prod(self.shape, dtype=np.int64)) * self.dtype.itemsize

    @property
    def stride(self) -> int:
        return (SLOT_HEADER + self.payload_bytes + PAGE - 1) // PAGE * PAGE

    @property
    def size_bytes(self) -> int:
        return PAGE + self.slots * self.stride


class StampKind(enum.IntEnum):
    """The source of a frame's sensor stamp, as in a ring's slot; `word` is its trace name."""

    SCHEDULED = 0  # a recording's or the demo's scheduled time
    READ = 1  # no usable stamp: the time when the frame was read
    END_OF_FRAME = 2
    START_OF_EXPOSURE = 3
    # uvcvideo: the first packet of the frame, which follows the exposure of the first row
    START_OF_TRANSFER = 4

    @property
    def word(self) -> str:
        return self.name.lower().replace("_", " ")


@attrs.frozen
class Stamp:
    """Header of a slot as read. Times are ns of CLOCK_MONOTONIC."""

    seq: int
    """Number of the slot since the ring was made, from 1."""
    source_seq: int
    """Number of the frame, from the camera or file."""
    epoch: int
    """Of the frame: do not compare numbers or times across epochs."""
    t_sensor_ns: int
    """Middle of the exposure."""
    t_read_ns: int
    """When the frame was read."""
    t_publish_ns: int
    """When the slot was published."""
    skipped: int
    """Number of slots since the last read that this reader missed."""
    kind: int = 0
    """Source of t_sensor_ns, see `StampKind`."""


def create(path: Path, spec: RingSpec) -> Segment:
    """Creates an empty ring; the caller keeps the segment and unlinks it. Raises UserError like
    `create_segment`.
    """
    description = json.dumps(
        {"shape": spec.shape, "dtype": np.lib.format.dtype_to_descr(spec.dtype)}
    ).encode()
    fence()  # fails on a machine without fences here, before the first process starts
    memory = create_segment(path, spec.size_bytes)
    buffer = memory.buf
    np.frombuffer(buffer, "<i8", 4, 8)[:] = (
        spec.slots,
        spec.stride,
        spec.payload_bytes,
        len(description),
    )
    buffer[DESCRIPTION : DESCRIPTION + len(description)] = description
    np.frombuffer(buffer, "<i8", 1, EPOCH)[0] = -1  # so that the first writer's epoch is 0
    buffer[: len(MAGIC)] = MAGIC
    publish_segment(memory, path)  # last: a reader that finds it finds all
    return memory


class _Ring:
    """Views of the segment, for both sides; `close` drops them before the segment."""

    def __init__(self, path: Path, writable: bool) -> None:
        self._memory = Segment(path)
        self._memory.check(MAGIC, "ring", PAGE)
        buffer = self._memory.buf if writable else self._memory.buf.toreadonly()
        self.slots, stride, _, length = (int(v) for v in np.frombuffer(buffer, "<i8", 4, 8))
        described = json.loads(bytes(buffer[DESCRIPTION : DESCRIPTION + length]))
        self.shape: tuple[int, ...] = tuple(described["shape"])
        self.dtype = np.lib.format.descr_to_dtype(described["dtype"])
        count = int(np.prod(self.shape, dtype=np.int64))
        starts = [PAGE + i * stride for i in range(self.slots)]
        self._published: NDArray[np.int64] = np.frombuffer(buffer, "<i8", 1, PUBLISHED)
        self._epoch: NDArray[np.int64] = np.frombuffer(buffer, "<i8", 1, EPOCH)
        self._heads: list[NDArray[np.int64]] = [np.frombuffer(buffer, "<i8", 8, s) for s in starts]
        self._payloads: list[NDArray[Any]] = [
            np.frombuffer(buffer, self.dtype, count, s + SLOT_HEADER).reshape(self.shape)
            for s in starts
        ]

    def is_at(self, path: Path) -> bool:
        """Whether path still leads to this ring."""
        return self._memory.path == path and self._memory.in_place()

    @property
    def published(self) -> int:
        """Slots ever published."""
        return int(self._published[0])

    @property
    def epoch(self) -> int:
        """Number of the current run: 0 for the first writer, one more for each later writer and
        each `new_epoch`.
        """
        return int(self._epoch[0])

    def close(self) -> None:
        """Drops the views before the mapping, so that no pointers into unmapped memory remain."""
        del self._published, self._epoch
        self._heads.clear()
        self._payloads.clear()
        self._memory.close()


class Writer(_Ring):
    """The one writer. Opening it starts a new epoch."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, writable=True)
        self.new_epoch()

    def new_epoch(self) -> None:
        """Marks a break: readers discard their history."""
        self._epoch[0] += 1

    def begin(self) -> NDArray[Any]:
        """The payload to fill next, in place; it stays invisible until `publish`."""
        i = self.published % self.slots
        self._heads[i][0] = 0
        fence()  # SYNC: the slot is marked unreadable before its first byte changes
        return self._payloads[i]

    def publish(
        self,
        source_seq: int,
        t_sensor_ns: int,
        t_read_ns: int,
        epoch: int | None = None,
        kind: int = 0,
    ) -> int:
        """Makes the slot of the last `begin` the newest; returns its seq.

        epoch, kind: of a forwarded frame.
        """
        p = self.published
        head = self._heads[p % self.slots]
        head[1:7] = (
            source_seq,
            self.epoch if epoch is None else epoch,
            t_sensor_ns,
            t_read_ns,
            now_ns(),
            kind,
        )
        # order relative to stamps and payload does not matter: readers wait for the counter
        head[0] = p + 1
        fence()  # SYNC: the slot is complete before the counter points readers to it
        self._published[0] = p + 1
        return p + 1


class Reader(_Ring):
    """A reader of a ring, in any process. `shape` and `dtype` are those of a slot; the memory is
    read-only.

    Parameters
    ----------
    path : Path
        Its file: `frames.ring` in the directory of the session.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    UserError
        If it is the ring of another version of lfpipe.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, writable=False)
        self.last_seq = self.published

    def read(self, out: NDArray[Any]) -> Stamp | None:
        """Copies the newest slot to out if it is newer than the last read; never a torn copy.

        Parameters
        ----------
        out : numpy.ndarray
            Of the ring's shape and dtype.

        Returns
        -------
        Stamp or None
            None if there is no newer slot.
        """
        return self._read(out, in_order=False)

    def read_next(self, out: NDArray[Any]) -> Stamp | None:
        """Like `read`, but copies the slot after the last one read, or the oldest remaining one if
        the writer was too fast.

        Parameters
        ----------
        out : numpy.ndarray
            Of the ring's shape and dtype.

        Returns
        -------
        Stamp or None
            None if there is no newer slot.
        """
        return self._read(out, in_order=True)

    def peek(self, in_order: bool = False) -> tuple[Stamp, NDArray[Any]] | None:
        """The slot itself instead of a copy, read-only. Results made from it are valid only if
        `still_valid` confirms it afterwards.

        Parameters
        ----------
        in_order : bool
            As `read_next`; otherwise as `read`.

        Returns
        -------
        tuple or None
            (Stamp, numpy.ndarray), or None if there is no newer slot.
        """
        while (n := self._next(in_order)) is not None:
            stamp = self._stamp(n)
            if stamp is not None:
                return stamp, self._payloads[(n - 1) % self.slots]
        return None

    def find(self, t_sensor_ns: int) -> tuple[Stamp, NDArray[Any]] | None:
        """As `peek`, the slot of a sensor stamp, if it still exists.

        Parameters
        ----------
        t_sensor_ns : int

        Returns
        -------
        tuple or None
            (Stamp, numpy.ndarray)
        """
        for head, payload in zip(self._heads, self._payloads, strict=True):
            if int(head[3]) == t_sensor_ns and (stamp := self._stamp(int(head[0]))) is not None:
                return stamp, payload
        return None

    def still_valid(self, stamp: Stamp) -> bool:
        """Whether the writer has not touched a peeked slot since.

        Parameters
        ----------
        stamp : Stamp
            As `peek` returned it.

        Returns
        -------
        bool
        """
        fence()  # SYNC: all reads of the slot come before the counter is read again
        return self.published - stamp.seq <= self.slots - 2

    def _read(self, out: NDArray[Any], in_order: bool) -> Stamp | None:
        while (n := self._next(in_order)) is not None:
            slot = (n - 1) % self.slots
            if self.shape:
                np.copyto(out, self._payloads[slot])
            # one record: copy as bytes, because numpy copies field by field, ten times slower
            else:
                out.reshape(1).view(np.uint8)[:] = self._payloads[slot].reshape(1).view(np.uint8)
            stamp = self._stamp(n)
            if stamp is not None:
                return stamp
        return None

    def _next(self, in_order: bool) -> int | None:
        """Number of the slot to read, None if there is no new one."""
        p = self.published
        if p == self.last_seq:
            return None
        # SYNC: pairs with the writer's last fence: the counter first, then the slot it points to
        fence()
        return max(self.last_seq + 1, p - self.slots + 2) if in_order else p

    def _stamp(self, n: int) -> Stamp | None:
        """Header of slot number n, which becomes the last read; None if the writer may have touched
        it meanwhile.
        """
        seq, source_seq, epoch, t_sensor_ns, t_read_ns, t_publish_ns, kind = self._heads[
            (n - 1) % self.slots
        ][:7].tolist()
        fence()  # SYNC: the copy is complete before the counter is read again
        if self.published - n > self.slots - 2 or seq != n:
            return None
        skipped = n - self.last_seq - 1
        self.last_seq = n
        return Stamp(seq, source_seq, epoch, t_sensor_ns, t_read_ns, t_publish_ns, skipped, kind)
