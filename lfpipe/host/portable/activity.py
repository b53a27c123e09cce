"""The activity of a process as psutil reports it: time on a CPU, whether it is stopped, bytes if the system counts them."""

from __future__ import annotations

import psutil

from lfpipe.host.sample import Sample, Thread

# never R: the running thread is unknown, and one that runs without computing counts as starved
STATES = {psutil.STATUS_DISK_SLEEP: "D", psutil.STATUS_STOPPED: "T"}


def sample(pid: int) -> Sample | None:
    """A sample of process pid; None if it is gone. All threads have the state of the process."""
    try:
        process = psutil.Process(pid)
        with process.oneshot():
            state = STATES.get(process.status(), "S")
            threads = {each.id: Thread(int((each.user_time + each.system_time) * 1e9), 0, state) for each in process.threads()}
            counts = process.io_counters() if hasattr(process, "io_counters") else None
    except psutil.AccessDenied:
        return Sample({}, 0, 0)
    except (psutil.Error, ValueError):
        return None
    if counts is None:
        return Sample(threads, 0, 0)
    disk = counts.read_bytes + counts.write_bytes
    return Sample(threads, disk, getattr(counts, "read_chars", disk) + getattr(counts, "write_chars", 0))
