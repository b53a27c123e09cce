"""Scenes whose pictures stand below the folder that was given: one folder per row, or all in the only folder with pictures."""

from __future__ import annotations

import contextlib
from pathlib import Path

import attrs

from lfpipe.errors import UserError
from lfpipe.scene.files import Listing, list_scene, picture_header
from lfpipe.scene.layouts._families import MAPS
from lfpipe.scene.layouts._names import read_names

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
    rows = _views(listing, {name: one for name, one in inner.items() if one.pictures()})
    if len(rows) == 1 and len(inner) > 1:
        return next(iter(rows.values()))
    names = tuple(f"{row}/{name}" for row, one in rows.items() for name in one.pictures())
    if not names:
        return None
    if len(rows) < len(inner) or len(rows) == 1 or not (_numbered(tuple(rows)) or _sides(tuple(rows))):
        most = max(rows, key=lambda name: len(rows[name].pictures()))
        raise UserError(
            f"{listing.path}: pictures stand in {len(rows)} folders: {', '.join(list(rows)[:4])}",
            f"give one of them, {listing.path / most}; folders that are rows of one scene are named row_01, row_02",
        )
    return attrs.evolve(listing, names=names, folders=())


def _views(listing: Listing, folders: dict[str, Listing]) -> dict[str, Listing]:
    """Of folders whose pictures have the same names, as results lie beside views: the one whose pictures are coloured, or else
    the largest; all of them where that leaves more than one."""
    if len({tuple(Path(name).stem for name in one.pictures()) for one in folders.values()}) > 1 or _numbered(tuple(folders)):
        return folders
    for kind in (lambda header: not header.grey, lambda header: header.width_px):
        marks: dict[str, int] = {}
        for name, one in folders.items():
            with contextlib.suppress(UserError):
                marks[name] = kind(picture_header(one.file(one.pictures()[0])))
        best = [name for name, mark in marks.items() if mark == max(marks.values())]
        if len(best) == 1:
            return {best[0]: folders[best[0]]}
    return folders


def _sides(folders: tuple[str, ...]) -> bool:
    """Whether two folders are named as the two eyes' pictures are."""
    return sorted(name.lower() for name in folders) in (["left", "right"], ["l", "r"], ["links", "rechts"])


def _numbered(folders: tuple[str, ...]) -> bool:
    """Whether names of folders differ in one number or letter only."""
    found = read_names(tuple(f"{name}.png" for name in folders))
    return found is not None and len(found.views) == len(folders) and not found.clashes
