"""Makes a pack of a light field in any layout, in canonical order: first its views, then its disparity."""

import contextlib
import importlib
import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import attrs
import numpy as np

import lfpipe
from lfpipe import config
from lfpipe.errors import UserError, plain
from lfpipe.scene import cache
from lfpipe.scene.disparity import NO_DEPTH
from lfpipe.scene.disparity_maps import write_disparity
from lfpipe.scene.examination import Examined, described, examined
from lfpipe.scene.files import library_errors
from lfpipe.scene.half_turn import shown_as
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.pack import VERSION, VIEWS, DamagedPackError, PlaneFile, light_field, open_pack, write_manifest
from lfpipe.scene.view_writer import NotGreyError, Progress, write_views

# Scores the methods of synthesis on the new pack. It belongs to a room above this one, so it is named and not imported.
CHOOSER = "lfpipe.render.scoring"
BLEND_PX = 2.0  # disparity up to which a cross-fade of neighbouring views shows no double edges worth mentioning


def silent(_what: str, _done: int, _total: int) -> None:
    """Ignores progress."""


def pack_scene(
    path: str | os.PathLike[str],
    settings: config.Scene,
    progress: Progress = silent,
    views_ready: Callable[[Path], None] = lambda pack: None,
) -> LightField:
    """The light field at path, from its pack, which is created or completed now if needed. Call it in a process with limits
    (`packer`): it reads a person's pictures.

    progress: called from this thread. views_ready: called with the pack's folder as soon as it can be shown without disparity.
    Several processes may call this at once; a killed one leaves a pack that a later call completes. Raises UserError.
    """
    pack = cache.find_pack(path, settings)
    field = None if pack is None else _opened(pack)
    if field is not None and field.complete:
        return shown_as(field, settings.half_turn)
    mark, root = cache.stamp(path, settings), cache.prepare_cache(settings)
    with library_errors(path):
        source = described(path, settings)
        key = cache.content_key(source, settings)
        folder = root / "scenes" / key

        def can_be_shown() -> None:
            cache.remember(root, mark, key)
            views_ready(folder)

        with cache.locked(root, key, lambda: progress("waiting for another packer", 0, 1)):
            field = _opened(folder)
            if field is not None and field.manifest["views"] and not field.complete:
                can_be_shown()
                _complete(attrs.evolve(examined(source, settings), channels=field.channels), folder, progress)
            elif field is None or not field.complete:
                scene = examined(source, settings)
                try:
                    _write_views(scene, folder, can_be_shown, progress)
                except NotGreyError:
                    scene = attrs.evolve(scene, channels=3)
                    _write_views(scene, folder, can_be_shown, progress)
                _complete(scene, folder, progress)
            cache.remember(root, mark, key)
            return open_pack(folder, settings.half_turn)


def _opened(pack: Path) -> LightField | None:
    with contextlib.suppress(DamagedPackError):
        return open_pack(pack)
    return None


def manifest_of(scene: Examined, key: str = "") -> dict[str, Any]:
    """The manifest of a pack without disparity. Its range is that of the few views that were compared."""
    source, depth = scene.source, scene.orientation.depth
    path = source.path.resolve()
    return {
        "version": VERSION, "views": False, "complete": False, "lfpipe": lfpipe.__version__, "key": key,
        "name": plain(path.stem if source.path.is_file() else path.name, 300),
        "source": plain(str(path), 10_000), "layout": source.layout, "files": len(source.files),
        "created": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()), "rows": scene.rows, "cols": scene.cols,
        "frames": source.frames, "height": source.height_px, "width": source.width_px, "channels": scene.channels,
        "bit_depth": source.bit_depth, "frame_rate_hz": source.frame_rate_hz, "flips": attrs.asdict(scene.turn),
        "orientation": scene.orientation.facts, "gamma": scene.gamma, "gamma_by": scene.gamma_by,
        "geometry": attrs.asdict(source.geometry), "present": scene.present.astype(int).tolist(),
        "offsets": scene.offsets.tolist() if source.coordinates is not None else None,
        "disparity": {"source": "none", "scale_px": 1 / 16, **(depth or NO_DEPTH)},
        "notes": list(source.notes), "scores": {},
        "method": "blend" if depth and max(-depth["min_px"], depth["max_px"]) <= BLEND_PX else "nearest",
    }  # fmt: skip


def _write_views(scene: Examined, folder: Path, can_be_shown: Callable[[], None], progress: Progress) -> None:
    """Writes the views of a pack. It appears with the first ones; those that follow replace copies of them."""
    root, manifest = folder.parent, manifest_of(scene, folder.name)
    needed, free = np.prod(scene.shape) * (1 + 0.75 / scene.channels) + (1 << 20), shutil.disk_usage(root).free
    if needed > free:
        raise UserError(
            f"{scene.source.path}: packed it takes {needed / 1e6:.0f} MB, {root} has {free / 1e6:.0f} MB free",
            "free some (`lfpipe scene clean`), or name another disk with --set scene.cache_dir=DIR",
        )
    working = root / f".{folder.name}.{os.getpid()}"

    def appear() -> None:
        write_manifest(working, manifest)
        shutil.rmtree(folder, ignore_errors=True)  # a killed packer's
        working.replace(folder)
        can_be_shown()

    try:
        with cache.writing(root.parent):
            working.mkdir()
            with PlaneFile(working / VIEWS, scene.shape) as views:
                write_views(scene, views, appear, progress)
            write_manifest(folder, {**manifest, "views": True})
    finally:
        shutil.rmtree(working, ignore_errors=True)


def _complete(scene: Examined, folder: Path, progress: Progress) -> None:
    """Writes the disparity of a pack with views; the manifest that announces it comes last."""
    with cache.writing(folder.parents[1]):
        with PlaneFile(folder / VIEWS) as views:
            disparity = write_disparity(scene, folder, views, progress)
        method = "warp" if max(-disparity["min_px"], disparity["max_px"]) >= 0.5 else "nearest"
        manifest = manifest_of(scene, folder.name) | {"views": True, "complete": True, "disparity": disparity, "method": method}
        if scene.rows * scene.cols > 1:
            progress("method", 0, 1)
            choose = importlib.import_module(CHOOSER).choose_method
            manifest["method"], manifest["scores"] = choose(light_field(folder, manifest))
            progress("method", 1, 1)
        write_manifest(folder, manifest)
