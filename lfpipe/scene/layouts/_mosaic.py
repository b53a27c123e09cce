"""Many views in one picture: loads the pictures and divides them as the user says, or as is detected."""

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import open_header, read_picture
from lfpipe.scene.files import Listing
from lfpipe.scene.layouts._grid import parse_grid
from lfpipe.scene.layouts._tile_detection import detect_quilt, find_tiles
from lfpipe.scene.layouts._tiling import UNEVEN, Tiling

_LARGE_BYTES = 64_000_000  # of a picture


class LastPictures:
    """A cache of the last two pictures by frame number (one if they are large), for readers in several threads."""

    def __init__(self, load: Callable[[int], NDArray[Any]]) -> None:
        self._load = load
        self._lock = threading.Lock()
        self._kept: dict[int, NDArray[Any]] = {}

    def __call__(self, frame: int) -> NDArray[Any]:
        with self._lock:
            if frame not in self._kept:
                while self._kept and (len(self._kept) > 1 or next(iter(self._kept.values())).nbytes > _LARGE_BYTES):
                    del self._kept[min(self._kept)]
                self._kept[frame] = self._load(frame)
            return self._kept[frame]


def single_picture(listing: Listing) -> Path | None:
    """The picture of a scene of one picture: the given file, or the only picture of the folder."""
    pictures = listing.pictures()
    return listing.file(pictures[0]) if len(pictures) == 1 else None


def tiling(picture: NDArray[Any], path: Path, scene: config.Scene) -> Tiling | None:
    """The tiling of the picture at path: from scene.grid, else detected. Raises UserError if scene.grid does not divide it."""
    height, width = picture.shape[:2]
    grid, found = parse_grid(scene.grid), find_tiles(picture, f"{path.parent.name}/{path.stem}")
    if grid is not None and (found is None or found.shape != grid):
        if (height % grid[0] or width % grid[1]) and UNEVEN.get((width, height)) != grid[::-1]:
            raise UserError(
                f"{path}: {width}x{height} px do not divide into {grid[0]} rows and {grid[1]} columns of tiles",
                "give the grid that was rendered with --set scene.grid=ROWSxCOLS",
            )
        return Tiling.even(picture, *grid)
    return detect_quilt(picture, found) if grid is None and found is not None else found


def picture_loader(paths: list[Path]) -> LastPictures:
    """Pictures by frame number. Raises UserError if their sizes differ, and on reading a damaged one."""
    headers = [open_header(path) for path in paths]
    sizes = [f"{header.width_px}x{header.height_px}" for header in headers]
    for path, size in zip(paths, sizes, strict=True):
        if size != sizes[0]:
            what = f"{path}: {size} px, {paths[0].name} has {sizes[0]}"
            raise UserError(what, "all frames of a light-field video must have the same size")
    return LastPictures(lambda frame: read_picture(paths[frame], headers[frame])[0])
