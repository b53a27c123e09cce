"""A person's files, read and written in a thread of their own, in order: a disk may be slow, or a
network drive dead.
"""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

from lfpipe.errors import UserError
from lfpipe.transport.context import Context

T = TypeVar("T")


def _nothing(_: object) -> None:
    pass


class Files:
    """The thread. It ends with the stage, once everything is saved."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._thread = ThreadPoolExecutor(1, "files")
        self._waiting: deque[tuple[Future[Any], Callable[[Any], None]]] = deque()

    def do(self, work: Callable[[], T], done: Callable[[T], None] = _nothing) -> None:
        """Does work in the thread; `serve` then passes its result to done."""
        self._waiting.append((self._thread.submit(work), done))

    def serve(self) -> Iterator[UserError]:
        """Passes on the results; yields the errors."""
        while self._waiting and self._waiting[0][0].done():
            future, done = self._waiting.popleft()
            try:
                done(future.result())
            except UserError as error:
                yield error

    def close(self) -> None:
        """Waits until everything is saved."""
        with self._context.saving("saving your settings"):
            self._thread.shutdown()
