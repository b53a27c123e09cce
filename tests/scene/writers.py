"""Scenes as people and programs keep them: each function gives one that writes such a scene into an
empty folder, and returns the path to open.
"""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tests.scene import made
from tests.support.films import write_film

Pictures = NDArray[np.uint8]
Make = Callable[[Path], Path]
HCI = "input_Cam{n:03d}.png"


def walk(grid: Pictures, order: str = "rows") -> list[Pictures]:
    """The views of a grid row by row; or "cols"."""
    if order == "cols":
        return [view for col in grid.swapaxes(0, 1) for view in col]
    return [view for row in grid for view in row]


def grid(
    views: NDArray[Any], name: str = "view_{r:02d}_{c:02d}.png", *gone: str, **texts: str
) -> Make:
    """One file per view, but those that are gone, and texts beside them; the last `_` of their
    names stands for the dot.
    """

    def make(folder: Path) -> Path:
        made.without(made.write_grid(folder, views, name), *gone)
        for key, text in texts.items():
            (folder / ".".join(key.rsplit("_", 1))).write_text(text)
        return folder

    return make


def files(**pictures: NDArray[Any]) -> Make:
    """Pictures in a folder; `__` stands for a slash and the last `_` for the dot."""

    def make(folder: Path) -> Path:
        for key, picture in pictures.items():
            made.write(folder / ".".join(key.replace("__", "/").rsplit("_", 1)), picture)
        return folder

    return make


def one(name: str, content: NDArray[Any] | bytes, size: tuple[int, int] | None = None) -> Make:
    """A file: a picture, which may be made smaller, or bytes."""

    def make(folder: Path) -> Path:
        path = folder / name
        if isinstance(content, bytes):
            path.write_bytes(content)
            return path
        smaller = cv2.resize(content, size, interpolation=cv2.INTER_AREA) if size else content
        return made.write(path, smaller)

    return make


def numbered(frames: Iterable[NDArray[Any]], name: str = "frame_{:03d}.png") -> Make:
    def make(folder: Path) -> Path:
        for number, frame in enumerate(frames):
            made.write(folder / name.format(number), frame)
        return folder

    return make


def gif(frames: Iterable[Pictures], name: str = "walk.gif") -> Make:
    def make(folder: Path) -> Path:
        pictures = [Image.fromarray(f).quantize(255, Image.Quantize.FASTOCTREE) for f in frames]
        pictures[0].save(folder / name, save_all=True, append_images=pictures[1:], duration=80)
        return folder / name

    return make


def film(frames: Iterable[Pictures], name: str = "walk.mp4", codec: str = "mp4v") -> Make:
    """A video of RGB frames at 12 Hz."""
    bgr = [cv2.cvtColor(frame, cv2.COLOR_RGB2BGR) for frame in frames]
    return lambda folder: write_film(folder / name, bgr, codec, 12.0)


def array(values: NDArray[np.generic], name: str = "scene.npy") -> Make:
    def make(folder: Path) -> Path:
        np.save(folder / name, values)
        return folder / name

    return make


def together(*makes: Callable[[Path], object]) -> Make:
    """All of them in one folder, which is given."""

    def make_all(folder: Path) -> Path:
        for make in makes:
            make(folder)
        return folder

    return make_all


def below(name: str, make: Callable[[Path], object]) -> Make:
    def inner(folder: Path) -> Path:
        (folder / name).mkdir(parents=True, exist_ok=True)
        make(folder / name)
        return folder

    return inner


def h5(
    values: NDArray[Any],
    name: str = "lf.h5",
    key: str = "LF",
    depth: NDArray[Any] | None = None,
    **options: Any,
) -> Make:
    """An HDF5 file with the attributes of the old HCI sets; depth: of each view, the same."""

    def make(folder: Path) -> Path:
        with h5py.File(folder / name, "w", userblock_size=512) as file:
            file.create_dataset(key, data=values, **options)
            file.attrs.update({"dH": 0.5, "focalLength": 20.0, "shift": 3.0})
            if depth is not None:
                file["GT_DEPTH"] = np.broadcast_to(depth, (*values.shape[:2], *depth.shape))
        return folder / name

    return make


def stanford(
    views: NDArray[Any],
    name: str = "out_{r:02d}_{c:02d}_{y:.6f}_{x:.6f}_.png",
    y_mm: float = -8.5,
    x_mm: float = -8.6,
    turned: bool = False,
) -> Make:
    """Views in the order of their names, with camera coordinates that grow by y_mm and x_mm.

    turned: the first number of a name is the column.
    """

    def make(folder: Path) -> Path:
        for r, c in np.ndindex(views.shape[:2]):
            down, across = (c, r) if turned else (r, c)
            at = {"y": y_mm * down - 300, "x": x_mm * across + 1100}
            made.write(folder / name.format(r=r, c=c, **at), views[r, c])
        return folder

    return make
