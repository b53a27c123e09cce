"""The packer: the only program that reads the user's pictures, in a child process with limits on
memory, time and output.

`open_scene.Packing` runs `python -m lfpipe.scene.packer` with a `PackerRequest`. Steps, each a JSON
object:

    {"scenes": [path, ...]}                     expand: the light fields; the first is opened
    {"step": "views", "done": 7, "total": 81}   progress
    {"summary": {...}}                          the pack can be shown, still without disparity
    {"log": "..."}                              a decision and its reason

Result: the summary of the pack, or the `Manifest` of the scene.
"""

import contextlib
import importlib
import logging
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import attrs

from lfpipe.config import Scene, converter
from lfpipe.errors import UserError
from lfpipe.files.safe_files import watch_files
from lfpipe.host.files import is_dir
from lfpipe.host.worker import Report, serve
from lfpipe.scene import layouts
from lfpipe.scene.analysis import analyse_scene
from lfpipe.scene.cache import cache_dir, packed
from lfpipe.scene.info import scene_manifest
from lfpipe.scene.lightfield import MethodScores
from lfpipe.scene.open_scene import PackerRequest
from lfpipe.scene.pack import open_pack, summarize
from lfpipe.scene.packing import Score, pack_scene
from lfpipe.scene.recent_scenes import remember_scene
from lfpipe.scene.source import SceneSource

MEMORY_BYTES = 1 << 30  # mapped files do not count


class _LogOfParent(logging.Handler):
    """Sends log records to the parent, which prints them with -v."""

    def __init__(self, report: Report) -> None:
        super().__init__()
        self._report = report

    def emit(self, record: logging.LogRecord) -> None:
        """Reports a record's text as a step."""
        self._report(log=record.getMessage())


def work(request: dict[str, Any], report: Report) -> dict[str, Any]:
    """The result of a request. Raises UserError."""
    asked = converter().structure(request, PackerRequest)
    settings = asked.settings
    scene_log = logging.getLogger("lfpipe.scene")
    scene_log.setLevel(logging.INFO)
    scene_log.handlers = [_LogOfParent(report)]
    paths = [Path(text) for text in asked.scenes]
    watch_files(lambda path: report(reading=str(path)))

    def progress(what: str, done: int, total: int) -> None:
        report(step=what, done=done, total=total)

    def views_ready(pack: Path) -> None:
        if asked.shown:
            with contextlib.suppress(OSError):
                os.nice(15)
        report(summary=attrs.asdict(summarize(open_pack(pack, settings.invert_depth))))

    if asked.do == "info":
        return attrs.asdict(scene_manifest(analyse_scene(paths[0], settings)))
    if asked.expand:
        paths = playlist(paths, settings)
        report(scenes=[str(path) for path in paths])
    field = pack_scene(paths[0], settings, _scorer(asked.scorer), progress, views_ready)
    # the demo is always available
    if asked.remember and not paths[0].is_relative_to(cache_dir(settings)):
        remember_scene(paths[0])
    return attrs.asdict(summarize(field))


def _scorer(name: str) -> Score:
    """The function that a request names; without a name, a function that scores no method."""
    if not name:
        return lambda field: MethodScores()
    module, _, function = name.partition(":")
    score: Score = getattr(importlib.import_module(module), function)
    return score


def playlist(paths: Iterable[Path], settings: Scene) -> list[Path]:
    """Replaces each folder that is not a light field itself, or only by one of its files, by the
    light fields in it, in order of name.

    A path that is neither is kept: opening it reports the error. Single pictures in a folder are
    ignored.
    """
    scenes: list[Path] = []
    for path in paths:
        with contextlib.suppress(UserError):
            if packed(path, settings) is not None:
                scenes.append(path)
                continue
        inside: list[Path] = []
        own = _light_field_at(path, settings)
        if is_dir(path) and (own is None or len(own.files) == 1):
            with contextlib.suppress(OSError):
                inside = sorted(path.iterdir())[:1000]
        sources = {
            entry: _light_field_at(entry, settings)
            for entry in inside
            if not entry.name.startswith(".")
        }
        fields = [
            entry
            for entry, source in sources.items()
            if source is not None and source.rows * source.cols > 1
        ]
        if own is not None and len(own.playlist) > 1 and is_dir(path):
            scenes += own.playlist
            continue
        scenes += [path] if not fields or (own is not None and len(fields) == 1) else fields
    return scenes


def _light_field_at(path: Path, settings: Scene) -> SceneSource | None:
    """The light field at path; None if there is none."""
    with contextlib.suppress(UserError):
        return layouts.describe(path, settings)
    return None


if __name__ == "__main__":
    serve(work, MEMORY_BYTES)
