"""The trace: JSON Lines, one object per display refresh or per camera frame, appended by whole
lines only.
"""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from lfpipe.errors import UserError
from lfpipe.files.safe_files import LONGEST_LINE, LineFile, lines, reason, replaced
from lfpipe.files.untrusted import Fields, json_fields

TIMES = ("t_sensor_ns", "t_read_ns", "t_tracked_ns", "t_composed_ns", "t_presented_ns")
MAX_NS = 1 << 61  # 73 years; sums of two stay within 64 bits
MAX_PX = 1e12  # limit for eyes (px) and views


def trace_lines(path: Path, remedy: str) -> Iterator[Fields]:
    """The lines of a trace, with fields checked against the contract. A last line without a newline
    is ignored.

    Raises UserError with the wrong line and field.
    """
    try:
        for number, line in lines(path, LONGEST_LINE, remedy):
            if not line.endswith(b"\n"):
                return
            fields = json_fields(
                line, f"{path}: not a trace that can be read: line {number}", remedy
            )
            for name in (
                "source_seq",
                "epoch",
                *TIMES,
                *{"t_started_ns"}.intersection(fields.values),
            ):
                fields.integer(name, 0, MAX_NS)
            for name in ("face", "composed"):
                fields.flag(name)
            fields.text("method", 100)
            check_sides(fields, "view")
            yield fields
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {reason(error)}", remedy) from None


def check_sides(fields: Fields, name: str) -> None:
    """Raises UserError if a field is not {"left": [x, y], "right": [x, y]}."""
    sides = fields.table(name)
    for side in ("left", "right"):
        sides.numbers(side, 2, -MAX_PX, MAX_PX)


class TraceFile:
    """Writes whole lines of JSON to a file. Lines of an earlier session stay until the first new
    one.

    A full disk or a removed path ends the trace, not the session: `lost` is called once with the
    reason.
    """

    def __init__(self, path: Path, lost: Callable[[str], None], since: Path | None = None) -> None:
        """since: for a restarted writer, a file that its session wrote at its start: lines after it
        are kept.
        """
        self._path = path
        self._lost = lost
        self._file: LineFile | None = None
        try:
            self._goes_on = (
                since is not None
                and path.exists()
                and path.stat().st_mtime_ns >= since.stat().st_mtime_ns
            )
            self._file = LineFile(path)
        # the path was valid at the start, but its directory may be gone since
        except OSError as error:
            self._end(error)

    def write(self, record: dict[str, Any]) -> None:
        """One line; keys as in docs/contracts.md."""
        if self._file is None:
            return
        line = json.dumps(record, allow_nan=False).encode() + b"\n"
        try:
            if self._goes_on:
                self._file.append(line)
            else:
                self._begin(self._file.path, line)
        except OSError as error:
            self._end(error)

    def _begin(self, path: Path, line: bytes) -> None:
        """Replaces the lines of an earlier session, which stay if that fails. Raises OSError."""
        self.close()
        with replaced(path) as file:
            file.write(line)
        self._file = LineFile(path)
        self._goes_on = True

    def _end(self, error: OSError) -> None:
        self.close()
        self._lost(f"trace {self._path}: {error.strerror}; it ends here")

    def close(self) -> None:
        """Ends the trace. Without a line, it is an empty file unless there is an older one."""
        if self._file is not None:
            self._file.close()
            self._file = None
