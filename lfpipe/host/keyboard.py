"""Single keys from a terminal, without waiting for Enter and without an echo: on Windows by its console, else by termios."""

import importlib
import os
import select
import sys
import time
from types import TracebackType
from typing import Any, Self

from lfpipe.host import WINDOWS

_POLL_S = 0.02


class Keyboard:
    """A context; without a terminal on stdin there are no keys. Always restores the terminal."""

    def __enter__(self) -> Self:
        self._fd = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else -1
        self._system: Any = importlib.import_module("msvcrt" if WINDOWS else "termios") if self._fd >= 0 else None
        if self._system and not WINDOWS:
            self._before = self._system.tcgetattr(self._fd)
            importlib.import_module("tty").setcbreak(self._fd)
        return self

    def key(self, timeout_s: float) -> str:
        """The next key pressed within timeout_s, in lower case, or nothing."""
        if not self._system:
            time.sleep(max(timeout_s, 0.0))
            return ""
        if WINDOWS:
            end_s = time.monotonic() + timeout_s
            while not self._system.kbhit():
                if time.monotonic() >= end_s:
                    return ""
                time.sleep(_POLL_S)
            return str(self._system.getwch()).lower()
        if not select.select([self._fd], [], [], max(timeout_s, 0.0))[0]:
            return ""
        data = os.read(self._fd, 1)
        return data.decode(errors="ignore").lower() if data else "q"  # the terminal is gone, and nobody reads the output

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._system and not WINDOWS:
            self._system.tcsetattr(self._fd, self._system.TCSADRAIN, self._before)
