"""Makes a pack of a light field in any layout, in canonical order: first its views, then its disparity."""

import contextlib
import importlib
import logging
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
from lfpipe.scene.half_turn import shown_as
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.orientation import Orientation, orient
from lfpipe.scene.pack import VERSION, DamagedPackError, PlaneFile, light_field, open_pack, write_manifest
from lfpipe.scene.plausibility import plausible
from lfpipe.scene.source import SceneSource
from lfpipe.scene.truth import without_implausible_truth
from lfpipe.scene.view_writer import NotGreyError, PackJob, Progress, write_views

# Scores the methods of synthesis on the new pack. It belongs to a room above this one, so it is named and not imported.
CHOOSER = "lfpipe.render.scoring"
BLEND_PX = 2.0  # disparity up to which a cross-fade of neighbouring views shows no double edges worth mentioning
ViewsReady = Callable[[Path], None]
_log = logging.getLogger(__name__)


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
    """Whether the corner views and the middle one are grey; of rendered views, the middle one says it of all."""
    middle = source.rows // 2, source.cols // 2
    corners = {(0, 0), (0, source.cols - 1), (source.rows - 1, source.cols - 1)}
    places = {middle} if source.rendered else {middle} | corners
    return all(screen_values.is_grey(source.read(0, *place)) for place in places - source.missing)


def _gamma(source: SceneSource, scene: config.Scene) -> tuple[float, str]:
    """The exponent for this scene and the reason."""
    if scene.gamma != "auto":
        return float(scene.gamma), "set by scene.gamma"
    if source.linear:
        return screen_values.SCREEN_GAMMA, f"{source.layout} holds linear light"
    if source.rendered:
        return 1.0, ""
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


def silent(_what: str, _done: int, _total: int) -> None:
    """Ignores progress."""


def _ignore(_folder: Path) -> None:
    """Ignores a pack without disparity."""


def pack_scene(
    path: str | os.PathLike[str],
    scene: config.Scene,
    progress: Progress = silent,
    views_ready: ViewsReady = _ignore,
) -> LightField:
    """The light field at path, from its pack, which is created or completed now if needed. Call it in a process with limits
    (`packer`): it reads a person's pictures.

    progress: called from this thread. views_ready: called with the pack's folder as soon as it can be shown without disparity.
    Several processes may call this at once; a killed one leaves a pack that a later call completes. Raises UserError.
    """
    pack = cache.find_pack(path, scene)
    if pack is not None and (field := _opened(pack, scene)) is not None:
        if field.complete:
            return field
        views_ready(pack)
    mark = cache.stamp(path, scene)
    with library_errors(path):
        source = without_implausible_truth(layouts.describe(path, scene))
        root = cache.prepare_cache(scene)
        key = cache.content_key(source, scene)
        folder = root / "scenes" / key
        with cache.locked(root, key, lambda: progress("waiting for another packer", 0, 1)):
            field = _opened(folder, scene)
            if field is None:
                shutil.rmtree(folder, ignore_errors=True)
            if field is None or not field.complete:
                examined = _examined(source, scene)
                field = _packed(root, key, mark, examined, field, progress, views_ready)
            cache.remember(root, mark, key)
            return shown_as(field, scene.half_turn)


def _opened(pack: Path, scene: config.Scene) -> LightField | None:
    with contextlib.suppress(DamagedPackError):
        return open_pack(pack, scene.half_turn)
    return None


def _packed(
    root: Path, key: str, mark: str, examined: Examined, field: LightField | None, progress: Progress, views_ready: ViewsReady
) -> LightField:
    """Writes what is missing of a pack: all of it, or the disparity. field: the pack with its views, if it exists."""
    folder = root / "scenes" / key
    if field is not None:  # some view may have colour although the few examined ones are grey
        examined = attrs.evolve(examined, channels=field.channels)
    job = _job(examined, folder, progress)
    manifest = _manifest(examined, job, key)

    def can_be_shown(pack: Path) -> None:
        cache.remember(root, mark, key)
        views_ready(pack)

    try:
        if field is None or not field.manifest["views"]:
            _write_views(job, manifest, examined, can_be_shown)
        else:
            can_be_shown(folder)
        _complete(job, {**manifest, "views": True})
        return open_pack(folder)
    except NotGreyError:
        shutil.rmtree(folder, ignore_errors=True)
        return _packed(root, key, mark, attrs.evolve(examined, channels=3), None, progress, views_ready)
    except OSError as error:
        remedy = "free some space, or use another disk with --set scene.cache_dir=DIR"
        raise UserError(f"{folder.parent}: cannot write the pack: {error.strerror}", remedy) from None


def _job(examined: Examined, folder: Path, progress: Progress) -> PackJob:
    source = examined.source
    rows, cols = examined.orientation.turn.grid(source.rows, source.cols)
    orientation = examined.orientation.packed(cols)
    turn = orientation.turn
    present = np.array([[turn.file_index(r, c, rows, cols) not in source.missing for c in range(cols)] for r in range(rows)])
    offsets = grid_offsets(source.coordinates, turn, rows, cols)
    return PackJob(source, orientation, folder, rows, cols, examined.channels, present, offsets, progress)


def _manifest(examined: Examined, job: PackJob, key: str) -> dict[str, Any]:
    """The manifest of a pack without disparity. Its range is that of the few views that orientation has compared."""
    source, orientation = examined.source, job.orientation
    path = source.path.resolve()
    low, high = orientation.disparity_px or (0.0, 0.0)
    border_low, border_high = orientation.border_px
    if examined.orientation.half_turn(job.cols):
        low, high, border_low, border_high = -high, -low, -border_high, -border_low
    return {
        "version": VERSION, "views": False, "complete": False, "lfpipe": lfpipe.__version__, "key": key,
        "name": plain(path.stem if source.path.is_file() else path.name, 300),
        "source": plain(str(path), 10_000), "layout": source.layout, "files": len(source.files),
        "created": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()), "rows": job.rows, "cols": job.cols,
        "frames": source.frames, "height": source.height_px, "width": source.width_px, "channels": job.channels,
        "bit_depth": source.bit_depth, "frame_rate_hz": source.frame_rate_hz, "flips": attrs.asdict(orientation.turn),
        "orientation": examined.orientation.facts(job.cols),
        "gamma": examined.gamma, "gamma_by": examined.gamma_by, "geometry": attrs.asdict(source.geometry),
        "present": job.present.astype(int).tolist(), "offsets": job.offsets.tolist() if source.coordinates is not None else None,
        "disparity": {"source": "none", "scale_px": 1 / 16, "min_px": low, "max_px": high,
                      "border_low_px": border_low, "border_high_px": border_high},
        "notes": list(source.notes),
        "method": "blend" if orientation.disparity_px and max(-low, high) <= BLEND_PX else "nearest", "scores": {},
    }  # fmt: skip


def _write_views(job: PackJob, manifest: dict[str, Any], examined: Examined, can_be_shown: ViewsReady) -> None:
    """Writes the views of a pack. It appears with the first ones; those that follow replace copies of them."""
    root = job.folder.parent
    _room(root, job.source, job.channels)
    working = root / f".{job.folder.name}.{os.getpid()}"
    working.mkdir()

    def appear() -> None:
        write_manifest(working, manifest)
        shutil.rmtree(job.folder, ignore_errors=True)  # a killed packer's
        working.replace(job.folder)
        can_be_shown(job.folder)

    try:
        with PlaneFile.create(working / "views.npy", job.shape, np.uint8, index_axes=3) as views:
            table = screen_values.screen_table(job.source.max_value, examined.gamma)
            write_views(job, views, table, appear)
        write_manifest(job.folder, {**manifest, "views": True})
    finally:
        shutil.rmtree(working, ignore_errors=True)


def _complete(job: PackJob, manifest: dict[str, Any]) -> None:
    """Writes the disparity of a pack with views; the manifest that announces it comes last."""
    started = time.monotonic()
    with PlaneFile.open(job.folder / "views.npy", job.shape, np.uint8, index_axes=3) as views:
        disparity = write_disparity(job, views)
    low, high = disparity["min_px"], disparity["max_px"]
    method = "warp" if max(abs(low), abs(high)) >= 0.5 else "nearest"
    manifest = {**manifest, "complete": True, "disparity": disparity, "method": method}
    if job.rows * job.cols > 1:
        job.progress("method", 0, 1)
        manifest["method"], manifest["scores"] = importlib.import_module(CHOOSER).choose_method(light_field(job.folder, manifest))
        job.progress("method", 1, 1)
    manifest["seconds"] = round(time.monotonic() - started, 2)
    write_manifest(job.folder, manifest)
