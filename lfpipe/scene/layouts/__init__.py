"""The layouts of light fields, by module. To add one, add a module here with NAME, `detect` and
`describe`, or with several layouts in LAYOUTS.
"""

import importlib
import math
import os
import pkgutil

import attrs

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import open_header
from lfpipe.plugins import LAYOUTS, blaming, load, plugins
from lfpipe.scene.layouts._grid import GRID_REMEDY, parse_grid, some
from lfpipe.scene.layouts._names import DEPTH, words
from lfpipe.scene.layouts.named import inner_listing, note_of, unused_poses
from lfpipe.scene.source import (
    HOLDS_ALL,
    Layout,
    Listing,
    SceneSource,
    is_picture,
    library_errors,
    list_scene,
)

READABLE = (
    "lfpipe reads PNG, JPEG, PPM, BMP, TIFF, WebP, AVIF, GIF, .npy, .npz, .mat, .h5 and videos, and"
    " .heic with the extra `heic`"
)


def built_in() -> dict[str, Layout]:
    """The layouts of this package by name, in alphabetical order."""
    own: dict[str, Layout] = {}
    for module in pkgutil.iter_modules(__path__):
        if not module.name.startswith("_"):
            content = importlib.import_module(f"{__name__}.{module.name}")
            own |= {layout.NAME: layout for layout in getattr(content, "LAYOUTS", [content])}
    return dict(sorted(own.items()))


def layouts() -> dict[str, Layout]:
    """Every layout by name: those of other packages, then the built-in ones."""
    return {**{name: load(LAYOUTS, name) for name in plugins(LAYOUTS)}, **built_in()}


def describe(path: str | os.PathLike[str], scene: config.Scene) -> SceneSource:
    """The scene at path by the layout that scene.layout names, else by the most specific one that
    matches.

    Raises UserError if path does not exist, no layout matches, or the scene is damaged.
    """
    by_name = layouts()
    if scene.layout not in ("auto", *by_name):
        raise UserError(
            f"scene.layout: {scene.layout!r} is not a layout",
            f"use one of: auto, {', '.join(by_name)}",
        )
    try:
        with library_errors(path):
            source = _source_of(by_name, list_scene(path), scene)
    except UserError as error:  # names may hold line breaks
        raise UserError(
            error.message.replace("\n", r"\n"), error.remedy.replace("\n", r"\n")
        ) from None
    grid = parse_grid(scene.grid)
    # for a quilt, scene.grid gives the arrangement of its one row
    if grid is not None and math.prod(grid) != source.rows * source.cols:
        wrong = (
            f"the layout {source.layout} has {source.rows}x{source.cols} views, but scene.grid is"
            f" {scene.grid}"
        )
        raise UserError(f"{path}: {wrong}", "leave out scene.grid")
    return attrs.evolve(source, notes=tuple(note.replace("\n", r"\n") for note in source.notes))


def _source_of(by_name: dict[str, Layout], root: Listing, scene: config.Scene) -> SceneSource:
    """The scene by the most specific layout that matches, else the pictures in subfolders.

    Raises UserError.
    """
    tries = list(by_name.values()) if scene.layout == "auto" else [by_name[scene.layout]]
    listing = root
    mark, layout = _match(tries, root)
    # 10: a layout of last resort; pictures in subfolders take precedence
    inner = inner_listing(root) if mark <= 10 else None
    if inner is not None:
        listing = inner
        mark, layout = _match(tries, inner)
    if scene.layout != "auto":
        layout = by_name[scene.layout]
    elif layout is by_name["picture"] and math.prod(parse_grid(scene.grid) or (1,)) > 1:
        layout = by_name["mosaic"]
    if layout is None:
        raise _not_recognised(listing)
    with blaming([(LAYOUTS, layout.NAME)]):
        source = layout.describe(listing, scene)
        source = attrs.evolve(source, notes=(*source.notes, *_unused(listing, source)))
    if inner is not None:
        source = attrs.evolve(
            source, path=root.path, notes=(*source.notes, *filter(None, [note_of(root, inner)]))
        )
    if source.layout != "poses":
        source = attrs.evolve(source, notes=(*source.notes, *unused_poses(root)))
    return source


def _not_recognised(listing: Listing) -> UserError:
    """The error for a scene that no layout matches."""
    remedy = f"give the folder of the views, or one file that contains them; {READABLE}"
    if single := [name for name in listing.names if name.lower().endswith(HOLDS_ALL)]:
        remedy = f"give {listing.folder / single[0]}"
    elif listing.pictures():
        remedy = GRID_REMEDY
    return UserError(
        f"{listing.path}: no layout of a light field was recognised"
        f" ({some(listing.names or listing.folders, 3)})",
        remedy,
    )


def _unused(listing: Listing, source: SceneSource) -> list[str]:
    """Notes of what a folder, and the pictures of a scene, hold in addition."""
    maps = source.files[1:] if source.layout == "rgbd" else ()  # which may be no pictures
    headers = {
        path.name: open_header(path)
        for path in source.files
        if is_picture(path) and path not in maps
    }
    notes = []
    used = {path.name for path in source.files}
    if source.layout == "picture" and not listing.is_file and len(listing.names) > 1:
        others = [name for name in listing.names if name not in used]
        notes.append(f"one picture is shown; not read: {some(others)}; {READABLE}")
    elif unread := [
        name
        for name in listing.names
        if name not in used and DEPTH.search(words(name)) and not is_picture(listing.folder / name)
    ]:
        notes.append(f"not read: {some(unread)}")
    if clear := [name for name, header in headers.items() if header.alpha]:
        notes.append(f"transparent parts are shown over grey: {some(clear)}")
    holding = [
        name
        for name, header in headers.items()
        if header.beside and not (header.eyes and source.cols == header.frames)
    ]
    if holding and source.layout not in ("rgbd", "gif"):  # the depth, or frames that are views
        notes.append(f"not used: {headers[holding[0]].beside} in {some(holding)}")
    return notes


def _match(tries: list[Layout], listing: Listing) -> tuple[int, Layout | None]:
    """The layout that matches most specifically, with its mark; (0, None) if none matches. Raises
    UserError if none matches because a file is unreadable.
    """
    best: tuple[int, Layout | None] = 0, None
    unreadable: UserError | None = None
    for layout in tries:
        with blaming([(LAYOUTS, layout.NAME)]):
            try:
                mark = layout.detect(listing) or 0
            except UserError as error:
                unreadable = error
            else:
                best = max(best, (mark, layout), key=lambda match: match[0])
    if unreadable is not None and best[1] is None:
        raise unreadable
    return best
