"""A scene on disk: its untrusted files (bounded in size, confined to their folder, with precise
errors), and what a layout makes of them, before it is reordered or packed.
"""

import contextlib
import os
import re
import stat
import unicodedata
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.safe_files import TEXT_BYTES, check_links, finite, open_file, open_regular, reason
from lfpipe.host.files import proc_fd_path
from lfpipe.host.terminal import opencv_logging

Progress = Callable[[str, int, int], None]  # (task, steps done, steps in total)
ViewIndex = tuple[int, int]  # (row, column)
_BEGINNING = re.compile(rb"\xff\xd8\xff|\x89PNG\r\n|GIF8|RIFF....WEBP|....ftypavi[fs]", re.DOTALL)
# twice the files of a light field of 100x100 views
MAX_FILES = 20_000
# levels of folders below a folder without pictures, and of those that hold a playlist
DEEPEST = 2
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
    place = Path(path)
    where = str(path).replace("\n", r"\n")
    try:
        mode = place.stat().st_mode
        if stat.S_ISREG(mode):
            return Listing(
                path=place, folder=place.parent, names=(place.name,), folders=(), is_file=True
            )
        if not stat.S_ISDIR(mode):
            raise UserError(f"{where}: neither a file nor a folder", _GIVE)
        names, folders = entries(place)
    except FileNotFoundError:
        raise UserError(f"{where}: no such scene", _GIVE) from None
    except (OSError, ValueError) as error:  # a NUL in the path
        raise UserError(
            f"{where}: cannot be read: {reason(error)}", "check the path and its permissions"
        ) from None
    if not names and not folders:
        raise UserError(f"{where}: the folder is empty", _GIVE)
    return Listing(
        path=place,
        folder=place,
        names=tuple(sorted(names, key=natural)),
        folders=tuple(sorted(folders, key=natural)),
        is_file=False,
    )


def entries(folder: Path) -> tuple[list[str], list[str]]:
    """Names of files and of subfolders; without hidden ones. Raises OSError, UserError."""
    names: list[str] = []
    folders: list[str] = []
    with os.scandir(folder) as scan:
        for entry in scan:
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


@attrs.frozen
class Geometry:
    """Parameters of the capture; None if the source does not state them."""

    baseline_mm: float | None = None
    focus_distance_mm: float | None = None
    focal_length_px: float | None = None  # of a stored view


@attrs.frozen
class GridTransform:
    """The transform from file order to canonical order: transpose first, then reverse rows and
    columns.
    """

    rows: bool = False
    cols: bool = False
    transpose: bool = False

    def file_index(self, row: int, col: int, rows: int, cols: int) -> tuple[int, int]:
        """The file index of the canonical view (row, col); rows, cols: the canonical grid."""
        row = rows - 1 - row if self.rows else row
        col = cols - 1 - col if self.cols else col
        return (col, row) if self.transpose else (row, col)

    def applied(self, grid: NDArray[Any]) -> NDArray[Any]:
        """Values by file index, (rows, cols, ...), in canonical order."""
        grid = grid.swapaxes(0, 1) if self.transpose else grid
        return grid[:: -1 if self.rows else 1, :: -1 if self.cols else 1]

    def grid(self, rows: int, cols: int) -> tuple[int, int]:
        """The canonical (rows, cols) of a file grid, and vice versa."""
        return (cols, rows) if self.transpose else (rows, cols)


@attrs.frozen(eq=False, kw_only=True)
class SceneSource:
    """A scene on disk as its layout describes it. Rows and columns are in file order."""

    layout: str
    path: Path
    files: tuple[Path, ...]  # every file that `read` and `truth` read, for the content key
    rows: int
    cols: int
    read: Callable[[int, int, int], NDArray[Any]]
    """(frame, row, col) -> a view, (h, w) or (h, w, 3) RGB, uint8 or uint16 up to max_value.
    Thread-safe. Raises UserError that names the file."""
    height_px: int
    width_px: int
    max_value: int = 255
    small: Callable[[int, int, float], NDArray[np.uint8]] | None = None
    """(row, col, px) -> a view in grey, uint8 (h, w), of at least that many px if available; faster
    than `read`"""
    frames: int = 1
    frame_rate_hz: float = 0.0
    telling: int = 0  # the frame that is analysed: the first one may be black
    missing: frozenset[tuple[int, int]] = frozenset()  # grid indices without a view
    turn: GridTransform | None = None
    """to canonical order, if the layout or camera coordinates define it"""
    turn_by: str = ""  # what defines `turn`
    turn_firm: bool = True  # False: clear optical flow overrides `turn`
    coordinates: NDArray[np.float64] | None = None
    """(rows, cols, 2): camera positions, (down, right) in any one unit"""
    truth: Mapping[tuple[int, int], Callable[[], NDArray[np.float32]]] = attrs.field(factory=dict)
    """true disparity by file index: functions that read float32 (h, w), px per canonical grid step,
    positive: nearer. They are valid with `turn`."""
    rendered: bool = False  # views and truth are computed from one picture: no check, no estimate
    geometry: Geometry = attrs.field(factory=Geometry)
    linear: bool = False  # the values are linear light
    doubt: str = ""  # any ambiguity of the layout
    stated_inverted: bool | None = None  # scene.invert_depth in `lightfield.toml`; None: "auto"
    certain: bool = True  # the format defines a light field; False: names or pictures suggest it
    notes: tuple[str, ...] = ()  # for people, one sentence each
    playlist: tuple[Path, ...] = ()  # scenes beside each other, of which this is the first

    @property
    def places(self) -> list[ViewIndex]:
        """The indices of present views, row by row."""
        return [place for place in np.ndindex(self.rows, self.cols) if place not in self.missing]

    @property
    def middle(self) -> ViewIndex:
        """The present view closest to the middle of the grid."""
        return min(
            self.places,
            key=lambda place: abs(place[0] - self.rows // 2) + abs(place[1] - self.cols // 2),
        )


@attrs.frozen
class Layout:
    """A format of light fields. A module that defines these three names is a layout, too."""

    NAME: str  # value of `--layout`
    detect: Callable[[Listing], int | None]
    """Specificity of the match, from names and one picture: 90 for a format that identifies itself,
    50 for a pattern of names, 10 for a last resort; None for no match."""
    describe: Callable[[Listing, config.Scene], SceneSource]
    """The scene, by the user's settings. Raises UserError."""
