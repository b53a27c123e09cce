"""Untrusted folders and pictures: bounded in size, confined to the folder, with precise errors."""

import contextlib
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError, shown
from lfpipe.files.safe_files import open_regular, reason
from lfpipe.host.files import path_of
from lfpipe.host.terminal import opencv_logging

MAX_FILES = 20_000  # a light field of 100x100 views has half of this; a larger folder is something else
MAX_FILE_BYTES = 1 << 36  # of any file of a scene; an hour of lossless light-field video is smaller
PICTURES = (".png", ".jpg", ".jpeg", ".ppm", ".pgm", ".pnm", ".bmp", ".tif", ".tiff", ".webp", ".avif", ".gif")
MAX_MAP_BYTES = 80_000_000  # of a float32 map, which is in memory twice while it is read
VIDEOS = (".mp4", ".mkv", ".avi", ".mov", ".webm", ".m4v")
_CHECK = "check the file and its permissions"


@attrs.frozen
class Listing:
    """The content of a path. `names`: the files directly in `folder` (one name if the path is a file), with numbers in numeric
    order; `folders`: names of its subfolders."""

    path: Path
    folder: Path
    names: tuple[str, ...]
    folders: tuple[str, ...]
    is_file: bool

    def pictures(self) -> list[str]:
        """Names of picture files."""
        return [name for name in self.names if name.lower().endswith(PICTURES)]

    def file(self, name: str) -> Path:
        """The path of one of the folder's files. Raises UserError if it is a link that leads out of the folder."""
        path = self.folder / name
        if self.folder != self.path:  # the user named this file
            return path
        try:
            linked = path.is_symlink() or (path.parent != self.folder and path.parent.is_symlink())
            if linked and not path.resolve().is_relative_to(self.folder.resolve()):
                raise UserError(
                    f"{path}: a link to {path.resolve()}, outside of the folder", "copy the files (`cp -rL` follows links)"
                )
        except (OSError, RuntimeError) as error:  # Python 3.11, 3.12: RuntimeError for a loop of links
            why = reason(error) if isinstance(error, OSError) else "links that lead in a circle"
            raise UserError(f"{path}: cannot be read: {why}", _CHECK) from None
        return path


def natural(name: str) -> list[tuple[int, int, str]]:
    """Sort key that puts view_2 before view_10."""
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in re.split(r"(\d+)", name) if part]


def list_scene(path: str | os.PathLike[str]) -> Listing:
    """Lists a scene's folder or file. Raises UserError if it is missing, unreadable or holds too many files."""
    given, where = Path(path), str(path).replace("\n", r"\n")
    try:
        mode = given.stat().st_mode
        if stat.S_ISREG(mode):
            return Listing(given, given.parent, (given.name,), (), True)
        if not stat.S_ISDIR(mode):
            raise UserError(f"{where}: neither a file nor a folder", "give the folder of the views, or their file")
        names, folders = _entries(given)
    except FileNotFoundError:
        raise UserError(f"{where}: no such scene", "give the folder of the views, or their file") from None
    except OSError as error:
        raise UserError(f"{where}: cannot be read: {reason(error)}", "check the path and its permissions") from None
    except ValueError as error:  # a NUL in the path
        raise UserError(f"{shown(str(given))}: not a path: {error}", "give the folder of the views") from None
    if not names and not folders:
        raise UserError(f"{where}: the folder is empty", "give the folder of the views, or their file")
    return Listing(given, given, tuple(sorted(names, key=natural)), tuple(sorted(folders, key=natural)), False)


def _entries(folder: Path) -> tuple[list[str], list[str]]:
    """Names of files and of subfolders; without hidden ones."""
    names: list[str] = []
    folders: list[str] = []
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.startswith("."):
                continue
            if not names and not folders:
                _require_entry(folder, entry)
            inner = False
            with contextlib.suppress(OSError):  # a circular link matters only if it is needed
                inner = entry.is_dir()
            (folders if inner else names).append(entry.name)
            if len(names) + len(folders) > MAX_FILES:
                raise UserError(
                    f"{folder}: more than {MAX_FILES} files, no light field has so many views",
                    "give the folder that holds the views of one scene only",
                )
    return names, folders


def _require_entry(folder: Path, entry: os.DirEntry[str]) -> None:
    """Raises UserError if the folder can be listed (r) but not searched (x)."""
    try:
        entry.stat(follow_symlinks=False)
    except PermissionError:
        remedy = f"chmod u+x {folder}"
        raise UserError(f"{folder}: search permission is missing", remedy) from None


@contextlib.contextmanager
def library_errors(path: str | os.PathLike[str]) -> Iterator[None]:
    """Turns errors of the libraries that read files, and lack of memory, into UserError; silences OpenCV's warnings about the
    files."""
    try:
        with opencv_logging():
            yield
    except MemoryError:
        raise UserError(f"{path}: not enough memory to read it", "use smaller or fewer views") from None
    except cv2.error as error:
        why = (error.err or str(error)).strip().splitlines()[0]
        raise UserError(f"{path}: OpenCV cannot read it: {why}", "check its pictures with another program") from None
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {reason(error)}", _CHECK) from None


def open_file(path: Path, most_bytes: int = MAX_FILE_BYTES) -> BinaryIO:
    """Opens a regular file for reading. Raises UserError if it is something else, unreadable or too large."""
    try:
        file = open_regular(path)
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {reason(error)}", _CHECK) from None
    size = os.fstat(file.fileno()).st_size
    if size > most_bytes:
        file.close()
        raise UserError(f"{path}: has {size} bytes; at most {most_bytes} are allowed", "check that its name is right")
    return file


def read_bytes(path: Path, most_bytes: int = 1 << 20) -> bytes:
    """The bytes of a file. Raises UserError as `open_file` does."""
    with open_file(path, most_bytes) as file:
        try:
            return file.read()
        except OSError as error:
            raise UserError(f"{path}: cannot be read: {reason(error)}", _CHECK) from None


def descriptor_path(file: BinaryIO) -> str:
    """A path to an open file for libraries that open files by name: the file that was checked, under a plain ASCII name."""
    return path_of(file)


_PFM = re.compile(rb"Pf\s+(\d{1,6})\s+(\d{1,6})\s+(-?[\d.eE+-]{1,20})\s")


def read_pfm(path: Path) -> NDArray[np.float32]:
    """A PFM map, top row first, float32 (h, w); keeps values that are not finite. Raises UserError."""
    with open_file(path) as file:
        found = _PFM.match(file.read(128))
        if not found:
            raise UserError(f"{path}: not a grey PFM file", "a disparity map starts with 'Pf'")
        width, height = int(found[1]), int(found[2])
        there = os.fstat(file.fileno()).st_size - found.end()
        if width * height == 0 or there < 4 * width * height:
            raise UserError(f"{path}: {width}x{height} values claimed, {there // 4} present", "download the file again")
        if 4 * width * height > MAX_MAP_BYTES:
            raise UserError(f"{path}: {width}x{height} values: larger than any view", "check that the file is a disparity map")
        file.seek(found.end())
        body = file.read(4 * width * height)
    order = "<f4" if found[3].startswith(b"-") else ">f4"
    return np.frombuffer(body, order, width * height).reshape(height, width)[::-1].astype(np.float32)
