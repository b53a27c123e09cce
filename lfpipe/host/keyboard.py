"""Single keys from a terminal, without waiting for Enter and without an echo."""

import os
import select
import sys
import termios
import tty
from types import TracebackType
from typing import Self


class Keyboard:
    """A context; without a terminal on stdin there are no keys. Always restores the terminal."""

    def __enter__(self) -> Self:
        self._fd = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else -1
        if self._fd >= 0:
            self._before = termios.tcgetattr(self._fd)
            tty.setcbreak(self._fd)
        return self

    def key(self, timeout_s: float) -> str:
        """The next key pressed within timeout_s, in lower case, or nothing."""
        fds = [self._fd] if self._fd >= 0 else []
        ready, _, _ = select.select(fds, [], [], max(timeout_s, 0.0))
        if not ready:
            return ""
        data = os.read(self._fd, 1)
        if not data:  # the terminal is gone: no keys, and nobody reads the output
            return "q"
        return data.decode(errors="ignore").lower()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._fd >= 0:
            termios.tcsetattr(self._fd, termios.TCSADRAIN, self._before)
