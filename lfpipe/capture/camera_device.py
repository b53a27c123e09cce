"""A camera as the system lists it, the modules for cameras on this machine, and a limit for calls into drivers."""

import threading
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

import attrs

from lfpipe.host import PORTABLE

T = TypeVar("T")


@attrs.frozen
class CameraDevice:
    """A listed device. name: the driver's. place: its path in /sys, which names the port. Both empty if unknown."""

    path: Path
    name: str
    place: str = ""


def known() -> Any:
    """Has `nodes`, `cameras`, `describe` and `asking` of `camera_list`."""
    return import_module(f"lfpipe.capture.{'opencv_camera' if PORTABLE else 'camera_list'}")


def source() -> Any:
    """Has `CameraFinder`, `first_camera`, `none_usable`, `open_camera` and `check_camera` of `camera`."""
    return import_module(f"lfpipe.capture.{'opencv_camera' if PORTABLE else 'camera'}")


def with_time_limit(limit_s: float, call: Callable[[], T]) -> T:
    """Returns the result of call, or raises its error. Raises TimeoutError after limit_s; the thread of the call then stays until
    the process ends, because nothing can end it."""
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
