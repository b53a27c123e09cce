"""The scenes of a playlist: paths of light fields, and folders of light fields."""

from collections.abc import Iterable
from pathlib import Path

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene.cache import find_pack
from lfpipe.scene.layouts import describe

MAX_ENTRIES = 1000  # entries of a folder to examine


def playlist(paths: Iterable[Path], settings: config.Scene) -> list[Path]:
    """Replaces each folder in paths that is no light field itself by the light fields in it, in order of name.

    A path that is neither stays: opening it reports the error. Single pictures in a folder do not count.
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
    """Number of views of the light field at path; 0 if there is none."""
    try:
        if find_pack(path, settings):
            return 2  # or more: single pictures are opened by name only
        source = describe(path, settings)
    except UserError:
        return 0
    return source.rows * source.cols
