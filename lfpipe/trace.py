"""The trace: JSON Lines, one object per display refresh or per camera frame, appended whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lfpipe.errors import UserError
from lfpipe.line_file import LineFile


def check_trace(path: Path) -> None:
    """Makes an empty trace. Raises UserError where that cannot be."""
    try:
        path.write_bytes(b"")
    except OSError as error:
        raise UserError(f"trace {path}: {error.strerror}", "a file in a directory that you may write to") from None


class TraceFile:
    """Lines of JSON in a file, each whole. Neither a full disk nor a path that is gone ends the session: the trace ends, and
    `lost` is called once with the reason.
    """

    def __init__(self, path: Path | None, lost: Callable[[str], None]) -> None:
        self._path, self._lost = path, lost
        self._file: LineFile | None = None
        if path is not None:
            try:
                self._file = LineFile(path)
            except OSError as error:  # another process of this stage could open it; its directory may be gone since
                self._end(error)

    @property
    def wanted(self) -> bool:
        return self._file is not None

    def write(self, record: dict[str, Any]) -> None:
        """One line; keys as in the contract of design and README."""
        if self._file is None:
            return
        try:
            self._file.append(json.dumps(record, allow_nan=False).encode() + b"\n")
        except OSError as error:
            self._end(error)

    def _end(self, error: OSError) -> None:
        self.close()
        self._lost(f"trace {self._path}: {error.strerror}; it ends here")

    def close(self) -> None:
        """Ends the trace."""
        if self._file is not None:
            self._file.close()
            self._file = None
