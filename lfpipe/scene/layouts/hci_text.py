"""The first HCI data set as exported to text and pictures: lf/XX_YY.png, attributes.dat, depth.bin.

Wanner, Meister, Goldluecke, "Datasets and Benchmarks for Densely Sampled 4D Light Fields", VMV 2013.
"""

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.untrusted import in_range
from lfpipe.scene.files import Listing, list_scene, read_bytes
from lfpipe.scene.layouts._grid import MAX_SIDE, files_source, named_grid, require_whole
from lfpipe.scene.source import SceneSource, Turn

NAME = "hci-text"
_VIEW = re.compile(r"(\d{1,3})_(\d{1,3})\.(?:png|jpe?g|ppm)", re.IGNORECASE)

_USED, _MOST = ("dH", "focalLength", "shift", "hRes", "vRes"), 1e9


def detect(listing: Listing) -> int | None:
    return 92 if "attributes.dat" in listing.names and "lf" in listing.folders else None


def attributes(text: str) -> dict[str, float]:
    """`value //name` lines by name; lines of another form are passed over."""
    found: dict[str, float] = {}
    for line in text.splitlines():
        value, sign, name = line.partition("//")
        if sign and name.split():
            try:
                found[name.split()[0]] = float(value)
            except ValueError:
                continue
    return found


def require_plausible(known: Mapping[str, float], path: Path) -> None:
    """Raises UserError where one of the attributes that are used here is not finite or out of range."""
    for name in _USED:
        in_range(known.get(name, 0.0), -_MOST, _MOST, f"{path}: {name}", "fetch the scene again, or correct the value")


def disparity_of_depth(depth: NDArray[np.float32], d_h: float, focal: float, shift: float) -> NDArray[np.float32]:
    """Disparity in px per view of the first HCI data set's depth: dH * focalLength / depth - shift."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.asarray(np.float32(d_h * focal) / depth - np.float32(shift), np.float32)


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    if "attributes.dat" not in listing.names or "lf" not in listing.folders:
        raise UserError(f"{listing.path}: no attributes.dat next to a folder lf/", "give the folder that contains both")
    known = attributes(read_bytes(listing.file("attributes.dat")).decode("utf-8", "replace"))
    require_plausible(known, listing.folder / "attributes.dat")
    inner = list_scene(listing.file("lf"))
    pairs = {(int(found[1]), int(found[2])): name for name in inner.names if (found := _VIEW.fullmatch(name))}
    if not pairs:
        raise UserError(f"{inner.path}: no views ROW_COLUMN.png", "download the scene again")
    files, rows, cols = named_grid(pairs, inner)
    said = known.get("vRes", rows), known.get("hRes", cols)
    if said != (rows, cols) and all(1 <= n <= MAX_SIDE for n in said):
        rows, cols = int(said[0]), int(said[1])
    require_whole(inner, files, rows, cols, next(iter(pairs.values())))
    truth, extra = {}, [listing.file("attributes.dat")]
    source = files_source(NAME, listing, files, rows, cols)
    size = source.height_px, source.width_px
    if "depth.bin" in listing.names:
        extra.append(depth_file := listing.file("depth.bin"))

        def read_truth() -> NDArray[np.float32]:
            data = read_bytes(depth_file, max(4 * size[0] * size[1], 1 << 20))
            if len(data) != 4 * size[0] * size[1]:
                raise UserError(
                    f"{depth_file}: {len(data)} bytes, {4 * size[0] * size[1]} expected of {size[1]}x{size[0]} float32",
                    "fetch it again, or move it away",
                )
            depth = np.frombuffer(data, "<f4").reshape(size).astype(np.float32)
            focal = known.get("focalLength", 0.0)
            return disparity_of_depth(depth, known.get("dH", 0.0), focal, known.get("shift", 0.0)) if focal else depth

        truth[rows // 2, cols // 2] = read_truth
    return files_source(
        NAME, listing, files, rows, cols, truth=truth, extra_files=tuple(extra),
        turn=Turn(), turn_by="this export counts rows from the top and columns from the left",
    )  # fmt: skip
