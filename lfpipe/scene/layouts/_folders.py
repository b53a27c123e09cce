"""Scenes whose pictures are in subfolders of the given folder: one folder per row, or all in the
only folder with pictures.
"""

import contextlib
from collections.abc import Mapping

import attrs

from lfpipe.errors import UserError
from lfpipe.scene.layouts._grid import some
from lfpipe.scene.layouts._names import (
    NO_SCENE,
    camera_of,
    eye_pairs,
    is_map,
    pairs,
    read_names,
    words,
)
from lfpipe.scene.source import Listing, list_scene

MOST_CAMERAS = 4  # that recorded side by side, of which two are a pair; more are a row
# levels of folders below a folder without pictures, and of those that hold a playlist
DEEPEST = 2


def inner_listing(listing: Listing, deepest: int = DEEPEST) -> Listing | None:
    """The pictures in subfolders, as names with a slash or as the only inner folder; None if there
    are none, or no more than in the folder itself. Raises UserError if the subfolders are separate
    scenes.
    """
    inner = _with_pictures(listing)
    if not inner and deepest and not listing.is_file:
        below = (inner_listing(one, deepest - 1) for one in subfolders(listing).values())
        return next(filter(None, below), None)
    pair = paired(inner)
    if not pair and (len(inner) > 1 or listing.pictures()):
        inner = {
            name: one
            for name, one in inner.items()
            if not is_map(name) and not NO_SCENE.search(words(name))
        }
        pair = paired(inner)
    if pair:
        inner = {name: inner[name] for name in pair}
    names = tuple(f"{folder}/{name}" for folder, one in inner.items() for name in one.pictures())
    if len(names) <= len(listing.pictures()):
        return None
    if len(inner) == 1:
        return next(iter(inner.values()))
    if not _are_parts(inner):
        most = max(inner, key=lambda name: len(inner[name].pictures()))
        raise UserError(
            f"{listing.path}: pictures are in {len(inner)} folders: {', '.join(list(inner)[:4])}",
            f"give one of them, {listing.path / most}; if the folders are rows of one scene, name"
            " them row_01, row_02",
        )
    return attrs.evolve(listing, names=names, folders=())


def subfolders(listing: Listing) -> dict[str, Listing]:
    """The readable subfolders, by name."""
    found = {}
    for name in () if listing.is_file else listing.folders:
        with contextlib.suppress(UserError):
            found[name] = list_scene(listing.file(name))
    return found


def _with_pictures(listing: Listing, deepest: int = DEEPEST) -> dict[str, Listing]:
    """The subfolders with pictures, by name; one without pictures is replaced by the only one in it
    that has some: cam0/data beside cam0/sensor.yaml.
    """
    found = {}
    for name, one in subfolders(listing).items():
        below = {} if one.pictures() or not deepest else _with_pictures(one, deepest - 1)
        if one.pictures():
            found[name] = one
        elif len(below) == 1:
            found |= {f"{name}/{path}": inner for path, inner in below.items()}
    return found


def paired(inner: Mapping[str, Listing]) -> list[str]:
    """The first two folders that belong together by their words: of the left eye and of the right
    one, of two cameras with pictures of the same names, of colour and of depth; [] if there are
    none.
    """
    pictures = [name for name in inner if not is_map(name)]
    cameras = {number: name for name in pictures for number in camera_of(name)}
    beside = [
        (name, cameras[word, number + 1])
        for (word, number), name in cameras.items()
        if (word, number + 1) in cameras
        and inner[name].names == inner[cameras[word, number + 1]].names
    ]
    row = len(cameras) > MOST_CAMERAS and len({word for word, _ in cameras}) == 1
    found = [*eye_pairs(pictures), *([] if row else beside), *pairs([*inner])]
    return list(found[0]) if found else []


def _are_parts(inner: dict[str, Listing]) -> bool:
    """Whether folders are rows of one scene, or a pair: their names are a pair's, or differ in a
    number only. A grid in each folder means one scene per folder.
    """
    if paired(inner):
        return True
    rows = read_names(tuple(inner))
    grids = [read_names(tuple(one.pictures())) for one in inner.values()]
    numbered = rows is not None and len(rows.views) == len(inner)
    return numbered and all(grid is None or grid.runs for grid in grids)


def note_of(given: Listing, inner: Listing) -> str:
    """A note of the used and unused pictures of a folder; "" if all are used."""
    used = {inner.path.relative_to(given.path).as_posix()} if inner.path != given.path else set()
    kept = used or {name.rpartition("/")[0] for name in inner.names}
    others = given.pictures() + [f"{name}/" for name in _with_pictures(given) if name not in kept]
    taken = [f"the pictures are those of {name}" for name in used]
    return "; ".join(taken + [f"not used: {some(others)}"] * bool(others))
