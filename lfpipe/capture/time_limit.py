"""A time limit for calls into drivers and decoders that may never return."""

import os
import threading
import time
from collections.abc import Callable
from typing import TypeVar

from lfpipe.host import activity

T = TypeVar("T")


SLICE_S = 0.05


def with_time_limit(limit_s: float, call: Callable[[], T], busy_limit_s: float = 0.0) -> T:
    """Returns the result of call, or raises its error. Raises TimeoutError after limit_s; the thread of the call then stays until
    the process ends, because nothing can end it.

    busy_limit_s: if given, limit_s counts from the last time at which the call used the processor, and busy_limit_s limits the
    total: a slow machine is not a stuck driver.
    """
    results: list[T] = []
    errors: list[BaseException] = []

    def run() -> None:
        try:
            results.append(call())
        except BaseException as error:  # raised in the caller's thread
            errors.append(error)

    thread = threading.Thread(target=run, name="time-limit", daemon=True)
    thread.start()
    began_s = idle_s = time.monotonic()
    used_ns = 0
    while thread.is_alive() and (now_s := time.monotonic()) - idle_s < limit_s:
        thread.join(min(SLICE_S, limit_s) if busy_limit_s else limit_s - (now_s - idle_s))
        if busy_limit_s and now_s - began_s < busy_limit_s and (so_far_ns := _cpu_ns(thread)) > used_ns:
            used_ns, idle_s = so_far_ns, time.monotonic()
    if errors:
        raise errors[0]
    if not results:
        raise TimeoutError(f"no answer for {limit_s:g} s")
    return results[0]


def _cpu_ns(thread: threading.Thread) -> int:
    sample = activity.sample(os.getpid())
    known = sample.threads.get(thread.native_id or 0) if sample else None
    return known.cpu_ns if known else 0
