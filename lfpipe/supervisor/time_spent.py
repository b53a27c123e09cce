"""Where the time of a silent process goes: it computes, moves data, waits for a CPU or a disk, or does nothing."""

from __future__ import annotations

import attrs

from lfpipe.host.sample import Sample, Thread

WORKS_SHARE = 0.05  # of the time on a CPU: less is what a thread with a timer needs to find that there is nothing to do


@attrs.define
class TimeSpent:
    """Where the time of a process went, in ns, since it last gave a sign of life. Time in which it was ready to run and had no
    CPU is in none of these: nobody can tell what it would have done.

    able: it could have gone on: neither a disk nor a CPU kept it. stopped: part of it, held by a signal or a debugger.
    worked: part of it, on a CPU. idle: part of it, doing nothing. stalled: waiting for a disk, since the last byte came.
    waited: doing nothing or stalled, since it last worked and the last byte came. unmoved: all of it without a byte.
    """

    able: int = 0
    stopped: int = 0
    worked: int = 0
    idle: int = 0
    stalled: int = 0
    waited: int = 0
    unmoved: int = 0

    def add(self, before: Sample, now: Sample, dt_ns: int) -> None:
        """Counts the time from one sample to the next."""
        pairs = [(before.threads.get(tid, Thread()), thread) for tid, thread in now.threads.items()]
        left_ns = dt_ns - min(dt_ns, max((_starved_ns(then, thread, dt_ns) for then, thread in pairs), default=0))
        states = {thread.state for thread in now.threads.values()}
        if states & {"T", "t"}:
            self.stopped += left_ns
        elif now.disk > before.disk:
            self.stalled = self.waited = 0
            return
        elif "D" in states:
            self.stalled += left_ns
            self.waited = 0 if now.bytes > before.bytes else self.waited + left_ns
            self.unmoved += left_ns if now.bytes <= before.bytes else 0
            return
        self.able += left_ns
        if now.bytes > before.bytes:
            self.waited = 0
            return
        self.unmoved += left_ns
        if sum(thread.cpu_ns - then.cpu_ns for then, thread in pairs) >= WORKS_SHARE * dt_ns:
            self.worked += left_ns
            self.waited = 0
        else:
            self.idle += left_ns
            self.waited += left_ns


def _starved_ns(then: Thread, now: Thread, dt_ns: int) -> int:
    """For how much of dt_ns a thread waited for a CPU. The kernel counts a wait at its end: one that lasts shows as no change."""
    queued_ns = now.queued_ns - then.queued_ns
    return dt_ns if now.state == "R" and not queued_ns and now.cpu_ns == then.cpu_ns else min(queued_ns, dt_ns)
