"""Scenes whose pictures stand below the folder that was given: one folder per row, or all in the only folder with pictures."""

import contextlib
from pathlib import Path

import attrs

from lfpipe.errors import UserError
from lfpipe.files.pictures import Header, open_header
from lfpipe.scene.files import Listing, list_scene
from lfpipe.scene.layouts._grid import some
from lfpipe.scene.layouts._names import LEFT, MAPS, RIGHT, read_names
from lfpipe.scene.layouts._tiles import likeness

_DEEPEST = 8
_COPY = 0.9  # correlation of one picture in two sizes
_BESIDE = ("__macosx", "raw", "thumbs", "thumbnails", "original", "originals", "backup")


def inner_listing(listing: Listing, deepest: int = _DEEPEST) -> Listing | None:
    """The pictures below a folder, as names with a slash or as the only inner folder; None if there are none, or no more than in
    the folder itself. Raises UserError if folders hold scenes of their own."""
    own, found = len(listing.pictures()), None if listing.is_file else _inner(listing, deepest)
    more = found is not None and (len(found.pictures()) > own or (found.names and not own))
    return found if more else None


def _inner(listing: Listing, deepest: int) -> Listing | None:
    inner = {name: _listed(listing, name) for name in listing.folders}
    if listing.pictures() or len(inner) > 1:
        inner = {name: one for name, one in inner.items() if not MAPS.search(name) and name.lower() not in _BESIDE}
    if len(inner) == 1 and deepest > 1:
        only = next(iter(inner.values()))
        return inner_listing(only, deepest - 1) or only
    rows = {name: one for name, one in inner.items() if one.pictures()}
    together = _are_rows(rows) or _sides(rows)
    rows = rows if together else _views(rows)
    if len(rows) == 1 and len(inner) > 1:
        return next(iter(rows.values()))
    names = tuple(f"{row}/{name}" for row, one in rows.items() for name in one.pictures())
    if len(names) <= len(listing.pictures()):
        return None
    if len(rows) < len(inner) or len(rows) == 1 or not together:
        most = max(rows, key=lambda name: len(rows[name].pictures()))
        raise UserError(
            f"{listing.path}: pictures stand in {len(rows)} folders: {', '.join(list(rows)[:4])}",
            f"give one of them, {listing.path / most}; folders that are rows of one scene are named row_01, row_02",
        )
    return attrs.evolve(listing, names=names, folders=())


def _listed(listing: Listing, name: str) -> Listing:
    """A subfolder; as an empty one if it cannot be read."""
    with contextlib.suppress(UserError):
        return list_scene(listing.file(name))
    return attrs.evolve(listing, path=listing.path / name, folder=listing.path / name, names=(), folders=())


def note_of(given: Listing, inner: Listing) -> str:
    """Which pictures below a folder were taken, and which were not; "" for all of them."""
    parts, at = inner.path.relative_to(given.path).parts, given
    others = [] if parts else given.pictures()
    for part in parts:
        others += [at.file(name).relative_to(given.path).as_posix() for name in at.pictures()]
        others += [f"{name}/" for name in at.folders if name != part and _listed(at, name).pictures()]
        at = _listed(at, part)
    taken = [f"the pictures are those of {Path(*parts)}"] if parts else []
    return "; ".join(taken + [f"not used: {some(others)}"] * bool(others))


def _views(folders: dict[str, Listing]) -> dict[str, Listing]:
    """Of folders with results beside the views (the same names, one of them in colour), or with one set of pictures in several
    sizes: that of the views, in their full size. All of them if they hold something else."""
    headers, pictures = _headers(folders), {name: one.pictures() for name, one in folders.items()}
    if len(headers) < len(folders) or len({len(names) for names in pictures.values()}) != 1:
        return folders
    coloured = [name for name, first in headers.items() if not first.grey]
    if len(coloured) == 1 and len({tuple(Path(name).stem for name in names) for names in pictures.values()}) == 1:
        return {coloured[0]: folders[coloured[0]]}
    large = max(folders, key=lambda name: headers[name].width_px)
    if len({(first.width_px, first.height_px) for first in headers.values()}) < len(folders):
        return folders
    ends = [[one.file(pictures[name][k]) for k in (0, -1)] for name, one in folders.items() if name != large]
    full = [folders[large].file(pictures[large][k]) for k in (0, -1)]
    alike = all(likeness(a, b) > _COPY for pair in ends for a, b in zip(pair, full, strict=True))
    return {large: folders[large]} if alike else folders


def _sides(folders: dict[str, Listing]) -> bool:
    """Whether two folders are named as the two eyes' pictures are."""
    return sorted(name.lower() for name in folders) in (sorted(pair) for pair in zip(LEFT, RIGHT, strict=True))


def _are_rows(folders: dict[str, Listing]) -> bool:
    """Whether names of folders differ in one number or letter only, and not all of their pictures in size."""
    found = read_names(tuple(f"{name}.png" for name in folders))
    if found is None or len(found.views) < len(folders) or found.clashes:
        return False
    sizes = [(first.width_px, first.height_px) for first in _headers(folders).values()]
    return len(sizes) < 2 or len(set(sizes)) < len(sizes)


def _headers(folders: dict[str, Listing]) -> dict[str, Header]:
    """Of the first picture of each folder, where it can be read."""
    headers: dict[str, Header] = {}
    for name, one in folders.items():
        with contextlib.suppress(UserError):
            headers[name] = open_header(one.file(one.pictures()[0]))
    return headers
