"""Scenes whose pictures are in subfolders of the given folder: one folder per row, or all in the
only folder with pictures.
"""

import contextlib
import re

import attrs

from lfpipe.errors import UserError
from lfpipe.scene.files import Listing, list_scene
from lfpipe.scene.layouts._grid import some
from lfpipe.scene.layouts._names import MAPS, read_names

_BESIDE = re.compile(r"__macosx|raw|thumb(nail)?s|originals?|backup|calib(ration)?(_?data)?")
# of a pair, or of a picture and its depth: their layouts decide which of the files they use
PAIRED = re.compile(
    r"(left|right|l|r|image|img|cam|camera|rgb|colou?r|depth|disparity|disp)s?"
    r"([-_ ]?(raw|data|images?|maps?|\d{1,2}))?",
    re.IGNORECASE,
)


def inner_listing(listing: Listing) -> Listing | None:
    """The pictures in subfolders, as names with a slash or as the only inner folder; None if there
    are none, or no more than in the folder itself. Raises UserError if the subfolders are separate
    scenes.
    """
    inner = _with_pictures(listing)
    if len(inner) == 2 and all(map(PAIRED.fullmatch, inner)):
        pass
    elif len(inner) > 1 or listing.pictures():
        inner = {
            name: one
            for name, one in inner.items()
            if not MAPS.search(name) and not _BESIDE.fullmatch(name.lower())
        }
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


def _with_pictures(listing: Listing) -> dict[str, Listing]:
    """The subfolders with pictures, by name; without unreadable ones."""
    found = {}
    for name in () if listing.is_file else listing.folders:
        with contextlib.suppress(UserError):
            one = list_scene(listing.file(name))
            if one.pictures():
                found[name] = one
    return found


def _are_parts(inner: dict[str, Listing]) -> bool:
    """Whether folders are rows of one scene, or a pair: their names are a pair's, or differ in a
    number only. A grid in each folder means one scene per folder.
    """
    if len(inner) == 2 and all(map(PAIRED.fullmatch, inner)):
        return True
    rows = read_names(tuple(inner))
    grids = [read_names(tuple(one.pictures())) for one in inner.values()]
    numbered = rows is not None and len(rows.views) == len(inner)
    return numbered and all(grid is None or grid.runs for grid in grids)


def note_of(given: Listing, inner: Listing) -> str:
    """A note of the used and unused pictures of a folder; "" if all are used."""
    used = {inner.path.name} if inner.path != given.path else set()
    kept = used or {name.partition("/")[0] for name in inner.names}
    others = given.pictures() + [f"{name}/" for name in _with_pictures(given) if name not in kept]
    taken = [f"the pictures are those of {name}" for name in used]
    return "; ".join(taken + [f"not used: {some(others)}"] * bool(others))
