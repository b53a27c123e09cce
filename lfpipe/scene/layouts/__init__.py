"""The layouts light fields come in, one module each. A new one is one file here with NAME, `detect` and `describe`."""

from __future__ import annotations

import difflib
import importlib
import os
import pkgutil
from typing import Protocol, cast

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene.files import Listing, library_errors, list_scene
from lfpipe.scene.source import SceneSource


class Layout(Protocol):
    """What a module of this package offers."""

    NAME: str  # as `--layout` takes it

    def detect(self, listing: Listing) -> int | None:
        """How specific the match is, by names (and a glance at one picture) alone: 90 for a format that says what it is,
        50 for a pattern of names, 10 for a last resort; None where it is not this layout."""

    def describe(self, listing: Listing, scene: config.Scene) -> SceneSource:
        """The scene at that path. scene: the user's own word on grid and so on. Raises UserError."""


def layouts() -> dict[str, Layout]:
    """Every layout by name, in alphabetical order of the modules."""
    found: dict[str, Layout] = {}
    for module in sorted(pkgutil.iter_modules(__path__), key=lambda m: m.name):
        if not module.name.startswith("_"):
            layout = cast(Layout, importlib.import_module(f"{__name__}.{module.name}"))
            found[layout.NAME] = layout
    return found


def describe(path: str | os.PathLike[str], scene: config.Scene) -> SceneSource:
    """The scene at path by the layout that scene.layout names, else by the most specific one that matches.

    Raises UserError where there is nothing, no layout matches, or the scene is damaged.
    """
    known = layouts()
    if scene.layout != "auto" and scene.layout not in known:
        close = difflib.get_close_matches(scene.layout, known, 1, 0.4)
        raise UserError(
            f"scene.layout: {scene.layout!r} is not a layout" + (f" (did you mean {close[0]!r}?)" if close else ""),
            f"one of: auto, {', '.join(known)}",
        )
    with library_errors(path):
        return _described(known, list_scene(path), scene)


def _described(known: dict[str, Layout], listing: Listing, scene: config.Scene) -> SceneSource:
    if scene.layout != "auto":
        return known[scene.layout].describe(listing, scene)
    marks = [(mark, layout) for layout in known.values() if (mark := layout.detect(listing)) is not None]
    if not marks:
        some = ", ".join(listing.names[:3] or listing.folders[:3])
        raise UserError(
            f"{listing.path}: no layout of a light field recognised ({some}, ...)",
            f"name it with --set scene.layout=NAME, one of: {', '.join(known)}; unpack an archive first",
        )
    return max(marks, key=lambda pair: pair[0])[1].describe(listing, scene)
