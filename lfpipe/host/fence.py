"""The memory fence: no store or load before it is seen after one that follows it."""

from __future__ import annotations

import ctypes
import functools
import platform
from collections.abc import Callable

from lfpipe.errors import UserError

TOTAL_STORE_ORDER = ("x86_64", "AMD64", "i686")  # machines that keep program order themselves, as far as a ring needs it
LIBRARIES = ("libatomic.so.1", "libatomic.1.dylib")
SEQ_CST = 5  # memory_order_seq_cst of <stdatomic.h>


@functools.cache
def _library() -> ctypes.CDLL:
    """The library that has the fence. It is loaded when it is first needed: most machines need none."""
    for name in LIBRARIES:
        try:
            return ctypes.CDLL(name)
        except OSError:
            continue
    raise UserError(f"{platform.machine()}: no memory fence: libatomic is not installed", "apt-get install libatomic1")


def _fence() -> None:
    _library().atomic_thread_fence(SEQ_CST)


def _nothing() -> None:
    """Program order is enough."""


fence: Callable[[], None] = _nothing if platform.machine() in TOTAL_STORE_ORDER else _fence
