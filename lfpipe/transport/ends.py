"""The ends of rings as a stage holds them: their wakes, the count of what was missed, credit where nothing may be lost."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from lfpipe.host.wake import Wake
from lfpipe.transport import ring
from lfpipe.transport.status import ENDED

if TYPE_CHECKING:
    from lfpipe.transport.context import Context


class Input:
    """The reading end of a ring with its wake."""

    def __init__(self, context: Context, name: str) -> None:
        session, self._row = context.spec.session, context.row
        self.reader = ring.Reader(session.segment(name))
        self.wake = Wake(session.wake(name, context.spec.name))
        self._credit: Wake | None = None
        self._lock_step = context.spec.options.lock_step
        self._index = context.spec.ring_index(name)
        self._taken = self._row.record["taken_seq"].data
        taken = int(self._taken[self._index])
        if context.spec.options.lossless:
            self._credit = Wake(session.credit(name, context.spec.name))
        if context.spec.options.lossless or taken:  # a process before this one died: what it left and what came since counts
            self.reader.last_seq = min(self.reader.last_seq, taken)

    def take(self, out: NDArray[Any], in_order: bool = False) -> ring.Stamp | None:
        """The newest slot copied into out, when there is a new one; the next in order where that is asked for or nothing may
        be lost. Slots missed count as drops.
        """
        self.wake.drain()
        stamp = self.reader.read_next(out) if in_order or self._credit else self.reader.read(out)
        if stamp is not None:
            self._took(stamp)
        return stamp

    def lend(self, in_order: bool = False) -> tuple[ring.Stamp, NDArray[Any]] | None:
        """As `take`, but the slot itself, read-only; what is made of it counts only if it is still `whole` afterwards."""
        self.wake.drain()
        lent = self.reader.lend(in_order or self._credit is not None)
        if lent is not None:
            self._took(lent[0])
        return lent

    def whole(self, stamp: ring.Stamp) -> bool:
        """Whether a lent slot was left alone until now; if not, it counts as a drop."""
        left_alone = self.reader.whole(stamp)
        self._row["drops"] += not left_alone
        return left_alone

    def _took(self, stamp: ring.Stamp) -> None:
        if self._credit and self.reader.published > stamp.seq:
            self.wake.notify(stamp.seq)  # another one waits, and its wake has just been drained
        self._row["drops"] += stamp.skipped
        if self._credit is None:
            self._taken[self._index] = stamp.seq - 1  # those are counted
        elif not self._lock_step:
            self.give_credit()

    def skip(self) -> None:
        """What was published until now is none of this process's business."""
        self.reader.last_seq = self.reader.published
        self.give_credit()

    def done(self) -> None:
        """All that was taken is dealt with; what this process never deals with after it, its successor counts as dropped."""
        if self._credit is None:
            self._taken[self._index] = self.reader.last_seq

    def give_credit(self) -> None:
        """Tells the writer that what was taken so far needs no more room; in lock-step, that all is done with it."""
        if self._credit is not None and self._taken[self._index] != self.reader.last_seq:
            self._taken[self._index] = self.reader.last_seq
            self._credit.notify(self.reader.last_seq)


class Output:
    """The writing end of a ring with the wakes of its readers."""

    def __init__(self, context: Context, name: str) -> None:
        session, self._context = context.spec.session, context
        self._index = context.spec.ring_index(name)
        self.writer = ring.Writer(session.segment(name))
        # The number of slots that readers need not have taken yet.
        self._ahead = 0 if context.spec.options.lock_step else max(0, self.writer.slots - 4)
        readers = context.spec.consumers.get(name, [])
        self._wakes = [Wake(session.wake(name, reader)) for reader in readers]
        self._rows = [context.table.rows[reader] for reader in readers] if context.spec.options.lossless else []
        self.credits = [Wake(session.credit(name, reader)) for reader in readers] if context.spec.options.lossless else []

    def begin(self) -> NDArray[Any]:
        """The slot to fill, in place."""
        return self.writer.begin()

    def publish(self, source_seq: int, t_sensor_ns: int, t_read_ns: int, epoch: int | None = None) -> int:
        """Publishes the slot of `begin`, wakes the readers. Where nothing may be lost, first waits until they are no more than
        a few slots behind; in lock-step, then until they are done with this one.
        """
        if self._rows:
            self._context.wait_for(self._all_taken, self.credits)
        seq = self.writer.publish(source_seq, t_sensor_ns, t_read_ns, epoch)
        self._context.done()  # at once: a kill before this line counts as lost what has just been published
        for wake in self._wakes:
            wake.notify(seq)
        if self._context.spec.options.lock_step:
            self._context.wait_for(self._all_taken, self.credits)
        return seq

    def _all_taken(self) -> bool:
        for credit in self.credits:
            credit.drain()
        wanted = self.writer.published - self._ahead
        return all(int(row["taken_seq"][self._index]) >= wanted or int(row["state"]) in ENDED for row in self._rows)
