"""Calls into drivers and decoders that may never come back, with a limit on the time that anybody waits for them."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def within(limit_s: float, call: Callable[[], T]) -> T:
    """What call returns, or raises. Raises TimeoutError after limit_s; the thread that it runs in is then left behind, for nobody
    can end it, and goes with the process.
    """
    results: list[T] = []
    errors: list[BaseException] = []

    def run() -> None:
        try:
            results.append(call())
        except BaseException as error:  # it belongs to whoever waits
            errors.append(error)

    thread = threading.Thread(target=run, name="limited", daemon=True)
    thread.start()
    thread.join(limit_s)
    if errors:
        raise errors[0]
    if not results:
        raise TimeoutError(f"no answer for {limit_s:g} s")
    return results[0]
