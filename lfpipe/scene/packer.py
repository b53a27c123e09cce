"""The packer: the only program that reads the user's pictures, in a child process with limits on
memory, time and output.

`open_scene.Packing` runs `python -m lfpipe.scene.packer` with a `PackerRequest`. Steps, each a JSON
object:

    {"scenes": [path, ...], "note": "..."}       the light fields; the first is opened
    {"unusable": {path: why}}                   those that cannot be opened; the next one is
    {"step": "views", "done": 7, "total": 81}   progress
    {"summary": {...}}                          the pack can be shown, still without disparity

Result: the summary of the pack, or the `Manifest` of the scene. Facts about a
scene, for people and programs, are those of its pack, or of an analysis if there is none yet.
"""

import contextlib
import os
import pkgutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from lfpipe.config import Scene, converter
from lfpipe.errors import UserError
from lfpipe.files.safe_files import watch_files
from lfpipe.host.files import is_dir
from lfpipe.host.worker import Report, serve
from lfpipe.scene import layouts
from lfpipe.scene.analysis import AnalysedScene, analyse_scene
from lfpipe.scene.lightfield import DisparitySource, LightField, Manifest, MethodScores
from lfpipe.scene.pack import PackerRequest, cache_dir, open_pack, packed, remember_scene, summarize
from lfpipe.scene.packing import Score, manifest_of, pack_scene
from lfpipe.scene.source import DEEPEST, SceneSource, is_picture, natural


def scene_manifest(scene: AnalysedScene) -> Manifest:
    """The manifest of an analysed scene before it is packed, in display order. Offsets are rounded
    to keep a child's answer below 1 MB.
    """
    manifest = manifest_of(scene)
    manifest = attrs.evolve(
        manifest,
        method="",
        disparity=attrs.evolve(
            manifest.disparity,
            source=DisparitySource.UNKNOWN
            if scene.orientation.depth is None
            else DisparitySource.ESTIMATED,
        ),
        offsets=manifest.offsets and np.round(manifest.offsets, 3).tolist(),
    )
    return manifest.inverted() if scene.orientation.invert_depth else manifest


def facts(manifest: Manifest, pack: str = "") -> dict[str, Any]:
    """What `lfpipe scene info --json` prints. pack: its folder, "" if there is none."""
    return {**attrs.asdict(manifest), "pack": pack or None, "pack_bytes": _size_bytes(pack)}


def _size_bytes(pack: str) -> int:
    return sum(file.stat().st_size for file in Path(pack).glob("*")) if pack else 0


def lines(manifest: Manifest, pack: str = "") -> list[str]:
    """The facts for people."""
    order, about, flips = manifest.orientation, manifest.disparity, manifest.flips
    turned = ["rows reversed"] * flips.rows + ["columns reversed"] * flips.cols
    turned += ["rows and columns swapped"] * flips.transpose
    tone = f", gamma {manifest.gamma:g} ({manifest.gamma_by})" if manifest.gamma != 1 else ""
    sure = ", sure" if order.sure else ""
    where = "" if pack else " from a few views"
    units = [
        f"{name.replace('_', ' ')} {value:g} {unit}"
        for key, value in attrs.asdict(manifest.geometry).items()
        for name, unit in [key.rsplit("_", 1)]
        if value
    ]
    scores = ", ".join(f"{name} {value:.1f} dB" for name, value in manifest.scores.items())
    quality = f" (quality when predicting held-out views: {scores})" if scores else ""
    entries = [
        (
            "depth",
            f"{manifest.bit_depth} bit, {'colour' if manifest.channels == 3 else 'grey'}{tone}",
        ),
        (
            "order",
            f"{' and '.join(turned) or 'as in the files'}: {order.reason} ({order.by}{sure})",
        ),
        (
            "undecided",
            order.undecided and f"{order.undecided}; `lfpipe scene describe` states what is right",
        ),
        (
            "video",
            f"{manifest.frames} frames at {manifest.frame_rate_hz:g} Hz" * (manifest.frames > 1),
        ),
        (
            "disparity",
            {
                DisparitySource.NONE: "none",
                DisparitySource.UNKNOWN: "measured when the scene is packed",
            }.get(
                about.source,
                f"{about.min_px:+.2f} to {about.max_px:+.2f} px per view, {about.source}{where}",
            ),
        ),
        ("geometry", ", ".join(units) or "not known"),
        ("method", manifest.method and f"{manifest.method}{quality}"),
        *(("note", note) for note in manifest.notes),
        (
            "pack",
            f"{_size_bytes(pack) / 1e6:.1f} MB in {pack}"
            if pack
            else "none yet: `lfpipe scene pack` or `up` makes it",
        ),
    ]
    size = f"{manifest.rows}x{manifest.cols} views of {manifest.width}x{manifest.height} px"
    head = f"{manifest.name}: {size}, layout {manifest.layout}"
    return [head, *(f"  {what:11} {text}" for what, text in entries if text)]


def expected_field(manifest: Manifest) -> LightField:
    """The expected pack of an unpacked scene: views and disparities are zeros that take no memory,
    and the method is that of most scenes.
    """
    warped = manifest.disparity.source is not DisparitySource.NONE
    return LightField.of(
        attrs.evolve(manifest, method="warp2" if warped else "nearest"),
        np.broadcast_to(np.uint8(0), manifest.views_shape),
        np.broadcast_to(np.int8(0), manifest.disparity_shape) if warped else None,
    )


MEMORY_BYTES = 1 << 30  # mapped files do not count
MAX_WHY = 100  # characters of a reason: a message holds those of hundreds of scenes
MAX_ENTRIES = 1000  # of a folder that is searched


def work(request: dict[str, Any], report: Report) -> dict[str, Any]:
    """The result of a request. Raises UserError."""
    task = converter().structure(request, PackerRequest)
    settings = task.settings
    paths = [Path(text) for text in task.scenes]
    watch_files(lambda path: report(reading=str(path)))

    def progress(what: str, done: int, total: int) -> None:
        report(step=what, done=done, total=total)

    def views_ready(pack: Path) -> None:
        if task.shown:
            with contextlib.suppress(OSError):
                os.nice(15)
        report(summary=attrs.asdict(summarize(open_pack(pack, settings.invert_depth))))

    paths, others = playlist(paths, settings) if task.expand else (paths, 0)
    beside = f"; other pictures, not shown: {others}" * bool(others)
    note = f"{len(paths)} scenes{beside}" * (len(paths) > 1)
    if task.do == "info":
        manifest = scene_manifest(analyse_scene(paths[0], settings))
        return attrs.asdict(manifest) | {"notes": [*manifest.notes, *filter(None, [note])]}
    score: Score = pkgutil.resolve_name(task.scorer) if task.scorer else lambda _: MethodScores()
    unusable = dict[str, str]()
    while True:
        report(scenes=[*map(str, paths)], note=note * bool(others))
        try:
            field = pack_scene(paths[0], settings, score, progress, views_ready)
            break
        except UserError as error:
            unusable[str(paths[0])] = error.message.replace(str(paths[0]), paths[0].name)[:MAX_WHY]
            report(unusable=unusable)
            if len(unusable) == len({*paths}):
                raise
            paths = [*paths[1:], paths[0]]
    # the demo is always available
    if task.remember and not paths[0].is_relative_to(cache_dir(settings)):
        remember_scene(paths[0])
    return attrs.asdict(summarize(field))


def playlist(paths: Iterable[Path], settings: Scene) -> tuple[list[Path], int]:
    """Replaces each folder that is not a light field itself, or only by one of its files or a pair,
    by the light fields in it and in its folders, in order of name. Also returns the number of other
    pictures there.

    A path that is neither stays: opening it reports the error.
    """
    scenes = list[Path]()
    others = 0
    for path in paths:
        field = None
        with contextlib.suppress(UserError):
            field = packed(path, settings)
        inside, more = ([path], 0) if field is not None else _scenes_in(path, settings, DEEPEST)
        scenes += inside or [path]
        others += more
    return scenes, others


def _scenes_in(path: Path, settings: Scene, depth: int) -> tuple[list[Path], int]:
    """The light fields at a path, none if there is none, and the number of other pictures."""
    own = _light_field_at(path, settings)
    fields, entries = list[Path](), list[Path]()
    if depth and (own is None or len(own.files) <= 2) and is_dir(path):
        with contextlib.suppress(OSError):
            entries = sorted(path.iterdir(), key=lambda entry: natural(entry.name))[:MAX_ENTRIES]
    used = set[Path]()  # the second pictures of pairs, too, and the folders of both
    others = 0
    for entry in (*(own.playlist if own else ()), *entries):
        if entry.name.startswith(".") or entry in used:
            continue
        if is_dir(entry):
            inside, more = _scenes_in(entry, settings, depth - 1)
            fields, others = fields + inside, others + more
        elif (source := _light_field_at(entry, settings)) is None:
            others += is_picture(entry)
        else:
            fields.append(entry)
            used.update(source.files, (file.parent for file in source.files))
    return ([path] if own is not None and len(fields) < 2 else fields), others


def _light_field_at(path: Path, settings: Scene) -> SceneSource | None:
    """The light field at path; None if there is none."""
    with contextlib.suppress(UserError):
        source = layouts.describe(path, settings)
        return source if source.rows * source.cols > 1 else None
    return None


if __name__ == "__main__":
    serve(work, MEMORY_BYTES)
