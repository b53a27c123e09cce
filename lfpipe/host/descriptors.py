"""Open files by name, for libraries that take nothing else."""

from __future__ import annotations


def path_of(fd: int) -> str:
    """A path of plain ASCII to an open file, whatever its own name is, and even where it has none."""
    return f"/proc/self/fd/{fd}"
