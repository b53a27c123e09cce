"""A time limit for calls into drivers and decoders that may never return."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def with_time_limit(limit_s: float, call: Callable[[], T]) -> T:
    """Returns or raises what call does. Raises TimeoutError after limit_s; the thread of the call then stays behind until the
    process ends, because nothing can end it.
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
    thread.join(limit_s)
    if errors:
        raise errors[0]
    if not results:
        raise TimeoutError(f"no answer for {limit_s:g} s")
    return results[0]
