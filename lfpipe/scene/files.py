"""Looking into folders and pictures that somebody else made: bounded, inside the folder, and clear about what is wrong."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError

MAX_FILES = 20_000  # a light field of 100x100 views is half of this; beyond it the folder is something else
MAX_PIXELS = 1 << 28  # of one picture; a 16k x 16k mosaic
PICTURES = (".png", ".jpg", ".jpeg", ".ppm", ".pgm", ".pnm", ".bmp", ".tif", ".tiff", ".webp")
VIDEOS = (".mp4", ".mkv", ".avi", ".mov", ".webm", ".m4v")


@attrs.frozen
class Listing:
    """What stands at a path: `names` are the files directly in `folder` (one name where the path is a file), sorted
    with numbers in numeric order; `folders` are the names of its subfolders."""

    path: Path
    folder: Path
    names: tuple[str, ...]
    folders: tuple[str, ...]
    is_file: bool

    def pictures(self) -> list[str]:
        """Names of picture files."""
        return [name for name in self.names if name.lower().endswith(PICTURES)]

    def file(self, name: str) -> Path:
        """The path of one of the folder's files. Raises UserError where it is a link that leads out of the folder."""
        path = self.folder / name
        if path.is_symlink() and not path.resolve().is_relative_to(self.folder.resolve()):
            raise UserError(f"{path}: a link that leads out of the folder, to {path.resolve()}", "copy the file into the folder")
        return path


_GAP = rb"\s+(?:#[^\n]*\n\s*)*"
_PNM = re.compile(rb"P[256]" + _GAP + rb"(\d{1,9})" + _GAP + rb"(\d{1,9})" + _GAP + rb"(\d{1,9})\s")


def natural(name: str) -> list[tuple[int, int, str]]:
    """Sort key that puts view_2 before view_10."""
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in re.split(r"(\d+)", name) if part]


def look(path: str | os.PathLike[str]) -> Listing:
    """List a scene's folder or file. Raises UserError where there is none, it cannot be read or holds too many files."""
    given = Path(path)
    try:
        if given.is_file():
            return Listing(given, given.parent, (given.name,), (), True)
        if not given.is_dir():
            raise UserError(f"{given}: no such scene", "give the folder of the views, or the file that holds them")
        names: list[str] = []
        folders: list[str] = []
        with os.scandir(given) as entries:
            for entry in entries:
                if entry.name.startswith("."):
                    continue
                (folders if entry.is_dir() else names).append(entry.name)
                if len(names) + len(folders) > MAX_FILES:
                    raise UserError(
                        f"{given}: more than {MAX_FILES} files, no light field has so many views",
                        "give the folder that holds the views of one scene only",
                    )
    except OSError as error:
        raise UserError(f"{given}: cannot be read: {error.strerror}", "check the path and its permissions") from None
    except ValueError as error:  # a NUL in the path
        raise UserError(f"{str(given)!r}: not a path: {error}", "give the folder of the views") from None
    if not names and not folders:
        raise UserError(f"{given}: the folder is empty", "give the folder of the views, or the file that holds them")
    return Listing(given, given, tuple(sorted(names, key=natural)), tuple(sorted(folders, key=natural)), False)


def read_bytes(path: Path) -> bytes:
    """The file's bytes. Raises UserError."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}", "check the file and its permissions") from None


def _header(data: bytes) -> tuple[int, int, int] | None:
    """(width, height, maximal value) that a PNG or PNM file claims, or None for other kinds."""
    if data[:8] == b"\x89PNG\r\n\x1a\n" and len(data) > 25:
        return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big"), (1 << min(data[24], 16)) - 1
    pnm = _PNM.match(data[:512])
    return (int(pnm[1]), int(pnm[2]), int(pnm[3])) if pnm else None


def read_picture(path: Path) -> tuple[NDArray[Any], int]:
    """A picture's own values and the value that stands for full: ((h, w) or (h, w, 3) RGB, uint8 or uint16, max_value).

    The depth of the file is kept (a 10-bit PPM holds 0..1023; OpenCV's usual read would shift it to 0..3). An alpha
    plane is left out. Raises UserError where the file is truncated, no picture, or of more than MAX_PIXELS.
    """
    data = read_bytes(path)
    header = _header(data)
    if header and header[0] * header[1] > MAX_PIXELS:
        raise UserError(f"{path}: claims {header[0]}x{header[1]} px, more than {MAX_PIXELS} px", "is this file really a picture?")
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    except cv2.error:
        pixels = None
    if pixels is None or pixels.dtype not in (np.uint8, np.uint16) or pixels.ndim not in (2, 3):
        raise UserError(f"{path}: not a readable picture (truncated, damaged or another format)", "fetch or export it again")
    if pixels.ndim == 3:
        pixels = pixels[:, :, 0] if pixels.shape[2] < 3 else cv2.cvtColor(pixels[:, :, :3], cv2.COLOR_BGR2RGB)
    full = 255 if pixels.dtype == np.uint8 else 65535
    if header and header[2] > 1 and data[:1] == b"P":
        full = header[2]
        if (pixels.dtype == np.uint8) != (full < 256):
            raise UserError(f"{path}: says values up to {full} but was read as {pixels.dtype}", "export it as PNG")
    return pixels, full


def read_pfm(path: Path) -> NDArray[np.float32]:
    """A PFM map, top row first, float32 (h, w); values that are not finite stay as they are. Raises UserError."""
    data = read_bytes(path)
    found = re.match(rb"Pf\s+(\d{1,6})\s+(\d{1,6})\s+(-?[\d.eE+-]{1,20})\s", data[:128])
    if not found:
        raise UserError(f"{path}: not a grey PFM file", "a disparity map starts with 'Pf'")
    width, height = int(found[1]), int(found[2])
    body = data[found.end() :]
    if width * height == 0 or len(body) < 4 * width * height:
        raise UserError(f"{path}: {width}x{height} values promised, {len(body) // 4} there", "fetch the file again")
    order = "<f4" if found[3].startswith(b"-") else ">f4"
    return np.frombuffer(body, order, width * height).reshape(height, width)[::-1].astype(np.float32)
