"""The activity of a process as psutil reports it: CPU time, whether it is stopped, bytes where the system counts them.

No portable call returns how long a process waited for a CPU. While none of its cores is idle, it may be waiting all the time or
not at all: most of that time counts as waiting, so that a busy machine makes a stage slow and not hung.
"""

import time

import psutil

from lfpipe.host.sample import Sample, Thread

# Never R: which of its threads runs is not known, and one that runs without computing counts as starved.
STATES = {psutil.STATUS_DISK_SLEEP: "D", psutil.STATUS_STOPPED: "T"}
CROWDED_SHARE = 0.9  # of the time without an idle core: a real hang on a busy machine is found ten times later
QUEUE = -1  # the thread that stands for the process in the queue
_queues: dict[int, tuple[int, list[int], int]] = {}  # pid -> time and idle time of each core at its last sample, ns in the queue


def _idle_ns() -> list[int]:
    return [int((each.idle + getattr(each, "iowait", 0.0)) * 1e9) for each in psutil.cpu_times(percpu=True)]


def _queued_ns(process: psutil.Process, cpu_ns: int, state: str) -> int:
    """Time so far in which the process may have waited for a CPU, less its time on one. Grows from sample to sample."""
    t_ns, idle_ns = time.monotonic_ns(), _idle_ns()
    then_ns, before_ns, queued_ns = _queues.get(process.pid, (t_ns, idle_ns, 0))
    cores = set(process.cpu_affinity()) if hasattr(process, "cpu_affinity") else set(range(len(idle_ns)))
    free_ns = sum(now - then for core, (now, then) in enumerate(zip(idle_ns, before_ns, strict=False)) if core in cores)
    if state == "S":
        queued_ns += int(CROWDED_SHARE * max(0, t_ns - then_ns - free_ns))
    _queues[process.pid] = t_ns, idle_ns, queued_ns
    return queued_ns - cpu_ns


def sample(pid: int) -> Sample | None:
    """Process pid now; None if it is gone. All threads have the state of the process."""
    try:
        process = psutil.Process(pid)
        with process.oneshot():
            state = STATES.get(process.status(), "S")
            threads = {each.id: Thread(int((each.user_time + each.system_time) * 1e9), 0, state) for each in process.threads()}
            counts = process.io_counters() if hasattr(process, "io_counters") else None
        cpu_ns = sum(thread.cpu_ns for thread in threads.values())
        threads[QUEUE] = Thread(0, _queued_ns(process, cpu_ns, state), state)
    except psutil.AccessDenied:
        return Sample({}, 0, 0)
    except (psutil.Error, ValueError):
        _queues.pop(pid, None)
        return None
    if counts is None:
        return Sample(threads, 0, 0)
    disk = counts.read_bytes + counts.write_bytes
    return Sample(threads, disk, getattr(counts, "read_chars", disk) + getattr(counts, "write_chars", 0))
