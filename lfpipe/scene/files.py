"""Untrusted folders: bounded in size, confined to the folder, with precise errors."""

import contextlib
import os
import re
import stat
import unicodedata
from collections.abc import Iterator
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError, quoted
from lfpipe.files.safe_files import TEXT_BYTES, check_links, open_file, open_regular, reason
from lfpipe.files.untrusted import finite
from lfpipe.host.files import proc_fd_path
from lfpipe.host.terminal import opencv_logging

_BEGINNING = re.compile(rb"\xff\xd8\xff|\x89PNG\r\n|GIF8|RIFF....WEBP|....ftypavi[fs]", re.DOTALL)
# twice the files of a light field of 100x100 views
MAX_FILES = 20_000
PICTURES = (
    ".png",
    ".jpg",
    ".jpeg",
    ".ppm",
    ".pgm",
    ".pnm",
    ".bmp",
    ".tif",
    ".tiff",
    ".webp",
    ".avif",
    ".gif",
    ".mpo",
    ".jps",
    *((".heic", ".heif") if find_spec("pillow_heif") else ()),
)
_GIVE = "give a folder of views, or a file that contains them"
_NO_VIEWS = (".thm", ".bak", ".tmp", ".part", "~")  # previews, copies and halves of pictures
_ENDING = re.compile(r"\.(?![0-9]+$)[^./]{1,12}$")
VIDEOS = (".mp4", ".mkv", ".avi", ".mov", ".webm", ".m4v")
HOLDS_ALL = (".npy", ".npz", ".mat", ".h5", ".hdf5", *VIDEOS)  # files that may be scenes


@attrs.frozen(kw_only=True)
class Listing:
    """The content of a path."""

    path: Path
    folder: Path
    names: tuple[str, ...]
    """Files directly in `folder` (one name if the path is a file), numbers in numeric order."""
    folders: tuple[str, ...]
    """Names of subfolders."""
    is_file: bool

    def pictures(self) -> list[str]:
        """Names of picture files."""
        return [name for name in self.names if is_picture(self.folder / name)]

    def file(self, name: str) -> Path:
        """The path of one of the folder's files.

        Raises UserError if it is a link that leads out of the folder.
        """
        if self.folder == self.path:  # otherwise the user gave this file
            check_links(self.folder, [name])
        return self.folder / name


def stem_of(name: str) -> str:
    """A name without its ending, in the normal form that composes letters and accents: file systems
    and programs differ in it. A number after the last dot is no ending.
    """
    return unicodedata.normalize("NFC", _ENDING.sub("", name))


def is_picture(path: Path) -> bool:
    """Whether a file is a picture by its ending, or by its first bytes."""
    name = path.name.lower()
    return name.endswith(PICTURES) or (not name.endswith(_NO_VIEWS) and _begins_as_picture(path))


@lru_cache(maxsize=MAX_FILES)
def _begins_as_picture(path: Path) -> bool:
    """Whether a file begins like a picture whose format no other kind of file shares (raw pictures
    of cameras begin like TIFF).
    """
    with contextlib.suppress(OSError, UserError), open_regular(path) as file:
        return bool(_BEGINNING.match(file.read(12)))
    return False


def natural(name: str) -> list[tuple[int, int, str]]:
    """Sort key that puts view_2 before view_10."""
    return [
        (0, int(part), "") if part.isdecimal() else (1, 0, part)
        for part in re.split(r"(\d+)", unicodedata.normalize("NFC", name))
        if part
    ]


def list_scene(path: str | os.PathLike[str]) -> Listing:
    """Lists a scene's folder or file.

    Raises UserError if it is missing, unreadable or contains too many files.
    """
    given = Path(path)
    where = str(path).replace("\n", r"\n")
    try:
        mode = given.stat().st_mode
        if stat.S_ISREG(mode):
            return Listing(
                path=given, folder=given.parent, names=(given.name,), folders=(), is_file=True
            )
        if not stat.S_ISDIR(mode):
            raise UserError(f"{where}: neither a file nor a folder", _GIVE)
        names, folders = entries(given)
    except FileNotFoundError:
        raise UserError(f"{where}: no such scene", _GIVE) from None
    except OSError as error:
        raise UserError(
            f"{where}: cannot be read: {reason(error)}", "check the path and its permissions"
        ) from None
    except ValueError as error:  # a NUL in the path
        raise UserError(
            f"{quoted(str(given))}: not a path: {error}", "give the folder of the views"
        ) from None
    if not names and not folders:
        raise UserError(f"{where}: the folder is empty", _GIVE)
    return Listing(
        path=given,
        folder=given,
        names=tuple(sorted(names, key=natural)),
        folders=tuple(sorted(folders, key=natural)),
        is_file=False,
    )


def entries(folder: Path) -> tuple[list[str], list[str]]:
    """Names of files and of subfolders; without hidden ones. Raises OSError, UserError."""
    names: list[str] = []
    folders: list[str] = []
    with os.scandir(folder) as found:
        for entry in found:
            if entry.name.startswith("."):
                continue
            inner = False
            with contextlib.suppress(OSError):  # a circular link matters only if it is needed
                inner = entry.is_dir()
            (folders if inner else names).append(entry.name)
            if len(names) + len(folders) > MAX_FILES:
                raise UserError(
                    f"{folder}: more than {MAX_FILES} files; no light field has so many views",
                    "give the folder that contains the views of one scene only",
                )
    return names, folders


@contextlib.contextmanager
def library_errors(path: str | os.PathLike[str]) -> Iterator[None]:
    """Turns errors of decoding libraries, and lack of memory, into UserError; silences OpenCV's
    warnings about the files.
    """
    import cv2  # 30 MB, which a session's supervisor does without

    try:
        with opencv_logging():
            yield
    except MemoryError:
        raise UserError(
            f"{path}: not enough memory to read it", "use smaller or fewer views"
        ) from None
    except cv2.error as error:
        why = (error.err or str(error)).strip().splitlines()[0]
        raise UserError(
            f"{path}: OpenCV cannot read it: {why}", "check its pictures with another program"
        ) from None
    except OSError as error:
        raise UserError(
            f"{path}: cannot be read: {reason(error)}", "check the file and its permissions"
        ) from None


def read_bytes(path: Path, most_bytes: int = TEXT_BYTES) -> bytes:
    """The bytes of a file. Raises UserError as `open_file` does."""
    with open_file(path, most_bytes) as file:
        return file.read()


def read_pfm(path: Path) -> NDArray[np.float32]:
    """A PFM map, top row first, float32 (h, w); keeps NaN and infinity.

    Raises UserError.
    """
    import cv2

    with open_file(path) as file:
        header = file.read(100).split()  # Pf, width, height, scale: its sign is the byte order
        values = cv2.imread(proc_fd_path(file), cv2.IMREAD_UNCHANGED)
    scale = finite(header[3].decode("latin-1")) if len(header) > 3 else None
    if scale is None or values is None or values.dtype != np.float32 or values.ndim != 2:
        raise UserError(f"{path}: not a readable PFM map of one plane", "download the file again")
    return np.asarray(values, np.float32) * np.float32(abs(scale))  # which OpenCV divides by
