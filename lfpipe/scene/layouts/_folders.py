"""Scenes whose pictures are in subfolders of the given folder: one folder per row, or all in the
only folder with pictures.
"""

import contextlib
import re
from collections.abc import Collection, Iterator
from itertools import islice
from pathlib import Path

import attrs

from lfpipe.errors import UserError
from lfpipe.scene.files import Listing, list_scene
from lfpipe.scene.layouts._grid import some
from lfpipe.scene.layouts._names import MAPS, read_names, side_of

_DEEPEST = 8  # levels: exports nest three or four
_KIND = r"s?([-_ ]?(raw|data|map|maps|image|images|png|filled))?"
_COLOUR_FOLDER = re.compile(rf"(rgb|colou?r|image|img|photo|picture){_KIND}")
_DEPTH_FOLDER = re.compile(rf"(depth|disparity|disp){_KIND}")
_BESIDE = re.compile(r"__macosx|raw|thumb(nail)?s|originals?|backup|calib(ration)?(_?data)?")


def inner_listing(listing: Listing, deepest: int = _DEEPEST) -> Listing | None:
    """The pictures in subfolders, as names with a slash or as the only inner folder; None if there
    are none, or no more than in the folder itself. Raises UserError if the subfolders are separate
    scenes.
    """
    own = len(listing.pictures())
    below = None if listing.is_file else _inner(listing, deepest)
    if below is None:
        return None
    recorded = depth_folders(below) is not None
    more = len(below.pictures()) > own or (bool(below.names) and not own)
    return below if more or (recorded and not own) else None


def _inner(listing: Listing, deepest: int) -> Listing | None:
    inner = dict(_with_pictures(listing))
    if listing.pictures() or len(inner) > 1:
        inner = {
            name: one
            for name, one in inner.items()
            if not MAPS.search(name) and not _BESIDE.fullmatch(name.lower())
        }
    if len(inner) == 1 and deepest > 1:
        only = next(iter(inner.values()))
        if depth_folders(only) is not None:
            return only
        return inner_listing(only, deepest - 1) or only
    rows = {name: one for name, one in inner.items() if one.pictures()}
    if len(rows) == 1:
        return next(iter(rows.values()))
    names = tuple(f"{row}/{name}" for row, one in rows.items() for name in one.pictures())
    if len(names) <= len(listing.pictures()):
        return None
    if len(rows) < len(inner) or not _are_rows(list(rows), names):
        most = max(rows, key=lambda name: len(rows[name].pictures()))
        rename = "; if the folders are rows of one scene, name them row_01, row_02"
        raise UserError(
            f"{listing.path}: pictures are in {len(rows)} folders: {', '.join(list(rows)[:4])}",
            f"give one of them, {listing.path / most}{rename * (not _numbered(rows))}",
        )
    return attrs.evolve(listing, names=names, folders=())


def depth_folders(listing: Listing) -> tuple[str, str] | None:
    """The folders with the colour pictures and the depth maps of a depth camera's recording."""
    if listing.pictures():
        return None
    colour, depth = (
        next((name for name in listing.folders if words.fullmatch(name.lower())), None)
        for words in (_COLOUR_FOLDER, _DEPTH_FOLDER)
    )
    return None if colour is None or depth is None else (colour, depth)


def _with_pictures(listing: Listing, deepest: int = _DEEPEST) -> Iterator[tuple[str, Listing]]:
    """The subfolders with pictures in or below them, each replaced by its only such subfolder if it
    has none itself: cam0/data beside cam0/sensor.yaml.
    """
    for name in listing.folders if deepest else ():
        one = _listed(listing, name)
        # two are known to be several: a large tree is not read to its end
        below = [] if one.pictures() else list(islice(_with_pictures(one, deepest - 1), 2))
        if len(below) == 1:
            yield f"{name}/{below[0][0]}", below[0][1]
        elif one.pictures() or below:
            yield name, one


def _listed(listing: Listing, name: str) -> Listing:
    """The listing of a subfolder; empty if it is unreadable."""
    with contextlib.suppress(UserError):
        return list_scene(listing.file(name))
    return attrs.evolve(
        listing, path=listing.path / name, folder=listing.path / name, names=(), folders=()
    )


def note_of(given: Listing, inner: Listing) -> str:
    """A note of the used and unused pictures of a folder; "" if all are used."""
    parts = inner.path.relative_to(given.path).parts
    rows = {name.partition("/")[0] for name in inner.names if "/" in name}
    at = given
    others: list[str] = []
    for kept in [{part} for part in parts] + [rows] * bool(rows):
        where = at.path.relative_to(given.path)
        others += [(where / name).as_posix() for name in at.pictures()]
        others += [
            f"{name}/" for name in at.folders if name not in kept and _listed(at, name).pictures()
        ]
        at = _listed(at, min(kept))
    taken = [f"the pictures are those of {Path(*parts)}"] if parts else []
    return "; ".join(taken + [f"not used: {some(others)}"] * bool(others))


def _numbered(folders: Collection[str]) -> bool:
    """Whether the names of folders differ in one number or letter only."""
    read = read_names(tuple(f"{name}.png" for name in folders))
    return read is not None and len(read.views) == len(folders)


def _are_rows(folders: list[str], names: tuple[str, ...]) -> bool:
    """Whether folders are rows of one scene: they are numbered, or are those of a stereo pair, and
    the names of their pictures are unambiguous. A grid in each folder means one scene per folder.
    """
    sides = [side_of(name) for name in folders]
    if len(sides) == 2 and sides[0] and sides[1] and sides[0][0] == sides[1][0]:
        return True
    together = read_names(names)
    return _numbered(folders) and not (together is not None and together.doubt)
