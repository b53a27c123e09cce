"""Files of a person: read by untrusted paths only if they are regular files of limited size,
written private to their owner. For an output, a command checks first, writes to a temporary file,
then renames: it never replaces an input of its command, nor a file that exists unless the person
says `--overwrite`.
"""

import contextlib
import errno
import os
import re
import secrets
import stat
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from io import BufferedReader, BufferedWriter
from pathlib import Path

from lfpipe.errors import UserError
from lfpipe.host.files import CAREFUL, CREATING, is_dir

PRIVATE = 0o600  # of a file that records a face or its movements; its folder has PRIVATE_FOLDER
PRIVATE_FOLDER = 0o700
MAX_FILE_BYTES = 1 << 36  # an hour of lossless light-field video is smaller
TEXT_BYTES = 1 << 20  # of a file of settings or facts: a hundred times what ours have
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
        self.path = path
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
