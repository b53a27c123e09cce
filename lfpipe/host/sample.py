"""The activity of a process at one moment."""

import attrs


@attrs.frozen
class Thread:
    """cpu_ns: time on a CPU. queued_ns: time runnable but waiting for a CPU. state: R, S, D, T, ..."""

    cpu_ns: int = 0
    queued_ns: int = 0
    state: str = "S"


@attrs.frozen
class Sample:
    """A process at one moment. disk: pages and bytes read from or written to a disk; bytes: everything read and written,
    including pipes and caches. Both only grow.
    """

    threads: dict[int, Thread]
    disk: int
    bytes: int
