"""The memory fence: no store or load before it is observed after one that follows it."""

import ctypes
import ctypes.util
import functools
import platform
from collections.abc import Callable

from lfpipe.errors import UserError

TOTAL_STORE_ORDER = ("x86_64", "AMD64", "i686")  # processors that keep program order as far as a ring needs it
LIBRARIES = ("libatomic.so.1", "libatomic.1.dylib")
SEQ_CST = 5  # memory_order_seq_cst of <stdatomic.h>


@functools.cache
def _full_fence() -> Callable[[], object]:
    """libatomic's fence, or the C library's if it has one (macOS). Raises UserError if there is neither."""
    for name in (*LIBRARIES, ctypes.util.find_library("atomic")):
        try:
            if name:
                return functools.partial(ctypes.CDLL(name).atomic_thread_fence, SEQ_CST)
        except (OSError, AttributeError):
            continue
    try:
        own: Callable[[], object] = ctypes.CDLL(None).OSMemoryBarrier
    except (OSError, TypeError, AttributeError):
        message = f"{platform.machine()}: no memory fence: the library libatomic is not installed"
        raise UserError(message, "apt-get install libatomic1, dnf install libatomic, or apk add libatomic") from None
    return own


def _fence() -> None:
    _full_fence()()


def _nothing() -> None:
    """Does nothing: program order suffices."""


fence: Callable[[], None] = _nothing if platform.machine() in TOTAL_STORE_ORDER else _fence
