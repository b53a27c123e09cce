"""A light field on disk, any layout -> a pack of planar memory maps in canonical order, made once and then opened."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

import lfpipe
from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene import cache, layouts, tone
from lfpipe.scene.disparity import SMALLEST_PX, halved, landing, luma, place_disparity, quantised, scale_for
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.orientation import Orientation, orient
from lfpipe.scene.place import grid_offsets, nearest_present, truth_sign
from lfpipe.scene.source import Source
from lfpipe.scene.store import DamagedPackError, PlaneFile, open_pack

Progress = Callable[[str, int, int], None]  # what is being done, how much of it is done, of how much
ChooseMethod = Callable[[LightField], tuple[str, dict[str, Any]]]  # -> the best method here, and its scores
T = TypeVar("T")

_INTERIM_PX = 1 / 64  # step of the interim int16 maps, until the range of the whole scene is known
_NO_LIMIT_PX = 400.0  # no disparity between neighbours is larger, whatever a map says


class _NotGreyError(Exception):
    """A view has colour although those looked at first had none."""


def _silent(what: str, done: int, total: int) -> None:
    """Progress that nobody watches."""


def workers() -> int:
    """Threads that decode and estimate: the cores this process may use, four at most (each holds a few views)."""
    return min(4, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)


def _in_parallel(work: Callable[[T], None], items: Iterable[T], done: Callable[[], None]) -> None:
    """work(item) for every item on a few threads, a bounded number in flight; the first error ends it."""
    waiting: Iterator[T] = iter(items)
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # the pool is the parallelism
    try:
        with ThreadPoolExecutor(workers()) as pool:
            while batch := list(islice(waiting, 4 * workers())):
                for future in [pool.submit(work, item) for item in batch]:
                    future.result()
                    done()
    finally:
        cv2.setNumThreads(threads)


def _room(root: Path, source: Source, channels: int) -> None:
    """Raises UserError where the disk is too small for the pack, with both sizes."""
    views = source.frames * source.rows * source.cols
    maps = views * ((source.height_px + 1) // 2) * ((source.width_px + 1) // 2)
    need = views * channels * source.height_px * source.width_px + 3 * maps + (1 << 20)
    free = shutil.disk_usage(root).free
    if need > free:
        raise UserError(
            f"{source.path}: packed it takes {need / 1e6:.0f} MB, {root} has {free / 1e6:.0f} MB free",
            "free some (`lfpipe scene clean`), or name another disk with --set scene.cache_dir=DIR",
        )


def _is_grey(source: Source) -> bool:
    """Whether the corner views and the middle one have no colour."""
    places = {(0, 0), (0, source.cols - 1), (source.rows // 2, source.cols // 2), (source.rows - 1, source.cols - 1)}
    return all(tone.is_grey(source.read(0, *place)) for place in places - source.missing)


def _gamma(source: Source, scene: config.Scene) -> tuple[float, str]:
    """The exponent for this scene and why."""
    if scene.gamma != "auto":
        return float(scene.gamma), "as told"
    if source.linear:
        return tone.SCREEN_GAMMA, f"{source.layout} holds linear light"
    middle = min(
        ((r, c) for r in range(source.rows) for c in range(source.cols) if (r, c) not in source.missing),
        key=lambda place: abs(place[0] - source.rows // 2) + abs(place[1] - source.cols // 2),
    )
    if tone.looks_linear(source.read(0, *middle), source.max_value):
        return tone.SCREEN_GAMMA, "dark with black corners, as undeveloped plenoptic pictures are; --gamma 1 leaves it as it is"
    return 1.0, ""


@attrs.frozen
class _Making:
    """What one run of the packer works on. turn and grid are canonical."""

    source: Source
    turn: Orientation
    folder: Path
    rows: int
    cols: int
    channels: int
    present: NDArray[np.bool_]
    offsets: NDArray[np.float32]
    progress: Progress

    def places(self) -> list[tuple[int, int, int]]:
        return [(f, r, c) for f in range(self.source.frames) for r in range(self.rows) for c in range(self.cols)]

    def ticker(self, what: str, total: int) -> Callable[[], None]:
        done = 0

        def tick() -> None:
            nonlocal done
            done += 1
            self.progress(what, done, total)

        self.progress(what, 0, total)
        return tick


def _write_views(job: _Making, table: NDArray[np.uint8]) -> PlaneFile:
    """Decode every view into views.npy; places without a view get the nearest one's copy."""
    source = job.source
    shape = (source.frames, job.rows, job.cols, job.channels, source.height_px, source.width_px)
    out = PlaneFile.create(job.folder / "views.npy", shape, np.uint8, index_axes=3)

    def one(place: tuple[int, int, int]) -> None:
        frame, row, col = place
        pixels = source.read(frame, *job.turn.turn.file_place(row, col, job.rows, job.cols))
        if job.channels == 1 and not tone.is_grey(pixels):
            raise _NotGreyError
        if pixels.ndim == 3 and job.channels == 1:
            pixels = pixels[..., 0]
        screen = tone.to_screen(pixels, table)
        planes = [screen] * job.channels if screen.ndim == 2 else list(cv2.split(screen))
        out.write(place, np.stack(planes))

    there = [place for place in job.places() if job.present[place[1:]]]
    _in_parallel(one, there, job.ticker("views", len(there)))
    for place in job.places():
        if not job.present[place[1:]]:
            out.write(place, out.read((place[0], *nearest_present(job.present, *place[1:]))))
    return out


def _truth(job: _Making, place: tuple[int, int, int]) -> NDArray[np.float32] | None:
    """The true map of a place with its sign, or None. Raises UserError where it is not usable."""
    row, col = job.turn.turn.file_place(place[1], place[2], job.rows, job.cols)
    sign = truth_sign(job.source.turn, job.turn.turn)
    if (row, col) not in job.source.truth or not sign or place[0]:
        return None
    found = job.source.truth[row, col]()
    size = (job.source.height_px, job.source.width_px)
    where = f"{job.source.path}: true disparity of the view in row {row} column {col}"
    remedy = "move the map away to have it estimated"
    if found.shape != size:
        raise UserError(f"{where} has {found.shape[1]}x{found.shape[0]} values, the views {size[1]}x{size[0]} px", remedy)
    if bad := int(np.count_nonzero(~np.isfinite(found))):
        raise UserError(f"{where}: {bad} of {found.size} values are no numbers (NaN or infinite)", remedy)
    return found * np.float32(sign)


def _write_disparity(job: _Making, views: PlaneFile) -> dict[str, Any]:
    """disparity.npy and its entry in the manifest: flow between neighbours, or truth where it is given and lands better.

    min_px and max_px are those of the truth where there is any ("source"), else the usual extremes of the estimates.
    """
    source = job.source
    size = ((source.height_px + 1) // 2, (source.width_px + 1) // 2)
    if int(job.present.sum()) < 2 or min(source.height_px, source.width_px) < SMALLEST_PX:
        return {"source": "none", "scale_px": 1 / 16, "min_px": 0.0, "max_px": 0.0, "truth_views": 0, "estimated_views": 0}
    shape = (source.frames, job.rows, job.cols, *size)
    interim = PlaneFile.create(job.folder / "interim.npy", shape, np.int16, index_axes=3)
    ranges: dict[tuple[int, int, int], NDArray[np.float64]] = {}
    true_ranges: list[tuple[float, float]] = []
    errors: list[float] = []
    kept: list[tuple[int, int, int]] = []

    @lru_cache(maxsize=3 * job.cols + 4)
    def grey(frame: int, row: int, col: int) -> NDArray[np.uint8]:
        return luma(views.read((frame, row, col)))

    def one(place: tuple[int, int, int]) -> None:
        frame, row, col = place
        at = partial(grey, frame)
        use = place_disparity(at, row, col, job.present, job.offsets)
        true = _truth(job, place)
        if true is not None:
            true_ranges.append((float(true.min()), float(true.max())))
            if use is not None:
                errors.append(float(np.median(np.abs(true - use))))
            # Truth is sharp at edges, where a view warped by it doubles what it hides; flow bends round them. The one that
            # lands better on the neighbouring views is kept: with the scenes tried, flow (HCI antinous 47.7 dB, truth 41.9).
            if use is None or landing(at, row, col, true, job.present, job.offsets) < landing(
                at, row, col, use, job.present, job.offsets
            ):
                use = true
                kept.append(place)
        if use is None:
            use = np.zeros((source.height_px, source.width_px), np.float32)
        ranges[place] = np.percentile(use[::2, ::2], (0.1, 99.9))
        steps = np.clip(halved(use), -_NO_LIMIT_PX, _NO_LIMIT_PX) * np.float32(1 / _INTERIM_PX)
        interim.write(place, np.rint(steps).astype(np.int16))

    there = [place for place in job.places() if job.present[place[1:]]]
    _in_parallel(one, there, job.ticker("disparity", len(there)))
    spans = np.array(list(ranges.values()))
    scale = scale_for(float(spans[:, 0].min()), float(spans[:, 1].max()))
    # Truth is exact; the extremes of an estimate are its mistakes, so all views are asked together, and robustly.
    low, high = (float(v) for v in np.median(spans, axis=0))
    if true_ranges:
        low, high = min(span[0] for span in true_ranges), max(span[1] for span in true_ranges)
    out = PlaneFile.create(job.folder / "disparity.npy", shape, np.int8, index_axes=3)
    for place in job.places():
        there_or_near = place if job.present[place[1:]] else (place[0], *nearest_present(job.present, *place[1:]))
        out.write(place, quantised(interim.read(there_or_near).astype(np.float32) * np.float32(_INTERIM_PX), scale))
    out.close()
    interim.close()
    (job.folder / "interim.npy").unlink()
    return {
        "source": "truth" if true_ranges else "estimated", "scale_px": scale, "min_px": low, "max_px": high,
        "truth_views": len(true_ranges), "truth_kept": len(kept), "estimated_views": len(ranges) - len(kept),
        "median_error_px": float(np.median(errors)) if errors else None,
    }  # fmt: skip


def _make(
    root: Path, key: str, source: Source, scene: config.Scene, progress: Progress, choose: ChooseMethod | None, grey: bool
) -> Path:
    """Write the pack of source under its key and return its folder. The lock of key is held."""
    _room(root, source, 1 if grey else 3)
    started = time.monotonic()
    gamma, gamma_by = _gamma(source, scene)
    orientation = orient(source, scene)
    rows, cols = orientation.turn.grid(source.rows, source.cols)
    present = np.ones((rows, cols), bool)
    for r in range(rows):
        for c in range(cols):
            present[r, c] = orientation.turn.file_place(r, c, rows, cols) not in source.missing
    folder = root / "scenes" / f".{key}.{os.getpid()}"
    folder.mkdir()
    try:
        offsets = grid_offsets(source.coordinates, orientation.turn, rows, cols)
        job = _Making(source, orientation, folder, rows, cols, 1 if grey else 3, present, offsets, progress)
        views = _write_views(job, tone.screen_table(source.max_value, gamma))
        disparity = _write_disparity(job, views)
        views.close()
        low, high = disparity["min_px"], disparity["max_px"]
        manifest: dict[str, Any] = {
            "version": cache.VERSION, "lfpipe": lfpipe.__version__, "key": key, "name": source.path.resolve().stem,
            "source": str(source.path.resolve()), "layout": source.layout, "files": len(source.files),
            "created": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()), "rows": rows, "cols": cols, "frames": source.frames,
            "height": source.height_px, "width": source.width_px, "channels": job.channels, "bit_depth": source.bit_depth,
            "frame_rate_hz": source.frame_rate_hz, "flips": attrs.asdict(orientation.turn),
            "orientation": {"by": orientation.by, "sure": orientation.sure, "said": orientation.said,
                            "undecided": orientation.undecided},
            "gamma": gamma, "gamma_by": gamma_by, "geometry": attrs.asdict(source.geometry),
            "present": present.astype(int).tolist(), "offsets": offsets.tolist() if source.coordinates is not None else None,
            "disparity": disparity, "notes": list(source.notes),
            "method": "warp" if max(abs(low), abs(high)) >= 0.5 else "nearest", "scores": {},
        }  # fmt: skip
        _finish(folder, manifest)
        if choose is not None and rows * cols > 1:
            progress("method", 0, 1)
            manifest["method"], manifest["scores"] = choose(open_pack(folder))
            progress("method", 1, 1)
        manifest["seconds"] = round(time.monotonic() - started, 2)
        _finish(folder, manifest)
        folder.replace(root / "scenes" / key)
    except OSError as error:
        remedy = "check the disk, or name another with --set scene.cache_dir=DIR"
        raise UserError(f"{folder.parent}: cannot write the pack: {error.strerror}", remedy) from None
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return root / "scenes" / key


def _finish(folder: Path, manifest: dict[str, Any]) -> None:
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=1))


def open_scene(
    path: str | os.PathLike[str], scene: config.Scene, progress: Progress | None = None, choose_method: ChooseMethod | None = None
) -> LightField:
    """The light field at path: its pack from the cache, made first where there is none.

    progress: called from this thread with (what, done, total). choose_method: finds the method that `auto` stands for,
    once, when the pack is made; without it a scene with disparity is warped. Safe with several processes at once; a
    killed one leaves nothing that looks whole. Raises UserError.
    """
    found = cache.find_pack(path, scene)
    if found is not None:
        with contextlib.suppress(DamagedPackError):
            return open_pack(found)
    say = progress or _silent
    mark = cache.stamp(path, scene)
    source = layouts.describe(path, scene)
    root = cache.prepared(scene)
    key = cache.content_key(source, scene)
    folder = root / "scenes" / key
    with cache.locked(root, key):
        try:
            field = open_pack(folder)
        except DamagedPackError:
            shutil.rmtree(folder, ignore_errors=True)
            grey = _is_grey(source)
            try:
                folder = _make(root, key, source, scene, say, choose_method, grey)
            except _NotGreyError:
                folder = _make(root, key, source, scene, say, choose_method, False)
            field = open_pack(folder)
        cache.remember(root, mark, key)
    return field
