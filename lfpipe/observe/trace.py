"""The trace: JSON Lines, one object per display refresh or per camera frame, appended whole or not at all."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lfpipe.errors import UserError


def check_trace(path: Path) -> None:
    """Makes an empty trace. Raises UserError where that cannot be."""
    try:
        path.write_bytes(b"")
    except OSError as error:
        raise UserError(f"trace {path}: {error.strerror}", "a file in a directory that you may write to") from None


class TraceFile:
    """Appends lines with one write each, so that a reader or a restart never meets half a line of ours.

    A full disk ends the trace, not the session: `lost` is called once with the reason.
    """

    def __init__(self, path: Path | None, lost: Callable[[str], None]) -> None:
        self._lost = lost
        self._fd = -1 if path is None else os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)

    @property
    def wanted(self) -> bool:
        return self._fd >= 0

    def write(self, record: dict[str, Any]) -> None:
        """One line; keys as in the contract of design and README."""
        if self._fd < 0:
            return
        line = json.dumps(record, allow_nan=False).encode() + b"\n"
        try:
            if os.write(self._fd, line) != len(line):
                raise OSError(28, "no space left on the device")
        except OSError as error:
            self.close()
            self._lost(f"trace: {error.strerror}")

    def close(self) -> None:
        """Ends the trace."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1
