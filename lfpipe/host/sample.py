"""What is known of a process at one moment."""

from __future__ import annotations

import attrs


@attrs.frozen
class Thread:
    """cpu_ns: time on a CPU. queued_ns: time in which it could have run and another one did. state: R, S, D, T, ..."""

    cpu_ns: int = 0
    queued_ns: int = 0
    state: str = "S"


@attrs.frozen
class Sample:
    """A process at one moment. disk: pages and bytes that came from or went to a disk; bytes: all that it read and wrote, from
    pipes and caches too. Both only grow.
    """

    threads: dict[int, Thread]
    disk: int
    bytes: int
