"""Scenes whose pictures stand below the folder that was given: one folder per row, or all in the only folder with pictures."""

from __future__ import annotations

import contextlib

import attrs

from lfpipe.errors import UserError
from lfpipe.scene.files import Listing, list_scene
from lfpipe.scene.layouts._names import MAPS, read_names

_DEEPEST = 3
_BESIDE = ("__macosx", "raw", "thumbs", "thumbnails", "original", "originals", "backup")


def inner_listing(listing: Listing, deepest: int = _DEEPEST) -> Listing | None:
    """The pictures below a folder without any of its own, as names with a slash or as the only inner folder; None where there
    are none. Raises UserError where folders hold scenes of their own."""
    if listing.is_file or listing.pictures():
        return None
    inner: dict[str, Listing] = {}
    for name in listing.folders:
        with contextlib.suppress(UserError):
            inner[name] = list_scene(listing.file(name))
    if len(inner) > 1:
        inner = {name: one for name, one in inner.items() if not MAPS.search(name) and name.lower() not in _BESIDE}
    if len(inner) == 1 and deepest > 1:
        only = next(iter(inner.values()))
        deeper = inner_listing(only, deepest - 1)
        return deeper or (only if only.names else None)
    rows = {name: one.pictures() for name, one in inner.items() if one.pictures()}
    names = tuple(f"{row}/{name}" for row, pictures in rows.items() for name in pictures)
    if not names:
        return None
    if len(rows) < len(inner) or len(rows) == 1 or not _numbered(tuple(rows)):
        raise UserError(
            f"{listing.path}: pictures stand in {len(rows)} folders: {', '.join(list(rows)[:4])}",
            f"give one of them, {listing.path / next(iter(rows))}; folders that are rows of one scene are named row_01, row_02",
        )
    return attrs.evolve(listing, names=names, folders=())


def _numbered(folders: tuple[str, ...]) -> bool:
    """Whether names of folders differ in one number or letter only."""
    found = read_names(tuple(f"{name}.png" for name in folders))
    return found is not None and len(found.views) == len(folders) and not found.clashes
