"""Files by a path that somebody gave: read only where they are files and not too large, written for their owner alone."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from collections.abc import Iterable, Iterator
from io import BufferedReader
from pathlib import Path
from typing import IO

from lfpipe.errors import UserError
from lfpipe.host.descriptors import CAREFUL, longest_name

PRIVATE = 0o600  # of a file in which somebody's face or movements are; its folder has PRIVATE_FOLDER
PRIVATE_FOLDER = 0o700
_KINDS = {
    stat.S_IFDIR: "a directory",
    stat.S_IFIFO: "a FIFO",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def reason(error: OSError | ValueError) -> str:
    """Why a file could not be opened, read or written, in words."""
    return getattr(error, "strerror", None) or str(error)


def check_regular(path: Path) -> None:
    """Raises OSError where something other than a file stands at path. Nothing there is fine."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return
    except ValueError as error:
        raise OSError(errno.EINVAL, f"not a path: {error}", str(path)) from None
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "a thing")
        raise OSError(errno.EINVAL, f"is {kind}, not a file", str(path))


def check_links(folder: Path, names: Iterable[str]) -> None:
    """Raises UserError where a file of a folder is a link out of it: an unpacked archive could show whatever you may read."""
    for path in (folder / name for name in names):
        link = os.path.islink(path)  # noqa: PTH114  (of a folder that may not be searched: the reader of the file says so)
        if link and not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder)):
            there = os.path.realpath(path)
            raise UserError(f"{path}: a link that leads out of the folder, to {there}", "copy the file into the folder")


def open_regular(path: Path) -> BufferedReader:
    """path, opened to be read. Raises OSError where it is not a file: a FIFO would block, a device may do anything."""
    check_regular(path)
    file = open(path, "rb", opener=_open_carefully)  # noqa: SIM115
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise OSError(errno.EINVAL, "changed while it was opened", str(path))
    return file


def _open_carefully(path: str, flags: int) -> int:
    return os.open(path, flags | CAREFUL)


def read_bytes(path: Path, most_bytes: int) -> bytes:
    """All of a file. Raises OSError where it is not a file, cannot be read or has more than most_bytes; no more is read."""
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        data = b"" if size > most_bytes else file.read(most_bytes + 1) or b""
    if max(size, len(data)) > most_bytes:
        raise OSError(errno.EFBIG, f"has {max(size, len(data))} bytes, {most_bytes} at most are read", str(path))
    return data


def lines(path: Path, longest: int, remedy: str) -> Iterator[tuple[int, bytes]]:
    """(number from 1, line with its end) of every line; the last one may have none.

    Raises UserError where a line is longer than that, OSError where path is no file.
    """
    with open_regular(path) as file:
        number = 0
        while line := file.readline(longest + 1):
            number += 1
            if len(line) > longest:
                raise UserError(f"{path}:{number}: a line of more than {longest} bytes", remedy)
            yield number, line


def create_private(path: Path, mode: int = PRIVATE) -> IO[bytes]:
    """A new file, for its owner alone, opened to be written. Raises OSError, FileExistsError among them."""
    return os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | CAREFUL, mode), "wb")


@contextlib.contextmanager
def replaced(path: Path, mode: int = PRIVATE) -> Iterator[IO[bytes]]:
    """A file to be written that takes the place of path when all is written; until then, and where it fails, path stays as it is.

    mode: of a new file, less the umask. Raises OSError where path is not a file, or there is no room.
    """
    check_regular(path)
    path = Path(os.path.realpath(path))
    part = path.with_name(f".{path.name[:200]}.new")
    part.unlink(missing_ok=True)  # of a writer that was killed
    try:
        with create_private(part, mode) as file:
            yield file
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def check_place(path: Path) -> None:
    """Raises OSError where `replaced` could not write path."""
    check_regular(path)
    probe = path.with_name(f".{path.name[:200]}.probe")
    probe.unlink(missing_ok=True)
    create_private(probe).close()
    probe.unlink()
    if len(os.fsencode(path.name)) > longest_name(path.parent):
        raise OSError(errno.ENAMETOOLONG, os.strerror(errno.ENAMETOOLONG), str(path))


def read_text(path: Path, most_bytes: int, what: str, remedy: str) -> str:
    """All of a file as UTF-8. what: for the message. Raises UserError where it is none."""
    try:
        return read_bytes(path, most_bytes).decode()
    except UnicodeDecodeError as error:
        why = f"not UTF-8: byte 0x{error.object[error.start]:02x} at {error.start}"
        raise UserError(f"{what}: {why}", remedy) from None
    except OSError as error:
        raise UserError(f"{what}: cannot be read: {reason(error)}", remedy) from None
