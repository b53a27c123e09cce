"""The ends of rings as a stage holds them: wake-ups, the count of missed slots, and credit where nothing may be lost.

Credit: with `lossless`, a reader reports in its status row how far it has taken a ring, and the writer waits for that.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from numpy.typing import NDArray

from lfpipe.host.wake import Wake
from lfpipe.transport import ring, status
from lfpipe.transport.stage_spec import StageSpec
from lfpipe.transport.status import ENDED


class RingInput:
    """The reading end of a ring with its wake-up. row: the stage's own status row."""

    def __init__(self, spec: StageSpec, name: str, row: status.Row) -> None:
        session, options, self._row = spec.session, spec.options, row
        self.reader = ring.Reader(session.segment(name))
        self.wake = Wake(session.wake(name, spec.name), reads=True)
        self._credit = Wake(session.credit(name, spec.name)) if options.lossless else None
        self._lock_step = options.lock_step
        self._index = spec.ring_index(name)
        self._taken = row.record["taken_seq"].data
        taken = int(self._taken[self._index])
        if options.lossless or taken:  # a process before this one died: what it left and what came since counts
            self.reader.last_seq = min(self.reader.last_seq, taken)

    def take(self, out: NDArray[Any], in_order: bool = False) -> ring.Stamp | None:
        """Copies the newest slot into out, if there is a new one; the next in order where asked for, or where nothing may be
        lost. Skipped slots count as drops.
        """
        self.wake.drain()
        stamp = self.reader.read_next(out) if in_order or self._credit else self.reader.read(out)
        if stamp is not None:
            self._took(stamp)
        return stamp

    def peek(self, in_order: bool = False) -> tuple[ring.Stamp, NDArray[Any]] | None:
        """As `take`, but the slot itself, read-only. Results made from it count only if it is `still_valid` afterwards."""
        self.wake.drain()
        found = self.reader.peek(in_order or self._credit is not None)
        if found is not None:
            self._took(found[0])
        return found

    def still_valid(self, stamp: ring.Stamp) -> bool:
        """Whether the writer has left a peeked slot alone until now; if not, it counts as a drop."""
        valid = self.reader.still_valid(stamp)
        self._row["drops"] += not valid
        return valid

    def _took(self, stamp: ring.Stamp) -> None:
        if self._credit and self.reader.published > stamp.seq:
            self.wake.notify(stamp.seq)  # another slot waits, and its wake-up has just been drained
        self._row["drops"] += stamp.skipped
        if self._credit is None:
            self._taken[self._index] = stamp.seq - 1  # those are counted
        elif not self._lock_step:
            self.give_credit()

    def skip(self) -> None:
        """Ignores everything published until now, without counting it."""
        self.reader.last_seq = self.reader.published
        self.give_credit()

    def done(self) -> None:
        """Everything taken is dealt with. If this process dies, its successor counts what came after this as dropped."""
        if self._credit is None:
            self._taken[self._index] = self.reader.last_seq

    def give_credit(self) -> None:
        """Tells the writer that the slots taken so far may be overwritten; in lock-step, that they are dealt with."""
        if self._credit is not None and self._taken[self._index] != self.reader.last_seq:
            self._taken[self._index] = self.reader.last_seq
            self._credit.notify(self.reader.last_seq)


class RingOutput:
    """The writing end of a ring with the wake-ups of its readers.

    table: the status table. wait_for: waits until a condition holds, woken by credits. done: what the stage took is dealt with.
    """

    def __init__(
        self,
        spec: StageSpec,
        name: str,
        table: status.Table,
        wait_for: Callable[[Callable[[], bool], Sequence[Wake]], None],
        done: Callable[[], None],
    ) -> None:
        session, options, self._wait_for, self._done = spec.session, spec.options, wait_for, done
        self._index, self._lock_step = spec.ring_index(name), options.lock_step
        self.writer = ring.Writer(session.segment(name))
        self._ahead = 0 if options.lock_step else max(0, self.writer.slots - 4)  # slots that readers need not have taken yet
        readers = spec.consumers.get(name, [])
        self._wakes = [Wake(session.wake(name, reader)) for reader in readers]
        self._rows = [table.rows[reader] for reader in readers] if options.lossless else []
        self.credits = [Wake(session.credit(name, reader), reads=True) for reader in readers] if options.lossless else []

    def begin(self) -> NDArray[Any]:
        """The slot to fill, in place."""
        return self.writer.begin()

    def publish(self, source_seq: int, t_sensor_ns: int, t_read_ns: int, epoch: int | None = None, kind: int = 0) -> int:
        """Publishes the slot of `begin` and wakes the readers. Where nothing may be lost, it first waits until they are at most
        a few slots behind; in lock-step, it then waits until they have dealt with this one.
        """
        if self._rows:
            self._wait_for(self._all_taken, self.credits)
        seq = self.writer.publish(source_seq, t_sensor_ns, t_read_ns, epoch, kind)
        self._done()  # at once: a kill before this line counts as lost what has just been published
        for wake in self._wakes:
            wake.notify(seq)
        if self._lock_step:
            self._wait_for(self._all_taken, self.credits)
        return seq

    def _all_taken(self) -> bool:
        for credit in self.credits:
            credit.drain()
        wanted = self.writer.published - self._ahead
        return all(int(row["taken_seq"][self._index]) >= wanted or int(row["state"]) in ENDED for row in self._rows)
