"""The packer: the only program that reads a person's pictures, as a child with limits on memory, time and output.

`python -m lfpipe.scene.packer`, by `open_scene.Packing`. Request: {"do": "pack", "info", "preview" or "make", "scenes":
[path, ...], "config": the table [scene]}; with "pack", "expand": whether folders of light fields stand for what is in them, and
"remember": whether to note the scene as recent; with "make", "out": the folder for a light field made of a video. Steps, each a
JSON object:

    {"scenes": [path, ...]}                     expand: the light fields; the first of them is opened
    {"step": "views", "done": 7, "total": 81}   progress
    {"summary": {...}}                          the pack can be shown, still without disparity

Result: the summary of the pack; the facts of the scene; one view of it; or those of the `Slide`.
"""

import base64
import contextlib
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.files.decoding import fit_area
from lfpipe.host.worker import Report, serve
from lfpipe.scene import layouts
from lfpipe.scene.cache import cache_dir
from lfpipe.scene.examination import examine_scene
from lfpipe.scene.info import describe_examined
from lfpipe.scene.pack import open_pack, summarize
from lfpipe.scene.packing import pack_scene
from lfpipe.scene.recent_scenes import remember_scene
from lfpipe.scene.slide import make_slide
from lfpipe.scene.source import SceneSource

NICE = 15  # below everything that draws
PREVIEW_PX = (320, 240)  # at most; an answer may have 1 MB
MEMORY_BYTES = 1 << 30  # mapped files do not count
MAX_ENTRIES = 1000  # entries of a folder to examine


def work(request: dict[str, Any], report: Report) -> dict[str, Any]:
    """The result of a request. Raises UserError."""
    settings = config.Scene(**request["config"])
    paths = [Path(text) for text in request["scenes"]]

    def progress(what: str, done: int, total: int) -> None:
        report(step=what, done=done, total=total)

    def views_ready(pack: Path) -> None:
        with contextlib.suppress(OSError):
            os.nice(NICE)  # from now on it works beside the session that shows the pack
        report(summary=attrs.asdict(summarize(open_pack(pack, settings.half_turn))))

    if request["do"] == "make":
        slide = make_slide(paths[0], Path(request["out"]), progress)
        return {**attrs.asdict(slide), "folder": str(slide.folder)}
    if request["do"] == "preview":
        return _preview(layouts.describe(paths[0], settings))
    if request["do"] == "info":
        return describe_examined(examine_scene(paths[0], settings))
    if request.get("expand"):
        paths = playlist(paths, settings)
        report(scenes=[str(path) for path in paths])
    field = pack_scene(paths[0], settings, progress, views_ready)
    if request.get("remember") and not paths[0].is_relative_to(
        cache_dir(settings)
    ):  # the demo is always there
        remember_scene(paths[0])
    return attrs.asdict(summarize(field))


def playlist(paths: Iterable[Path], settings: config.Scene) -> list[Path]:
    """Replaces each folder in paths that is no light field itself, or only by one of its files, by the light fields in it, in
    order of name.

    A path that is neither stays: opening it reports the error. Single pictures in a folder do not count.
    """
    scenes: list[Path] = []
    for path in paths:
        inside: list[Path] = []
        own = _described(path, settings)
        if path.is_dir() and (own is None or len(own.files) == 1):
            with contextlib.suppress(OSError):
                inside = sorted(path.iterdir())[:MAX_ENTRIES]
        sources = {
            entry: _described(entry, settings) for entry in inside if not entry.name.startswith(".")
        }
        fields = [
            entry
            for entry, source in sources.items()
            if source is not None and source.rows * source.cols > 1
        ]
        scenes += [path] if not fields or (own is not None and len(fields) == 1) else fields
    return scenes


def _described(path: Path, settings: config.Scene) -> SceneSource | None:
    """The light field at path; None if there is none."""
    with contextlib.suppress(UserError):
        return layouts.describe(path, settings)
    return None


def _preview(source: SceneSource) -> dict[str, Any]:
    """The view in the middle of a scene, of at most PREVIEW_PX, a PNG (red and blue exchanged) in base 64."""
    view = source.read(0, *source.middle)
    _, _, width, height = fit_area((view.shape[1], view.shape[0]), PREVIEW_PX)
    small = cv2.resize(view, (width, height), interpolation=cv2.INTER_AREA) / source.max_value
    values = np.rint(255 * np.clip(small, 0, 1) ** (1 / 2.2 if source.linear else 1.0)).astype(
        np.uint8
    )
    return {"png": base64.b64encode(cv2.imencode(".png", values)[1].tobytes()).decode()}


if __name__ == "__main__":
    serve(work, MEMORY_BYTES)
