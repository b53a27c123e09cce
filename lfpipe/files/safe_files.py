"""Files of a person: read by untrusted paths only if they are regular files of limited size,
written private to their owner. For an output, a command checks first, writes to a temporary file,
then renames: it never replaces an input of its command, nor a file that exists unless the person
says `--overwrite`.

Of values in files, depth, finiteness, range and type are checked; errors name the place in the
file. `where` names the file in messages; `remedy` is the remedy. The trace is JSON Lines, one
object per display refresh or per camera frame, appended by whole lines only.
"""

import contextlib
import errno
import json
import math
import os
import re
import secrets
import stat
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from io import BufferedReader, BufferedWriter
from pathlib import Path
from typing import Any

import attrs

from lfpipe.errors import UserError, quoted
from lfpipe.host.files import CAREFUL, CREATING, is_dir

PRIVATE = 0o600  # of a file that records a face or its movements; its folder has PRIVATE_FOLDER
PRIVATE_FOLDER = 0o700
MAX_FILE_BYTES = 1 << 36  # an hour of lossless light-field video is smaller
TEXT_BYTES = 1 << 20  # of a file of settings or facts: a hundred times what ours have
# of a network, of the offsets of 20,000 views, of a thousand poses with more digits than doubles
TABLE_BYTES = 16 << 20
# begins what Git LFS checks out in the place of a file (its specification)
LFS_POINTER = b"version https://git-lfs."
LONGEST_LINE = 1 << 16  # bytes of a `LineFile`; limit of the search for the end of the last line
WORK_NAME = re.compile(r"\.lfpipe-[0-9a-f]{16}\.new.{0,40}")  # of `replaced`
_watchers: list[Callable[[Path], None]] = []


def reason(error: OSError | ValueError) -> str:
    """Why a file could not be opened, read or written."""
    return getattr(error, "strerror", None) or str(error)


def check_regular(path: Path) -> None:
    """Raises OSError if path exists and is not a regular file."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return
    except ValueError as error:
        raise OSError(errno.EINVAL, f"not a path: {error}", str(path)) from None
    if not stat.S_ISREG(mode):
        raise OSError(
            errno.EINVAL,
            f"is {'a directory' if stat.S_ISDIR(mode) else 'a device or FIFO'}, not a file",
            str(path),
        )


def check_links(folder: Path, names: Iterable[str]) -> None:
    """Raises UserError if a file of a folder is a link out of it: an unpacked archive could expose
    any readable file. A name may begin with that of a subfolder.
    """
    for path in (folder / name for name in names):
        # os.path raises nothing where nobody may search
        linked = any(map(os.path.islink, (path, path.parent)))
        if linked and not Path(target := os.path.realpath(path)).is_relative_to(
            os.path.realpath(folder)
        ):
            raise UserError(
                f"{path}: a link to {target}, outside of the folder",
                "copy the files (`cp -rL` follows links)",
            )


def open_regular(path: Path) -> BufferedReader:
    """Opens path for reading.

    Raises OSError if it is not a regular file: a FIFO would block, a device may do anything.
    UserError for what Git LFS leaves in the place of a file that it has not fetched.
    """
    check_regular(path)
    file = open(path, "rb", opener=lambda path, flags: os.open(path, flags | CAREFUL))  # noqa: SIM115
    if file.peek().startswith(LFS_POINTER):
        file.close()
        raise UserError(
            f"{path}: a pointer of Git LFS, not the file itself: `git lfs pull` fetches it",
            "run `git lfs pull`; in CI, check out with `lfs: true`",
        )
    return file


def watch_files(notice: Callable[[Path], None]) -> None:
    """Calls notice with every path that `open_file` opens from now on: a library that reads it may
    crash.
    """
    _watchers.append(notice)


def open_file(path: Path, most_bytes: int = MAX_FILE_BYTES) -> BufferedReader:
    """As `open_regular`. Raises UserError, also if the file has more than most_bytes."""
    try:
        file = open_regular(path)
    except OSError as error:
        raise UserError(
            f"{path}: cannot be read: {reason(error)}", "check the file and its permissions"
        ) from None
    size = os.fstat(file.fileno()).st_size
    if size > most_bytes:
        file.close()
        raise UserError(
            f"{path}: has {size} bytes; at most {most_bytes} are allowed",
            "check that its name is right",
        )
    for notice in _watchers:
        notice(path)
    return file


def read_bytes(path: Path, most_bytes: int = TEXT_BYTES) -> bytes:
    """Reads a whole file.

    Raises OSError if it is not a file, cannot be read or has more than most_bytes; then reading
    stops.
    """
    with open_regular(path) as file:
        data = file.read(most_bytes + 1) or b""
    if len(data) > most_bytes:
        raise OSError(errno.EFBIG, f"has more than {most_bytes} bytes", str(path))
    return data


def lines(path: Path, longest: int, remedy: str) -> Iterator[tuple[int, bytes]]:
    """(number from 1, line with its newline) of every line; the last line may lack the newline.

    Raises UserError if a line is longer than that, OSError if path is not a file.
    """
    with open_regular(path) as file:
        for number, line in enumerate(iter(partial(file.readline, longest + 1), b""), 1):
            if len(line) > longest:
                raise UserError(f"{path}:{number}: a line of more than {longest} bytes", remedy)
            yield number, line


def create_private(path: Path, mode: int = PRIVATE) -> BufferedWriter:
    """Creates a file, private to its owner, and opens it for writing.

    Raises OSError, for example FileExistsError.
    """
    return open(path, "xb", opener=lambda path, flags: os.open(path, flags | CREATING, mode))


@contextlib.contextmanager
def replaced(path: Path, mode: int = PRIVATE) -> Iterator[BufferedWriter]:
    """A file to write, also by its name, that replaces path when it is complete. Until then, and if
    writing fails, path is unchanged; a killed writer leaves a hidden file beside it.

    mode: of the file, less the umask, and no wider than that of the one it replaces. Raises OSError
    that names path.
    """
    check_regular(path)
    place = Path(os.path.realpath(path))
    with contextlib.suppress(FileNotFoundError):
        mode &= place.stat().st_mode | PRIVATE
    # with its suffix: FFmpeg chooses the format by it
    new = place.with_name(f".lfpipe-{secrets.token_hex(8)}.new{place.suffix[:40]}")
    try:
        with create_private(new, mode) as file:
            yield file
        new.replace(place)
    except OSError as error:
        if not error.filename:  # of a write
            error.filename = str(path)
        raise
    finally:
        new.unlink(missing_ok=True)


def write_file(path: Path, data: bytes, mode: int = PRIVATE) -> None:
    """Replaces a file by data at once; creates its folder if there is none.

    mode: as `replaced`. Raises OSError.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with replaced(path, mode) as file:
        file.write(data)


def read_text(path: Path, what: str, remedy: str) -> str:
    """Reads a file of at most TEXT_BYTES as UTF-8. what: for the message. Raises UserError if it is
    longer, or not UTF-8.
    """
    try:
        return read_bytes(path).decode()
    except UnicodeDecodeError as error:
        raise UserError(
            f"{what}: not UTF-8: byte 0x{error.object[error.start]:02x} at {error.start}", remedy
        ) from None
    except OSError as error:
        raise UserError(f"{what}: cannot be read: {reason(error)}", remedy) from None


class LineFile:
    """Appends lines with one write each. A partial line left by a killed writer is cut off."""

    def __init__(self, path: Path) -> None:
        """Creates the file, private to its owner, if it does not exist. Raises OSError, also if
        path is not a file.
        """
        check_regular(path)
        self._fd = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT | CAREFUL, PRIVATE)
        size = os.fstat(self._fd).st_size
        tail = (
            os.pread(self._fd, min(size, LONGEST_LINE), max(0, size - LONGEST_LINE))
            if size
            else b""
        )
        if tail and not tail.endswith(b"\n"):
            os.ftruncate(self._fd, size - len(tail) + tail.rfind(b"\n") + 1)

    def append(self, line: bytes) -> None:
        """Appends line, which ends with a newline.

        Raises OSError if it does not fit; the file then ends with the last line.
        """
        written = 0
        try:
            while written < len(line):  # after a short write, a second one raises the reason
                written += os.write(self._fd, line[written:])
        except OSError:
            if written:
                os.ftruncate(self._fd, os.fstat(self._fd).st_size - written)
            raise

    def close(self) -> None:
        os.close(self._fd)


PLACE = "name a file in an existing folder that you may write to, on a disk with free space"


def check_output(
    path: Path,
    inputs: Iterable[Path] = (),
    overwrite: bool | None = None,
    label: str = "",
) -> None:
    """Raises UserError if a command must not write path: not a file in a writable folder, an input
    of the same command or a file in an input folder, or there already. Changes nothing.

    overwrite: the value of the command's --overwrite; None without such an option. label: the
    option's name, for the message.
    """
    what = f"{label} {path}".lstrip()
    try:
        target = Path(os.path.realpath(path))
        check_regular(target)
        target.parent.stat()
        exists = os.path.lexists(target)
        if not os.access(target.parent, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except (OSError, ValueError) as error:
        raise UserError(f"{what}: {reason(error)}", PLACE) from None
    for source in inputs:
        if _is_input(target, source):
            raise UserError(
                f"{what}: belongs to {source}, which this command reads",
                "name a file in another folder" if is_dir(source) else "name another file",
            )
    if exists and not overwrite:
        remedy = "name another file" + ("" if overwrite is None else ", or add --overwrite")
        raise UserError(f"{what}: already exists", remedy)


def check_outside(folder: Path, inputs: Iterable[Path | None], label: str = "") -> None:
    """Raises UserError if a folder that a command fills is, or lies in, one that it reads."""
    for source in filter(None, inputs):
        if _is_input(Path(os.path.realpath(folder)), source):
            raise UserError(
                f"{label} {folder}: is in {source}, which this command reads".lstrip(),
                "name another folder",
            )


def _is_input(target: Path, source: Path) -> bool:
    """Whether target is source, or in the folder source."""
    with contextlib.suppress(OSError):
        if target.samefile(source):
            return True
    return target.is_relative_to(os.path.realpath(source))


def write_output(path: Path, data: bytes, mode: int = 0o644, label: str = "") -> None:
    """Replaces path, which `check_output` allows, with data. Raises UserError."""
    try:
        with replaced(path, mode) as file:
            file.write(data)
    except OSError as error:
        raise UserError(f"{label} {path}: {reason(error)}".lstrip(), PLACE) from None


MAX_DEPTH = 32  # no file of ours has ten levels; Python ends at a thousand
MAX_INTEGER = (1 << 63) - 1  # what NumPy, msgpack and every other reader can hold
# of a line of TOML, and of any text of the configuration: the longest path; tomllib's time for
# dotted keys grows with the square of their number
LINE_CHARS = 4096


def toml_table(data: bytes | str, where: str, remedy: str) -> dict[str, Any]:
    """The table of a TOML document, UTF-8.

    Times, and numbers that are not finite, are left to the caller.
    """
    try:
        text = data.decode() if isinstance(data, bytes) else data
        for number, line in enumerate(text.split("\n"), 1):
            if len(line) > LINE_CHARS:
                raise ValueError(
                    f"line {number} has {len(line)} characters; at most {LINE_CHARS} are allowed"
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


def json_fields(data: bytes | str, where: str, remedy: str) -> "Fields":
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
        return list(
            self._read(
                key,
                lambda values: (
                    isinstance(values, list)
                    and len(values) == count
                    and all(_is_number(v) and low <= v <= high for v in values)
                ),
                f"{count} numbers from {low:g} to {high:g}",
            )
        )

    def table(self, key: str) -> "Fields":
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
            else:  # replaces the lines of an earlier session, which stay if that fails
                write_file(self._path, line)
                self._file.close()
                self._file = LineFile(self._path)
                self._goes_on = True
        except OSError as error:
            self._end(error)

    def _end(self, error: OSError) -> None:
        self.close()
        self._lost(f"trace {self._path}: {error.strerror}; it ends here")

    def close(self) -> None:
        """Ends the trace. Without a line, it is an empty file unless there is an older one."""
        if self._file is not None:
            self._file.close()
            self._file = None
