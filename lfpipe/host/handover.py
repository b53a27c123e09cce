"""Open descriptors that a process hands to the next one that it starts: reopening a webcam takes up to a second.

The process that checks a device keeps it open; a child spawned with `Kept` then owns it.
"""

from __future__ import annotations

import os
from multiprocessing import reduction
from typing import Any

_kept: dict[str, int] = {}


def keep(name: str, fd: int) -> None:
    """Takes ownership of fd under a name; closes an older descriptor of that name."""
    release(name)
    _kept[name] = fd


def take(name: str) -> int | None:
    """The descriptor of that name, which the caller then owns; None if there is none."""
    return _kept.pop(name, None)


def release(*names: str) -> None:
    """Closes the descriptors of these names, or all of them."""
    for name in names or tuple(_kept):
        fd = take(name)
        if fd is not None:
            os.close(fd)


class Kept:
    """All kept descriptors, as an argument of a spawned process: pickling duplicates them for it."""

    def __init__(self, copies: dict[str, Any] | None = None) -> None:
        self._copies = copies or {}

    def __reduce__(self) -> tuple[type[Kept], tuple[dict[str, Any]]]:
        return Kept, ({name: reduction.DupFd(fd) for name, fd in _kept.items()},)

    def adopt(self) -> None:
        """In the child: keeps the descriptors there."""
        for name, copy in self._copies.items():
            fd = copy.detach()
            os.set_inheritable(fd, False)
            keep(name, fd)
