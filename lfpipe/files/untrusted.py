"""Values from untrusted files, and the trace: JSON Lines, one object per display refresh or per
camera frame, appended by whole lines only.

Of values, depth, finiteness, range and type are checked; errors name the place in the file. All
functions raise only UserError. `where` names the file in messages; `remedy` is the remedy.
"""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import attrs

from lfpipe.errors import UserError, quoted
from lfpipe.files.safe_files import LONGEST_LINE, LineFile, lines, reason, replaced

MAX_DEPTH = 32  # no file of ours has ten levels; Python ends at a thousand
MAX_INTEGER = (1 << 63) - 1  # what NumPy, msgpack and every other reader can hold
_MAX_TOML_LINE = 4096  # tomllib's time for dotted keys grows with the square of their number


def toml_table(data: bytes | str, where: str, remedy: str) -> dict[str, Any]:
    """The table of a TOML document, UTF-8.

    Times, and numbers that are not finite, are left to the caller.
    """
    try:
        text = data.decode() if isinstance(data, bytes) else data
        for number, line in enumerate(text.split("\n"), 1):
            if len(line) > _MAX_TOML_LINE:
                raise ValueError(
                    f"line {number} has {len(line)} characters; at most {_MAX_TOML_LINE} are"
                    " allowed"
                )
        table = tomllib.loads(text)
        _check(table)
    except (ValueError, RecursionError) as error:
        raise UserError(f"{where}: not valid TOML: {_reason(error)}", remedy) from None
    return table


def _check(value: Any, level: int = 0) -> None:
    """Raises ValueError for deep nesting and large integers."""
    if level > MAX_DEPTH:
        raise ValueError(f"nested more than {MAX_DEPTH} levels deep")
    if isinstance(value, int) and not -MAX_INTEGER - 1 <= value <= MAX_INTEGER:
        raise ValueError("an integer of more than 64 bits")
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        for item in value:
            _check(item, level + 1)


def _reason(error: Exception) -> str:
    if isinstance(error, UnicodeDecodeError):
        return f"byte 0x{error.object[error.start]:02x} at {error.start} is not UTF-8"
    return "too deeply nested" if isinstance(error, RecursionError) else str(error)


def json_fields(data: bytes | str, where: str, remedy: str) -> Fields:
    """The JSON object in data, UTF-8, to be read field by field.

    Unlike json.loads: no NaN or infinity, no integer beyond 64 bits, no deep nesting.
    """
    try:
        value = json.loads(data.decode() if isinstance(data, bytes) else data)
        _check(value)
        # neither NaN nor half of a surrogate pair
        json.dumps(value, ensure_ascii=False, allow_nan=False).encode()
    except (ValueError, RecursionError) as error:
        raise UserError(f"{where}: not valid JSON: {_reason(error)}", remedy) from None
    if not isinstance(value, dict):
        raise UserError(f"{where}: expected a JSON object, not {quoted(value)}", remedy)
    return Fields(value, where, remedy)


def finite(text: str, low: float = -math.inf, high: float = math.inf) -> float | None:
    """The number in text if it is finite and in low .. high; else None. For optional numbers."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) and low <= value <= high else None


@attrs.frozen
class Fields:
    """A mapping from a file; each method reads one field of a given type and range, inclusive, or
    raises UserError.
    """

    values: Mapping[str, Any]
    where: str
    remedy: str

    def number(self, key: str, low: float, high: float) -> float:
        """A finite number."""
        return float(
            self._read(
                key,
                lambda v: _is_number(v) and low <= v <= high,
                f"a number from {low:g} to {high:g}",
            )
        )

    def integer(self, key: str, low: int, high: int) -> int:
        """A whole number; 3.0 is refused."""
        return int(
            self._read(
                key,
                lambda v: _is_number(v) and isinstance(v, int) and low <= v <= high,
                f"a whole number from {low} to {high}",
            )
        )

    def flag(self, key: str) -> bool:
        """true or false."""
        return bool(self._read(key, lambda v: isinstance(v, bool), "true or false"))

    def text(self, key: str, most_chars: int = 10_000) -> str:
        """A string."""
        return str(
            self._read(
                key,
                lambda v: isinstance(v, str) and len(v) <= most_chars,
                f"a string of at most {most_chars} characters",
            )
        )

    def numbers(self, key: str, count: int, low: float, high: float) -> list[float]:
        """A list of finite numbers of the given length."""

        def fits(value: Any) -> bool:
            return (
                isinstance(value, list)
                and len(value) == count
                and all(_is_number(number) and low <= number <= high for number in value)
            )

        return list(self._read(key, fits, f"{count} numbers from {low:g} to {high:g}"))

    def table(self, key: str) -> Fields:
        """A mapping within this one."""
        return Fields(
            self._read(key, lambda v: isinstance(v, dict), "an object"),
            f"{self.where}: {key}",
            self.remedy,
        )

    def _read(self, key: str, fits: Callable[[Any], bool], expected: str) -> Any:
        if key not in self.values:
            raise UserError(f"{self.where}: {key} is missing", self.remedy)
        if not fits(self.values[key]):
            raise UserError(
                f"{self.where}: {key} is {quoted(self.values[key])}, expected {expected}",
                self.remedy,
            )
        return self.values[key]


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


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
