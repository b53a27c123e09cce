"""How a silent process spends its time: computing, moving data, waiting for a CPU or a disk, or idle."""

import attrs

from lfpipe.host.sample import Sample, Thread

WORKS_SHARE = 0.05  # share of CPU time; a thread that only polls a timer needs less


@attrs.define
class TimeSpent:
    """Time of a process in ns, by activity, since its last sign of life. Time in which it was ready to run but had no CPU is not
    counted, because its activity is unknown.

    able: not blocked by a disk or a CPU. Parts of it: stopped, by a signal or a debugger; worked, on a CPU; idle, doing
    nothing. stalled: waiting for a disk since the last byte arrived. waited: idle or stalled, since it last worked and the last
    byte arrived. unmoved: total without a byte.
    """

    able: int = 0
    stopped: int = 0
    worked: int = 0
    idle: int = 0
    stalled: int = 0
    waited: int = 0
    unmoved: int = 0

    def add(self, before: Sample, now: Sample, dt_ns: int) -> None:
        """Adds the time between two samples."""
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
    """The part of dt_ns in which a thread waited for a CPU. The kernel counts a wait only at its end, so a lasting wait shows no
    change."""
    queued_ns = now.queued_ns - then.queued_ns
    return dt_ns if now.state == "R" and not queued_ns and now.cpu_ns == then.cpu_ns else min(max(0, queued_ns), dt_ns)
