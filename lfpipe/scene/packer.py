"""The packer: the only program that reads a person's pictures, as a child with limits on memory, time and output.

`python -m lfpipe.scene.packer`, by `open_scene.Packing`. Request: {"do": "pack", "info" or "make", "scenes": [path, ...],
"expand": whether folders of light fields stand for what is in them, "remember": whether to note the scene as recent, "config":
the table [scene]}. Steps, one JSON object each:

    {"scenes": [path, ...]}                     expand: the light fields; the first of them is opened
    {"step": "views", "done": 7, "total": 81}   progress
    {"summary": {...}}                          the pack can be shown, still without disparity

"make" writes a light field into the folder "out", from a video. Result: {"summary": {...}} of the pack, {"info": {...}}, or
{"slide": {...}}.
"""

import contextlib
from pathlib import Path
from typing import Any

import attrs

from lfpipe import config
from lfpipe.host.processes import set_scheduling
from lfpipe.host.worker import Report, serve
from lfpipe.scene import packing
from lfpipe.scene.cache import cache_dir
from lfpipe.scene.info import describe_examined
from lfpipe.scene.pack import open_pack, summarize
from lfpipe.scene.playlist import playlist
from lfpipe.scene.recent_scenes import remember_scene
from lfpipe.scene.slide import make_slide

NICE = 15
MEMORY_BYTES = 1 << 30  # mapped files do not count


def work(request: dict[str, Any], report: Report) -> dict[str, Any]:
    """The result of a request. Raises UserError."""
    settings = config.Scene(**request["config"])

    def progress(what: str, done: int, total: int) -> None:
        report(step=what, done=done, total=total)

    def views_ready(pack: Path) -> None:
        with contextlib.suppress(OSError):
            set_scheduling((), NICE)  # from now on it works beside the session that shows the pack
        report(summary=attrs.asdict(summarize(open_pack(pack, settings.half_turn))))

    paths = [Path(text) for text in request["scenes"]]
    if request["do"] == "make":
        made = make_slide(paths[0], Path(request["out"]), progress)
        return {"slide": {**attrs.asdict(made), "folder": str(made.folder)}}
    if request["expand"]:
        paths = playlist(paths, settings)
        report(scenes=[str(path) for path in paths])
    if request["do"] == "info":
        return {"info": describe_examined(packing.examine_scene(paths[0], settings))}
    field = packing.pack_scene(paths[0], settings, progress, views_ready)
    if request["remember"] and not paths[0].is_relative_to(cache_dir(settings)):  # the demo is always there
        remember_scene(paths[0])
    return {"summary": attrs.asdict(summarize(field))}


if __name__ == "__main__":
    serve(work, MEMORY_BYTES)
