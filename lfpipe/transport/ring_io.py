"""A stage, its input at its start, and its ends of rings: wake-ups, the count of missed slots,
and credit in lossless sessions.

Credit: in lossless sessions, a reader reports in its status row how far it has read a ring, and the
writer waits for it.
"""

from collections.abc import Callable, Sequence
from typing import Any

import attrs
from numpy.typing import NDArray

from lfpipe.config import Config, SessionOptions
from lfpipe.config.modes import Lossless
from lfpipe.host.wake import Wake
from lfpipe.transport import ring, status
from lfpipe.transport.metrics import NO_METRICS, MetricSet
from lfpipe.transport.session import Session
from lfpipe.transport.status import ENDED


@attrs.frozen(kw_only=True)
class Stage:
    """A row of the process table, also for the entry points of the group `lfpipe.stages`."""

    name: str
    module: str
    """Contains `main(context)`."""
    needed: Callable[[SessionOptions], bool]
    """Whether a session with these options runs it."""
    reads: tuple[str, ...] = ()
    """Rings."""
    writes: tuple[str, ...] = ()
    """Rings."""
    asks_for: Callable[[SessionOptions], tuple[str, ...]] = lambda _: ()
    """The on-demand rings that it reads and needs with these options."""
    metrics: MetricSet = NO_METRICS
    """Declared in its own package."""
    optional: bool = False
    """Whether few sessions run it, and no picture waits for it."""
    restart_on_viewer_change: bool = False
    """Whether it starts again for another viewer."""
    own_core: bool = False
    """Whether it avoids the first of two cores."""


@attrs.frozen(kw_only=True)
class StageSpec:
    """Everything that a stage's process receives at its start."""

    name: str
    module: str
    """Contains `main(context)`."""
    session: Session
    config: Config
    rev: int
    """Of the session's state."""
    options: SessionOptions
    consumers: dict[str, list[str]]
    """Ring -> stages that read it."""
    others: tuple[str, ...]
    """The other stages of the session."""
    source: str
    """The stage that makes frames."""
    cpus: tuple[int, ...] = ()
    """Cores to run on; empty: all."""
    request: int = 0
    """The number of the request that it answers once it can do its work; 0: of none."""

    def ring_index(self, name: str) -> int:
        """The index of a ring's credit in a status row."""
        return list(self.consumers).index(name)


class RingInput:
    """The reading end of a ring with its wake-up. row: the stage's own status row."""

    def __init__(self, spec: StageSpec, name: str, row: status.Row) -> None:
        session = spec.session
        clock = spec.options.clock
        self._row = row
        self.reader = ring.Reader(session.segment(name))
        self.wake = Wake(session.wake(name, spec.name))
        self._credit: Wake | None = None
        self._lock_step = False
        if isinstance(clock, Lossless):
            self._credit = Wake(session.credit(name, spec.name))
            self._lock_step = clock.lock_step
        self._index = spec.ring_index(name)
        self._taken = row.record["taken_seq"].data
        taken = int(self._taken[self._index])
        if self._credit or taken:  # a predecessor died: count its unread slots, and later ones
            self.reader.last_seq = min(self.reader.last_seq, taken)

    def take(self, out: NDArray[Any], in_order: bool = False) -> ring.Stamp | None:
        """Copies the newest slot to out, if there is a new one; on request or in lossless sessions,
        the next in order. Skipped slots count as drops.
        """
        self.wake.drain()
        stamp = self.reader.read_next(out) if in_order or self._credit else self.reader.read(out)
        if stamp is not None:
            self._on_read(stamp)
        return stamp

    def peek(self, in_order: bool = False) -> tuple[ring.Stamp, NDArray[Any]] | None:
        """Like `take`, but returns the slot itself, read-only. Results made from it are valid only
        if `still_valid` confirms it.
        """
        self.wake.drain()
        peeked = self.reader.peek(in_order or self._credit is not None)
        if peeked is not None:
            self._on_read(peeked[0])
        return peeked

    def still_valid(self, stamp: ring.Stamp) -> bool:
        """Whether the writer has not touched a peeked slot; if it has, the slot counts as a
        drop.
        """
        valid = self.reader.still_valid(stamp)
        self._row["drops"] += not valid
        return valid

    def _on_read(self, stamp: ring.Stamp) -> None:
        if self._credit and self.reader.published > stamp.seq:
            # another slot is waiting, but its wake-up has just been consumed
            self.wake.notify(stamp.seq)
        self._row["drops"] += stamp.skipped
        if self._credit is None:
            self._taken[self._index] = stamp.seq - 1  # they have already been counted
        elif not self._lock_step:
            self.give_credit()

    def done(self) -> None:
        """Reports that everything taken has been processed.

        If this process dies, its successor counts later slots as dropped.
        """
        if self._credit is None:
            self._taken[self._index] = self.reader.last_seq

    def wait(self) -> None:
        """Reports that the stage waits: in lock-step, everything taken has been processed."""
        if self._lock_step:
            self.give_credit()

    def give_credit(self) -> None:
        """Reports to the writer that the slots taken so far may be overwritten; in lock-step, that
        they have been processed.
        """
        if self._credit is not None and self._taken[self._index] != self.reader.last_seq:
            self._taken[self._index] = self.reader.last_seq
            self._credit.notify(self.reader.last_seq)


class RingOutput:
    """The writing end of a ring with the wake-ups of its readers.

    table: the status table. wait_for: waits until a condition holds, woken by credits. done:
    reports that the stage has processed what it took.
    """

    def __init__(
        self,
        spec: StageSpec,
        name: str,
        table: status.Table,
        wait_for: Callable[[Callable[[], bool], Sequence[Wake]], None],
        done: Callable[[], None],
    ) -> None:
        session = spec.session
        clock = spec.options.clock
        self._wait_for = wait_for
        self._done = done
        self._index = spec.ring_index(name)
        self.writer = ring.Writer(session.segment(name))
        readers = spec.consumers.get(name, [])
        # with the state of each reader: one that does not run leaves its FIFO full
        self._wakes = [
            (Wake(session.wake(name, reader)), table.rows[reader]["state"].reshape(1).data)
            for reader in readers
        ]
        self._lock_step = False
        self._rows: list[NDArray[Any]] = []
        self.credits: list[Wake] = []
        if isinstance(clock, Lossless):
            self._lock_step = clock.lock_step
            # number of slots that readers may be behind
            self._ahead = 0 if clock.lock_step else max(0, self.writer.slots - 4)
            self._rows = [table.rows[reader] for reader in readers]
            self.credits = [Wake(session.credit(name, reader)) for reader in readers]

    def begin(self) -> NDArray[Any]:
        """The slot to fill, in place."""
        return self.writer.begin()

    def publish(
        self,
        source_seq: int,
        t_sensor_ns: int,
        t_read_ns: int,
        epoch: int | None = None,
        kind: int = 0,
    ) -> int:
        """Publishes the slot of `begin` and wakes the readers. In lossless sessions, it first waits
        until they are at most a few slots behind. In lock-step, it then waits until they have
        processed this one.
        """
        if self._rows:
            self._wait_for(self._all_taken, self.credits)
        seq = self.writer.publish(source_seq, t_sensor_ns, t_read_ns, epoch, kind)
        # at once: if the process is killed before this line, the new slot counts as lost
        self._done()
        for wake, state in self._wakes:
            if state[0] not in ENDED:
                wake.notify(seq)
        if self._lock_step:
            self._wait_for(self._all_taken, self.credits)
        return seq

    def _all_taken(self) -> bool:
        for credit in self.credits:
            credit.drain()
        needed = self.writer.published - self._ahead
        return all(
            int(row["taken_seq"][self._index]) >= needed or int(row["state"]) in ENDED
            for row in self._rows
        )

    def close(self) -> None:
        """Ends writing: another stage may write the ring from now on."""
        self.writer.close()
        for wake in (*self.credits, *(one for one, _ in self._wakes)):
            wake.close()
