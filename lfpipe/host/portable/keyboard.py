"""Single keys from a terminal, without waiting for Enter and without an echo: on Windows by its console, else by termios."""

import importlib
import os
import sys
import time
from types import TracebackType
from typing import Any, Self

_POLL_S = 0.02


class Keyboard:
    """A context; without a terminal on stdin there are no keys. Always restores the terminal."""

    def __enter__(self) -> Self:
        self._fd = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else -1
        self._console: Any = importlib.import_module("msvcrt") if os.name == "nt" else None
        if self._fd >= 0 and not self._console:
            import termios
            import tty

            self._before = termios.tcgetattr(self._fd)
            tty.setcbreak(self._fd)
        return self

    def key(self, timeout_s: float) -> str:
        """The next key pressed within timeout_s, in lower case, or nothing."""
        if self._fd < 0:
            time.sleep(max(timeout_s, 0.0))
            return ""
        if not self._console:
            import select

            if not select.select([self._fd], [], [], max(timeout_s, 0.0))[0]:
                return ""
            data = os.read(self._fd, 1)
            return data.decode(errors="ignore").lower() if data else "q"  # the terminal is gone
        end_s = time.monotonic() + timeout_s
        while not self._console.kbhit():
            if time.monotonic() >= end_s:
                return ""
            time.sleep(_POLL_S)
        return str(self._console.getwch()).lower()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._fd >= 0 and not self._console:
            import termios

            termios.tcsetattr(self._fd, termios.TCSADRAIN, self._before)
