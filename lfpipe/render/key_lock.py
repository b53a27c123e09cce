"""Keys of an exhibition: none does anything but those of a code, typed one after the other."""

from __future__ import annotations

from collections import deque


class KeyLock:
    """Waits for a code."""

    def __init__(self, code: str) -> None:
        self._code = code
        self._typed: deque[str] = deque(maxlen=len(code))

    def opens(self, char: str) -> bool:
        """Whether the code is complete with this character; keys without one do not count."""
        self._typed.extend(char)
        return "".join(self._typed) == self._code
