"""Shared memory without Python's resource tracker.

The tracker unlinks by name after its process has died, when the next session may already use that name. Up to Python 3.12 it also
unlinks segments that its process only attached (cpython issue 82300).
"""

import contextlib
import threading
from collections.abc import Iterator
from multiprocessing import resource_tracker
from multiprocessing.shared_memory import SharedMemory

_lock = threading.Lock()


@contextlib.contextmanager
def untracked() -> Iterator[None]:
    """Hides segments opened or unlinked inside the block from the tracker."""
    with _lock:
        register, unregister = resource_tracker.register, resource_tracker.unregister
        resource_tracker.register = resource_tracker.unregister = lambda name, rtype: None
        try:
            yield
        finally:
            resource_tracker.register, resource_tracker.unregister = register, unregister


def attach(name: str) -> SharedMemory:
    """Opens an existing segment. Raises FileNotFoundError."""
    with untracked():
        return SharedMemory(name=name)
