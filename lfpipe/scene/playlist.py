"""The scenes of a playlist: light fields by their paths, and folders that hold some."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene.cache import find_pack
from lfpipe.scene.layouts import describe

MAX_ENTRIES = 1000  # of a folder, looked at


def playlist(paths: Iterable[Path], settings: config.Scene) -> list[Path]:
    """paths, each folder that is no light field itself replaced by the light fields in it, in the order of their names.

    A path that is neither stays: opening it reports what is wrong. Single pictures in a folder are no light fields.
    """
    return [scene for path in paths for scene in _scenes_at(path, settings)]


def _scenes_at(path: Path, settings: config.Scene) -> list[Path]:
    if not path.is_dir() or _views(path, settings):
        return [path]
    try:
        inside = sorted(path.iterdir())[:MAX_ENTRIES]
    except OSError:
        return [path]
    return [each for each in inside if not each.name.startswith(".") and _views(each, settings) > 1] or [path]


def _views(path: Path, settings: config.Scene) -> int:
    """How many views the light field at path has; 0 where there is none."""
    try:
        if find_pack(path, settings):
            return 2  # or more: who packs a single picture does so by name
        source = describe(path, settings)
    except UserError:
        return 0
    return source.rows * source.cols
