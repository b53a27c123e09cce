"""The layouts of light fields, by module. To add one, add a module here with NAME, `detect` and
`describe`, or with several layouts in LAYOUTS.
"""

import importlib
import math
import os
import pkgutil
from collections import Counter
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.pictures import open_header, read_picture
from lfpipe.host.machine import install_command
from lfpipe.plugins import LAYOUTS, Guarded, PluginError, Results, array, loaded, skipped
from lfpipe.scene.files import HOLDS_ALL, Listing, is_picture, library_errors, list_scene
from lfpipe.scene.layouts._candidates import Candidate, ranked
from lfpipe.scene.layouts._folders import inner_listing, note_of
from lfpipe.scene.layouts._grid import GRID_REMEDY, parse_grid, some
from lfpipe.scene.layouts._tiles import single_picture
from lfpipe.scene.layouts.plenoptic import is_honeycomb
from lfpipe.scene.source import Layout, SceneSource

RESULTS: Results = {"detect": int | None, "describe": SceneSource}


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
    own = built_in()
    return {**loaded(LAYOUTS, own, RESULTS), **own}


def describe(path: str | os.PathLike[str], scene: config.Scene) -> SceneSource:
    """The scene at path by the layout that scene.layout names, else by the most specific one that
    matches.

    Raises UserError if path does not exist, no layout matches, or the scene is damaged.
    """
    known = layouts()
    if scene.layout not in ("auto", *known):
        raise UserError(
            f"scene.layout: {scene.layout!r} is not a layout",
            f"use one of: auto, {', '.join(known)}",
        )
    try:
        with library_errors(path):
            source = _described_by_any(known, path, scene)
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


def _described_by_any(
    known: dict[str, Layout], path: str | os.PathLike[str], scene: config.Scene
) -> SceneSource:
    """The scene at path; skips plug-in layouts that fail. Raises UserError, also if scene.layout
    names one of them.
    """
    failed = [f"{why}; it is skipped" for why in skipped.values()]
    while True:
        try:
            source = _source_of(known, list_scene(path), scene)
        except PluginError as error:
            if scene.layout == error.name:
                raise
            del known[error.name]
            failed.append(f"{error.message}; it is skipped")
        else:
            return attrs.evolve(source, notes=(*source.notes, *failed))


_CONVERTED = {  # files that other programs convert to pictures, by suffix
    (".lfp", ".lfr", ".lfx"): (
        "a raw picture of a Lytro camera",
        "decode it with PlenoptiCam or LFToolbox and give the folder of its views",
    ),
    (".heic", ".heif"): (
        "a HEIC picture, which needs another package",
        (
            f"{install_command('pillow-heif')}; or run `heif-convert FILE.heic FILE.jpg` in an"
            " empty folder and give that folder: it writes two files for a spatial photo and, with"
            " --with-aux, the depth of a portrait"
        ),
    ),
    (".jxl", ".jp2", ".j2k", ".psd", ".xcf", ".exr", ".hdr", ".tga", ".pcx", ".sgi", ".svg"): (
        "a picture in a format that lfpipe does not decode",
        "export it as PNG or JPEG, and give that",
    ),
    (".cr2", ".cr3", ".nef", ".arw", ".dng", ".raf", ".orf", ".rw2"): (
        "a camera's raw picture",
        (
            "develop it with the camera's program, darktable or RawTherapee, and give the folder of"
            " JPEGs or TIFFs"
        ),
    ),
    (".zip", ".tar", ".gz", ".rar", ".7z"): ("an archive", "unpack it and give the folder"),
}
_BESIDE = (  # files that accompany views without describing them
    ".txt",
    ".md",
    ".cfg",
    ".ini",
    ".json",
    ".xml",
    ".xmp",
    ".csv",
    ".dat",
    ".yaml",
    ".yml",
    ".toml",
    ".log",
    ".db",
    ".html",
    ".pdf",
    ".py",
    ".pfm",
    ".bin",
    ".npy",
    ".exif",
    ".aae",
    ".bak",
    *(end for ends in _CONVERTED for end in ends),
)


def _require_pictures(listing: Listing, certain: bool) -> None:
    """Raises UserError if most files must be converted first, or (unless certain) have a format
    that lfpipe does not read.
    """
    pictures = listing.pictures()
    for ends, (what, remedy) in _CONVERTED.items():
        such = [name for name in listing.names if name.lower().endswith(ends)]
        if such and not pictures and 2 * len(such) >= len(listing.names):
            raise UserError(f"{listing.file(such[0])}: {what}", remedy)
    kinds = Counter(
        Path(name).suffix.lower()
        for name in set(listing.names).difference(pictures)
        if not name.lower().endswith(_BESIDE)
    )
    kind, count = kinds.most_common(1)[0] if kinds else ("", 0)
    if count > max(3, len(pictures)) and not certain:
        some = ", ".join([name for name in listing.names if Path(name).suffix.lower() == kind][:3])
        remedy = f"; {pictures[0]} alone: give {listing.folder / pictures[0]}" if pictures else ""
        raise UserError(
            f"{listing.path}: {count} of {len(listing.names)} files have a format that lfpipe"
            f" does not read: {some}, ...",
            f"convert them to PNG and give their folder{remedy}",
        )


def _source_of(known: dict[str, Layout], given: Listing, scene: config.Scene) -> SceneSource:
    """The scene by the most specific layout that matches, else the pictures in subfolders.

    Raises UserError.
    """
    tries = list(known.values()) if scene.layout == "auto" else [known[scene.layout]]
    listing = given
    mark, layout = _match(tries, given)
    # 10: a layout of last resort; pictures in subfolders take precedence
    inner = inner_listing(given) if mark <= 10 else None
    if inner is not None:
        listing = inner
        mark, layout = _match(tries, inner)
    certain = (
        scene.layout != "auto" or mark >= 80 or listing.is_file or scene.force or layout is None
    )
    _require_pictures(listing, certain)
    layout = (
        known[scene.layout]
        if scene.layout != "auto"
        else _checked(known, mark, layout, listing, scene)
    )
    source = layout.describe(listing, scene)
    source = attrs.evolve(source, notes=(*source.notes, *_unused(source)))
    if isinstance(layout, Guarded):  # a plug-in
        source = _guarded_source(layout, source)
    if inner is not None:
        source = attrs.evolve(
            source, path=given.path, notes=(*source.notes, *filter(None, [note_of(given, inner)]))
        )
    return source


def _unused(source: SceneSource) -> list[str]:
    """Notes of what the pictures of a scene hold besides what is shown."""
    headers = {path.name: open_header(path) for path in source.files if is_picture(path)}
    notes = []
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


def _guarded_source(layout: Guarded, source: SceneSource) -> SceneSource:
    """The source of a plug-in: what its functions return is checked."""
    size = source.height_px, source.width_px

    def view(result: Any) -> NDArray[Any]:
        return array(*size, *(3,) * (np.ndim(result) == 3), kinds="u")(result)

    def grey(result: Any) -> NDArray[Any]:
        return array(*np.shape(result)[:2], kinds="u")(result)

    small = source.small and layout.bound("small", source.small, grey)
    disparity = array(*size)
    truth = {at: layout.bound("truth", known, disparity) for at, known in source.truth.items()}
    read = layout.bound("read", source.read, view)
    return attrs.evolve(source, read=read, small=small, truth=truth)


def _match(tries: list[Layout], listing: Listing) -> tuple[int, Layout | None]:
    """The layout that matches most specifically, with its mark; (0, None) if none matches. Raises
    UserError if none matches because a file is unreadable.
    """
    marks = []
    unreadable: UserError | None = None
    for layout in tries:
        try:
            if mark := layout.detect(listing):
                marks.append(Candidate(what=layout.NAME, score=mark, value=layout))
        except UserError as error:
            unreadable = error
    order = ranked(f"the layout of {listing.path}", marks)
    if unreadable is not None and not order:
        raise unreadable
    return (int(order[0].score), order[0].value) if order else (0, None)


def _checked(
    known: dict[str, Layout],
    mark: int,
    layout: Layout | None,
    listing: Listing,
    scene: config.Scene,
) -> Layout:
    """The layout of a scene. Raises UserError if there is none, or for a raw plenoptic picture."""
    if layout is known["picture"] and math.prod(parse_grid(scene.grid) or (1,)) > 1:
        return known["mosaic"]  # set by the user: its tiles differ from each other, or are resized
    if layout is None:
        names = listing.names or listing.folders
        some = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
        remedy = "give the folder of the views, or one file that contains them all by its own path"
        if single := [name for name in listing.names if name.lower().endswith(HOLDS_ALL)]:
            remedy = f"give {listing.folder / single[0]}"
        if listing.pictures():
            remedy = GRID_REMEDY
        raise UserError(
            f"{listing.path}: no layout of a light field was recognised ({some})", remedy
        )
    path = single_picture(listing) if mark < 90 else None  # formats of 90 identify themselves
    if path is None or not is_honeycomb(read_picture(path)[0]):
        return layout
    if not scene.force:
        raise UserError(
            f"{path}: is a raw picture of a plenoptic camera, a honeycomb of lenslets",
            "decode it with PlenoptiCam or LFToolbox and give the folder of its views; --set"
            " scene.force=true shows it flat",
        )
    return known["picture"]
