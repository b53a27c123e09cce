"""The activity of a process as the kernel counts it: thread states, time on a CPU and in its queue, bytes moved (/proc)."""

import contextlib
import os
from pathlib import Path

from lfpipe.host.sample import Sample, Thread

TICK_NS = 1_000_000_000 // os.sysconf("SC_CLK_TCK")
STATE, MAJOR_FAULTS, USER_TICKS, SYSTEM_TICKS = 0, 9, 11, 12  # of the fields after the name in /proc/PID/stat


def _stat(path: Path) -> list[str]:
    return (path / "stat").read_text().rpartition(")")[2].split()


def _thread(path: Path) -> Thread:
    fields = _stat(path)
    try:
        cpu_ns, queued_ns, _ = (int(word) for word in (path / "schedstat").read_text().split())
    except (OSError, ValueError):  # a kernel that does not count it
        cpu_ns, queued_ns = (int(fields[USER_TICKS]) + int(fields[SYSTEM_TICKS])) * TICK_NS, 0
    return Thread(cpu_ns, queued_ns, fields[STATE])


def sample(pid: int) -> Sample | None:
    """A sample of process pid; None if it is gone."""
    folder, threads = Path(f"/proc/{pid}"), {}
    try:
        for path in (folder / "task").iterdir():
            with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # this thread has ended
                threads[int(path.name)] = _thread(path)
        faults = int(_stat(folder)[MAJOR_FAULTS])
    except (OSError, IndexError):
        return None
    counts: dict[str, int] = {}
    with contextlib.suppress(OSError, ValueError):  # a kernel that does not count it
        counts = {name: int(n) for name, _, n in (line.partition(":") for line in (folder / "io").read_text().splitlines())}
    disk = faults + counts.get("read_bytes", 0) + counts.get("write_bytes", 0)
    return Sample(threads, disk, faults + counts.get("rchar", 0) + counts.get("wchar", 0))
