"""Pictures with their camera poses in a `transforms*.json`, as NeRF programs write it: a line or a
grid of cameras that look the same way. Names are not read; programs number at random.

`transform_matrix` is camera to world: columns right, up, backwards and position:
https://github.com/NVlabs/instant-ngp/blob/master/docs/nerf_dataset_tips.md
"""

from functools import lru_cache

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.untrusted import json_fields
from lfpipe.host.files import is_file
from lfpipe.scene.files import MAX_FILES, PICTURES, Listing, read_bytes
from lfpipe.scene.layouts._grid import placed_views
from lfpipe.scene.source import GridTransform, SceneSource, ViewIndex

NAME = "poses"
_MAX_BYTES = 1 << 24  # of a thousand poses with more digits than a double has
_ALIGNED = 0.1  # deviation from a row or column, and in depth, over the extent of all cameras
_ALIKE = 0.97  # cosine between viewing directions: 14 degrees
_REMEDY = "move it away to have the pictures ordered by name"


def _files(listing: Listing) -> list[str]:
    named = [n for n in listing.names if n.startswith("transforms") and n.endswith(".json")]
    return [] if listing.is_file else named


def _poses(listing: Listing) -> dict[str, NDArray[np.float64]]:
    """Camera-to-world matrices (3, 4) by name; {} without one valid file, or if a picture is
    missing.
    """
    found: dict[str, NDArray[np.float64]] = {}
    try:
        (file,) = _files(listing)
        read = json_fields(read_bytes(listing.file(file), _MAX_BYTES), file, _REMEDY)
        for frame in read.values["frames"][:MAX_FILES]:
            stem = frame["file_path"].replace("\\", "/").removeprefix("./")
            ends = ("", *PICTURES)
            name = next(stem + end for end in ends if is_file(listing.file(stem + end)))
            found[name] = np.array(frame["transform_matrix"], np.float64)[:3].reshape(3, 4)
    except (UserError, KeyError, TypeError, ValueError, AttributeError, StopIteration):
        return {}
    return found


@lru_cache(maxsize=2)
def _places(listing: Listing) -> tuple[dict[str, ViewIndex], NDArray[np.float64]]:
    """(grid index, position (down, right)) of each camera; ({}, ...) if they form neither a line
    nor a grid, or look in different directions.
    """
    poses = _poses(listing)
    cameras = np.array(list(poses.values())).reshape(-1, 3, 4)
    if len(cameras) < 3:
        return {}, np.zeros((0, 2))
    right, up, back = cameras[:, :, :3].mean(axis=0).T
    at = cameras[:, :, 3] @ np.stack((-up, right, back), axis=1)
    down, across, deep = np.ptp(at, axis=0).tolist()
    extent = max(down, across)
    rows, cols = (_steps(at[:, axis], extent) for axis in (0, 1))
    if not rows.any() or not cols.any():  # a line: steps may differ
        rows, cols = (
            np.argsort(np.argsort(at[:, k])) * used.any() for k, used in ((0, rows), (1, cols))
        )
    indices = list(zip(rows.tolist(), cols.tolist(), strict=True))
    whole = len(set(indices)) == len(indices) == (rows.max() + 1) * (cols.max() + 1)
    same_way = (cameras[:, :, 2] @ back).min() > _ALIKE
    fits = np.isfinite(at).all() and whole and same_way and deep <= _ALIGNED * extent
    return dict(zip(poses, indices, strict=True)) if fits else {}, at[:, :2]


def _steps(values: NDArray[np.float64], extent: float) -> NDArray[np.intp]:
    """The row (or column) of each camera: gaps of more than half the largest separate them."""
    order = np.argsort(values)
    gaps = np.diff(values[order])
    steps = np.zeros(len(values), np.intp)
    if np.ptp(values) > _ALIGNED * extent:
        steps[order[1:]] = np.cumsum(gaps > gaps.max() / 2)
    return steps


def detect(listing: Listing) -> int | None:
    return 85 if _places(listing)[0] else None


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    places, at = _places(listing)
    if not places:
        raise UserError(
            f"{listing.path}: no transforms.json with cameras along a line or over a grid",
            "leave out scene.layout",
        )
    source = placed_views(NAME, listing, places)
    positions = np.empty((source.rows, source.cols, 2))
    for place, position in zip(places.values(), at, strict=True):
        positions[place] = position
    return attrs.evolve(
        source,
        files=(*source.files, *map(listing.file, _files(listing))),
        coordinates=positions,
        turn=GridTransform(),
        turn_firm=False,  # some programs write other axes
        turn_by="camera poses",
    )
