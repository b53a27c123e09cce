"""Keys of an exhibition: only a code, typed key by key, has an effect."""

from collections import deque


class KeyLock:
    """Waits for a code."""

    def __init__(self, code: str) -> None:
        self._code = code
        self._typed: deque[str] = deque(maxlen=len(code))

    def opens(self, char: str) -> bool:
        """Whether this character completes the code; keys without a character do not count."""
        self._typed.extend(char)
        return "".join(self._typed) == self._code
