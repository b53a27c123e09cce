"""Pictures with their camera poses in a `transforms*.json`, as NeRF programs write it: a line or a
grid of cameras that look the same way. Names are not read; programs number at random.

`transform_matrix` is camera to world: columns right, up, backwards and position:
https://github.com/NVlabs/instant-ngp/blob/master/docs/nerf_dataset_tips.md
Poses without a picture are holes of the grid, pictures without a pose are not used.
"""

import contextlib
from collections.abc import Iterable, Iterator
from functools import lru_cache
from itertools import takewhile

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.untrusted import json_fields
from lfpipe.scene.files import MAX_FILES, Listing, read_bytes, stem_of
from lfpipe.scene.layouts._folders import subfolders
from lfpipe.scene.layouts._grid import FULL, placed_views, some
from lfpipe.scene.layouts._names import is_map
from lfpipe.scene.layouts.arrays import LARGEST
from lfpipe.scene.source import GridTransform, SceneSource, ViewIndex

NAME = "poses"
_MAX_BYTES = 1 << 24  # of a thousand poses with more digits than a double has
_ALIGNED = 0.1  # deviation from a row or column, and in depth, over the extent of all cameras
_ALIKE = 0.97  # cosine between viewing directions: 14 degrees
_REMEDY = "move it away to have the pictures ordered by name"


def pose_files(listing: Listing) -> list[str]:
    """The names of a folder's files of poses."""
    named = [n for n in listing.names if n.startswith("transforms") and n.endswith(".json")]
    return [] if listing.is_file else named


def _poses(listing: Listing) -> dict[str, NDArray[np.float64]]:
    """Camera-to-world matrices (3, 4) by the path that the files state, without entries that are
    none. Raises UserError for a file that is no list of poses.
    """
    found: dict[str, NDArray[np.float64]] = {}
    for file in pose_files(listing):
        fields = json_fields(read_bytes(listing.file(file), _MAX_BYTES), file, _REMEDY)
        if not isinstance(frames := fields.values.get("frames"), list):
            raise UserError(f"{file} is not a list of poses", _REMEDY)
        for frame in frames[:MAX_FILES]:
            with contextlib.suppress(KeyError, TypeError, ValueError, AttributeError):
                matrix = np.array(frame["transform_matrix"], np.float64)[:3].reshape(3, 4)
                if np.abs(matrix).max() < LARGEST:
                    found[frame["file_path"].replace("\\", "/")] = matrix
    return found


def _below(listing: Listing, deepest: int = 2) -> Iterator[str]:
    """The names of pictures, with their folders."""
    yield from listing.pictures()
    for folder, inner in subfolders(listing).items() if deepest else ():
        yield from (f"{folder}/{name}" for name in _below(inner, deepest - 1))


def _pictures(listing: Listing, stated: Iterable[str]) -> dict[str, str]:
    """The stated path of each picture that has one. Paths may be those of another machine, with
    another ending or none: of pictures with that name, the one whose folders agree.
    """
    by_stem: dict[str, list[str]] = {}
    for name in _below(listing):
        by_stem.setdefault(stem_of(name.rpartition("/")[2]).lower(), []).append(name)
    found = {}
    for path in stated:
        *folders, last = path.split("/")

        def alike(
            name: str, folders: list[str] = folders, last: str = last
        ) -> tuple[int, bool, bool]:
            ends = zip(name.split("/")[-2::-1], folders[::-1], strict=False)
            same = len([*takewhile(lambda both: both[0] == both[1], ends)])
            return same, not is_map(name), name.endswith(last)

        if names := by_stem.get(stem_of(last).lower()):
            found[max(names, key=alike)] = path
    return found


@lru_cache(maxsize=2)
def _places(listing: Listing) -> tuple[dict[str, ViewIndex], NDArray[np.float64], str]:
    """(grid index, position (down, right)) of each camera, and why there are none, "" if there are
    some: they form neither a line nor a grid, or look in different directions.
    """
    nothing = np.zeros((0, 2))
    try:
        poses = _poses(listing)
    except UserError as error:
        return {}, nothing, error.message
    names = _pictures(listing, poses)
    cameras = np.array([poses[path] for path in names.values()]).reshape(-1, 3, 4)
    if len(cameras) < 3:
        return {}, nothing, f"{len(cameras)} of its {len(poses)} poses have a picture here"
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
    if not (cameras[:, :, 2] @ back).min() > _ALIKE:
        return {}, nothing, "its cameras look in different directions"
    size = (rows.max() + 1) * (cols.max() + 1)
    if len(set(indices)) < len(indices) or len(indices) < FULL * size or deep > _ALIGNED * extent:
        return {}, nothing, "its cameras form neither a line nor a grid"
    return dict(zip(names, indices, strict=True)), at[:, :2], ""


def _steps(values: NDArray[np.float64], extent: float) -> NDArray[np.intp]:
    """The row (or column) of each camera: gaps of more than half the largest separate them."""
    order = np.argsort(values)
    gaps = np.diff(values[order])
    steps = np.zeros(len(values), np.intp)
    if np.ptp(values) > _ALIGNED * extent:
        steps[order[1:]] = np.cumsum(gaps > gaps.max() / 2)
    return steps


def unused_poses(listing: Listing) -> list[str]:
    """A note of why a folder's poses are not used; [] if it has none."""
    files = pose_files(listing)
    why = _places(listing)[2] if files else ""
    return [f"{files[0]} is not used: {why}"] if why else []


def detect(listing: Listing) -> int | None:
    return 85 if pose_files(listing) and _places(listing)[0] else None


def describe(listing: Listing, scene: config.Scene) -> SceneSource:
    places, at, why = _places(listing)
    if not places:
        raise UserError(
            f"{listing.path}: no transforms.json with cameras along a line or over a grid: {why}",
            "leave out scene.layout",
        )
    source = placed_views(NAME, listing, places)
    positions = np.full((source.rows, source.cols, 2), np.nan)
    for place, position in zip(places.values(), at, strict=True):
        positions[place] = position
    others = [name for name in _below(listing) if name not in places and not is_map(name)]
    return attrs.evolve(
        source,
        files=(*source.files, *map(listing.file, pose_files(listing))),
        coordinates=positions,
        turn=GridTransform(),
        turn_firm=False,  # some programs write other axes
        turn_by="camera poses",
        notes=(
            "placed by the poses in " + some(pose_files(listing)),
            *([f"without a pose, not used: {some(others)}"] if others else ()),
            *source.notes,
        ),
    )
