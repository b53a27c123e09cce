"""Packs a light field in any layout into planar memory maps in canonical order: once; later calls open the pack."""

import contextlib
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
from lfpipe.scene import cache, layouts, screen_values
from lfpipe.scene.disparity_maps import write_disparity
from lfpipe.scene.files import library_errors
from lfpipe.scene.grid_geometry import grid_offsets
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.manifest import VERSION, DamagedPackError, contents, write_manifest
from lfpipe.scene.orientation import Orientation, orient
from lfpipe.scene.pack_files import PlaneFile, open_pack
from lfpipe.scene.plausibility import plausible
from lfpipe.scene.source import SceneSource
from lfpipe.scene.truth import without_implausible_truth
from lfpipe.scene.view_writer import NotGreyError, PackJob, Progress, write_views

ChooseMethod = Callable[[LightField], tuple[str, dict[str, Any]]]  # -> the best method here, and its scores


def _silent(what: str, done: int, total: int) -> None:
    """Ignores progress."""


def _room(root: Path, source: SceneSource, channels: int) -> None:
    """Raises UserError with both sizes if the disk has no room for the pack."""
    views = source.frames * source.rows * source.cols
    maps = views * ((source.height_px + 1) // 2) * ((source.width_px + 1) // 2)
    need = views * channels * source.height_px * source.width_px + 3 * maps + (1 << 20)
    free = shutil.disk_usage(root).free
    if need > free:
        raise UserError(
            f"{source.path}: packed it takes {need / 1e6:.0f} MB, {root} has {free / 1e6:.0f} MB free",
            "free some (`lfpipe scene clean`), or name another disk with --set scene.cache_dir=DIR",
        )


def _is_grey(source: SceneSource) -> bool:
    """Whether the corner views and the middle one are grey."""
    places = {(0, 0), (0, source.cols - 1), (source.rows // 2, source.cols // 2), (source.rows - 1, source.cols - 1)}
    return all(screen_values.is_grey(source.read(0, *place)) for place in places - source.missing)


def _gamma(source: SceneSource, scene: config.Scene) -> tuple[float, str]:
    """The exponent for this scene and the reason."""
    if scene.gamma != "auto":
        return float(scene.gamma), "set by scene.gamma"
    if source.linear:
        return screen_values.SCREEN_GAMMA, f"{source.layout} holds linear light"
    middle = min(
        ((r, c) for r in range(source.rows) for c in range(source.cols) if (r, c) not in source.missing),
        key=lambda place: abs(place[0] - source.rows // 2) + abs(place[1] - source.cols // 2),
    )
    if screen_values.looks_linear(source.read(0, *middle), source.max_value):
        return screen_values.SCREEN_GAMMA, "dark with black corners, like undeveloped plenoptic pictures; scene.gamma=1 keeps it"
    return 1.0, ""


@attrs.frozen
class Examined:
    """The result of examining a scene before packing. gamma: the exponent for its values, and the reason. channels: 1 or 3."""

    source: SceneSource
    orientation: Orientation
    gamma: float
    gamma_by: str
    channels: int


def examine_scene(path: str | os.PathLike[str], scene: config.Scene) -> Examined:
    """Examines the scene at path by its names and a few small views. Raises UserError if there is none."""
    with library_errors(path):
        return _examined(without_implausible_truth(layouts.describe(path, scene)), scene)


def _examined(source: SceneSource, scene: config.Scene) -> Examined:
    if not source.certain:
        source = plausible(source, scene.force)
    return Examined(source, orient(source, scene), *_gamma(source, scene), 1 if _is_grey(source) else 3)


def _make(root: Path, key: str, examined: Examined, progress: Progress, choose: ChooseMethod | None) -> Path:
    """Writes the pack of source under its key and returns its folder. The caller holds the lock of key."""
    source, orientation, channels = examined.source, examined.orientation, examined.channels
    _room(root, source, channels)
    started = time.monotonic()
    rows, cols = orientation.turn.grid(source.rows, source.cols)
    facts, orientation = orientation.facts(cols), orientation.packed(cols)
    present = np.ones((rows, cols), bool)
    for r in range(rows):
        for c in range(cols):
            present[r, c] = orientation.turn.file_index(r, c, rows, cols) not in source.missing
    folder = root / "scenes" / f".{key}.{os.getpid()}"
    folder.mkdir()
    try:
        offsets = grid_offsets(source.coordinates, orientation.turn, rows, cols)
        job = PackJob(source, orientation, folder, rows, cols, channels, present, offsets, progress)
        with PlaneFile.create(folder / "views.npy", job.shape, np.uint8, index_axes=3) as views:
            write_views(job, views, screen_values.screen_table(source.max_value, examined.gamma))
            disparity = write_disparity(job, views)
        name = source.path.resolve().stem if source.path.is_file() else source.path.resolve().name
        low, high = disparity["min_px"], disparity["max_px"]
        manifest: dict[str, Any] = {
            "version": VERSION, "lfpipe": lfpipe.__version__, "key": key, "name": plain(name, 300),
            "source": plain(str(source.path.resolve()), 10_000), "layout": source.layout, "files": len(source.files),
            "created": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()), "rows": rows, "cols": cols, "frames": source.frames,
            "height": source.height_px, "width": source.width_px, "channels": job.channels, "bit_depth": source.bit_depth,
            "frame_rate_hz": source.frame_rate_hz, "flips": attrs.asdict(orientation.turn),
            "orientation": facts,
            "gamma": examined.gamma, "gamma_by": examined.gamma_by, "geometry": attrs.asdict(source.geometry),
            "present": present.astype(int).tolist(), "offsets": offsets.tolist() if source.coordinates is not None else None,
            "disparity": disparity, "notes": list(source.notes),
            "method": "warp" if max(abs(low), abs(high)) >= 0.5 else "nearest", "scores": {},
        }  # fmt: skip
        manifest["contents"] = contents(folder, [path.name for path in folder.glob("*.npy")])
        write_manifest(folder, manifest)
        if choose is not None and rows * cols > 1:
            progress("method", 0, 1)
            manifest["method"], manifest["scores"] = choose(open_pack(folder))
            progress("method", 1, 1)
        manifest["seconds"] = round(time.monotonic() - started, 2)
        write_manifest(folder, manifest)
        folder.replace(root / "scenes" / key)
    except OSError as error:
        remedy = "check the disk, or use another one with --set scene.cache_dir=DIR"
        raise UserError(f"{folder.parent}: cannot write the pack: {error.strerror}", remedy) from None
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return root / "scenes" / key


def open_scene(
    path: str | os.PathLike[str], scene: config.Scene, progress: Progress | None = None, choose_method: ChooseMethod | None = None
) -> LightField:
    """The light field at path: opens its pack from the cache, after creating it if needed.

    progress: called from this thread with (what, done, total). choose_method: chooses the method that `auto` stands for, once,
    when the pack is created; without it a scene with disparity is warped. Several processes may call this at once; a killed one
    leaves nothing that looks complete. Raises UserError.
    """
    found = cache.find_pack(path, scene)
    if found is not None:
        with contextlib.suppress(DamagedPackError):
            return open_pack(found, scene.half_turn)
    mark = cache.stamp(path, scene)
    with library_errors(path):
        return _packed(path, scene, mark, progress or _silent, choose_method)


def _packed(
    path: str | os.PathLike[str], scene: config.Scene, mark: str, say: Progress, choose: ChooseMethod | None
) -> LightField:
    """The light field of a scene, packed now if needed."""
    source = without_implausible_truth(layouts.describe(path, scene))
    root = cache.prepare_cache(scene)
    key = cache.content_key(source, scene)
    folder = root / "scenes" / key
    with cache.locked(root, key):
        try:
            field = open_pack(folder, scene.half_turn)
        except DamagedPackError:
            shutil.rmtree(folder, ignore_errors=True)
            examined = _examined(source, scene)
            try:
                folder = _make(root, key, examined, say, choose)
            except NotGreyError:
                folder = _make(root, key, attrs.evolve(examined, channels=3), say, choose)
            field = open_pack(folder, scene.half_turn)
        cache.remember(root, mark, key)
    return field
