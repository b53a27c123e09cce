"""Packs a light field of any layout in canonical order: first the views, then the disparity, from
the flow between neighbouring views, or true disparity if it exists and matches better. For missing
views stands the nearest present one, or one view warped to the place of another by its disparity,
with holes filled from behind.
"""

import os
import shutil
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, TypeVar

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe._version import __version__
from lfpipe.errors import plain
from lfpipe.files.pictures import STRIP_ROWS
from lfpipe.host.files import exists, waited_for
from lfpipe.host.worker import usable_cores
from lfpipe.plugins import LAYOUTS, blaming
from lfpipe.scene.analysis import (
    CONFIRMED,
    AnalysedScene,
    FrameIndex,
    analyse_source,
    best_method,
    checked_source,
    is_grey,
)
from lfpipe.scene.disparity import (
    border_range,
    compared,
    confirmed_share,
    halved,
    luma,
    mean_square_mismatch,
    neighbours_of,
    quantised,
    scale_for,
    shrinking,
    stored_map,
    view_disparity,
)
from lfpipe.scene.lightfield import (
    UNKNOWN,
    Disparity,
    DisparitySource,
    LightField,
    Manifest,
    MethodScores,
)
from lfpipe.scene.optical_flow import SMALLEST_PX, FloatMap, displaced
from lfpipe.scene.pack import (
    DISPARITY,
    INTERIM,
    VIEWS,
    key_of,
    light_field,
    make_array,
    mapper,
    open_pack,
    packed,
    prepare_cache,
    usable,
    write_manifest,
    writing,
)
from lfpipe.scene.source import Progress, library_errors

_HIDDEN_PX = 1.0  # parallax that separates a surface from the one behind it


def nearest_present(present: NDArray[np.bool_], row: int, col: int) -> tuple[int, int]:
    """The present view closest to (row, col); among equals, the first in order."""
    rows, cols = np.nonzero(present)
    best = int(np.argmin((rows - row) ** 2 + (cols - col) ** 2))
    return int(rows[best]), int(cols[best])


def warped_disparity(disparity: FloatMap, down: float, across: float) -> FloatMap:
    """The disparity map of a view, warped to the view `down` rows and `across` columns further;
    float32 (h, w) both.

    If several surfaces land on a pixel, the nearest one is kept; pixels without any are filled from
    the farther neighbour.
    """
    height, width = disparity.shape
    order = np.argsort(disparity.ravel(), kind="stable")
    y, x = np.divmod(order, width)
    d = disparity.ravel()[order]
    to_x, to_y = np.rint(x - d * across).astype(np.intp), np.rint(y - d * down).astype(np.intp)
    inside = (to_x >= 0) & (to_x < width) & (to_y >= 0) & (to_y < height)
    out = np.full((height, width), np.inf, np.float32)
    if not inside.any():
        return disparity
    out[to_y[inside], to_x[inside]] = d[inside]
    cracks = np.asarray(
        cv2.medianBlur(np.where(np.isinf(out), np.float32(disparity.min()), out), 3), np.float32
    )
    for _ in range(height + width):
        empty = np.isinf(out)
        if not empty.any():
            break
        # the default border is the largest float, which is finite and would spread inwards
        out = np.where(
            empty, cv2.erode(out, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE), out
        )
    return np.maximum(out, cracks)


def nearest(usable: NDArray[np.bool_]) -> NDArray[np.intp]:
    """The flat index of the nearest usable pixel, by pixel (h, w)."""
    _, labels = cv2.distanceTransformWithLabels(
        (~usable).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    index = np.zeros(int(labels.max()) + 1, np.intp)
    index[labels[usable]] = np.flatnonzero(usable)
    return np.asarray(index[labels])


def warped_view(
    picture: NDArray[Any], disparity: FloatMap, target: FloatMap, down: float, across: float
) -> NDArray[Any]:
    """A view warped to the one `down` rows and `across` columns further, (h, w) or (h, w, 3).
    target: `warped_disparity` of disparity.

    If the source of a pixel shows a nearer surface, the pixel was hidden: the nearest pixel at its
    depth fills it.
    """
    by_px = np.dstack((target * np.float32(across), target * np.float32(down)))
    out = displaced(picture, by_px)
    step = max(abs(down), abs(across))
    hidden = (displaced(disparity, by_px) - target) * step > _HIDDEN_PX
    if not hidden.any():
        return out
    hidden = cv2.dilate(hidden.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    reach = 2 * int(step * float(np.ptp(disparity))) + 3
    behind = target - cv2.erode(
        target, np.ones((reach, reach), np.uint8), borderType=cv2.BORDER_REPLICATE
    ) < max(_HIDDEN_PX / max(step, 1e-9), 1e-6)
    usable = behind & ~hidden
    if not usable.any():
        return out
    flat = out.reshape(out.shape[0] * out.shape[1], -1).copy()
    flat[hidden.ravel()] = flat[nearest(usable)[hidden]]
    return flat.reshape(out.shape)


T = TypeVar("T")
Score = Callable[[LightField], MethodScores]
_BUFFER_BYTES = 200_000_000  # for views that are processed at the same time
_INTERIM_PX = 1 / 64  # step of the interim int16 maps, until the range of the whole scene is known
_UNKNOWN = int(np.iinfo(np.int16).min)  # in the interim maps: UNKNOWN


def pack_scene(
    path: str | os.PathLike[str],
    settings: config.Scene,
    score: Score = lambda field: MethodScores(),
    progress: Progress = lambda what, done, total: None,
    views_ready: Callable[[Path], None] = lambda pack: None,
) -> LightField:
    """The light field at path; packs it unless there is a complete pack. Call it in a process with
    limits (`packer`): it reads the user's pictures.

    score: scores the methods, once there is disparity. progress: called from this thread.
    views_ready: called with the pack's folder as soon as it can be shown without disparity. Several
    processes may call this at once; a later call replaces the unfinished pack of a killed process.
    Raises UserError.
    """
    field = packed(path, settings, complete=True)
    if field is not None:
        return field
    key = key_of(path, settings)
    root = prepare_cache(settings)
    folder = root / "scenes" / key
    with library_errors(path):
        source, settings = checked_source(path, settings)
        waiting = partial(progress, "waiting for another packer", 0, 1)
        with (
            blaming([(LAYOUTS, source.layout)]),
            waited_for(root / "locks" / key, waiting),
        ):
            if usable(folder, settings, complete=True) is None:
                scene = analyse_source(source, settings)
                try:
                    _write_views(scene, folder, views_ready, progress)
                except NotGreyError:
                    scene = attrs.evolve(scene, channels=3)
                    _write_views(scene, folder, views_ready, progress)
                _complete(scene, folder, score, progress)
            return open_pack(folder, settings.invert_depth)


def manifest_of(scene: AnalysedScene, key: str = "") -> Manifest:
    """The manifest of a pack without disparity.

    The disparity range is that of the few analysed views.
    """
    source = scene.source
    measured = scene.orientation.depth is not None
    path = source.path.resolve()
    return Manifest(
        complete=False,
        lfpipe=__version__,
        key=key,
        name=plain(path.stem if source.path.is_file() else path.name, 300),
        source=plain(str(path), 10_000),
        layout=source.layout,
        files=len(source.files),
        created=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        rows=scene.rows,
        cols=scene.cols,
        frames=source.frames,
        height=source.height_px,
        width=source.width_px,
        channels=scene.channels,
        bit_depth=source.max_value.bit_length(),
        frame_rate_hz=source.frame_rate_hz,
        flips=scene.turn,
        orientation=scene.orientation.facts(source.stated_inverted),
        gamma=scene.gamma,
        gamma_by=scene.gamma_by,
        geometry=source.geometry,
        present=scene.present.astype(int).tolist(),
        offsets=scene.offsets.tolist() if source.coordinates is not None else None,
        disparity=Disparity(**attrs.asdict(scene.depth)),
        notes=source.notes,
        method=best_method({}, scene.depth.reach_px, False) if measured else "nearest",
    )


class NotGreyError(Exception):
    """A view has colour although the analysed ones are grey."""


def _view_writer(
    scene: AnalysedScene, out: Callable[[], NDArray[Any]]
) -> Callable[[FrameIndex], None]:
    """A function that decodes one view into the array that out() maps; it raises UserError, and
    NotGreyError if the view has colour but the pack has one plane.
    """
    source = scene.source
    values = np.arange(source.max_value + 1, dtype=np.float64) / source.max_value
    # lookup table from source values to screen values
    table = np.asarray(np.rint(255 * values ** (1 / scene.gamma)), np.uint8)

    def write(place: FrameIndex) -> None:
        frame, row, col = place
        pixels = source.read(frame, *scene.file_index(row, col))
        if scene.channels == 1 and not is_grey(pixels):
            raise NotGreyError
        planes = out()[place]
        for top in range(0, len(pixels), STRIP_ROWS):
            screen = table[np.minimum(pixels[top : top + STRIP_ROWS], source.max_value)]
            for channel, plane in enumerate(planes):
                plane[top : top + STRIP_ROWS] = screen if screen.ndim == 2 else screen[..., channel]

    return write


def _write_views(
    scene: AnalysedScene, folder: Path, views_ready: Callable[[Path], None], progress: Progress
) -> None:
    """Writes the views of a new pack, those nearest to the middle of the grid first; a missing view
    gets a copy of the nearest one. Writes the manifest after the first views and calls
    views_ready.
    """

    def report(done: int) -> None:
        progress("views", done, len(views))

    views = sorted(
        scene.views,
        key=lambda place: (
            (place[1] - (scene.rows - 1) / 2) ** 2 + (place[2] - (scene.cols - 1) / 2) ** 2
        ),
    )
    written = np.zeros_like(scene.present)
    # the middle and its neighbours: sessions start in the middle of the grid
    first = min(len(views), 5) if scene.source.frames == 1 else len(views)
    item_bytes = 6 * scene.source.height_px * scene.source.width_px
    try:
        with writing(folder.parents[1]):
            if exists(folder):  # left by a killed packer
                shutil.rmtree(folder)
            folder.mkdir()
            out = make_array(folder / VIEWS, scene.shape)
            write = _view_writer(scene, out)
            report(0)
            for start, end in ((0, first), (first, len(views))):
                run_parallel(write, views[start:end], item_bytes, report, start)
                for _, row, col in views[start:end]:
                    written[row, col] = True
                for row, col in np.argwhere(~written).tolist():
                    planes = out()
                    planes[:, row, col] = planes[:, *nearest_present(written, row, col)]
                if start == 0:
                    write_manifest(folder, manifest_of(scene, folder.name))
                    views_ready(folder)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _complete(scene: AnalysedScene, folder: Path, score: Score, progress: Progress) -> None:
    """Writes the disparity of a pack with views, then the manifest that announces it."""
    with writing(folder.parents[1]):
        disparity = write_disparity(scene, folder, progress)
        manifest = attrs.evolve(
            manifest_of(scene, folder.name), complete=True, disparity=disparity, method="nearest"
        )
        if scene.rows * scene.cols > 1 and not scene.too_far_apart:
            progress("method", 0, 1)
            field = light_field(folder, manifest)
            measured = score(field)
            manifest = attrs.evolve(
                manifest,
                scores=measured.psnr_db,
                errors={name: tuple(errors) for name, errors in measured.errors.items()},
                method=best_method(
                    measured.psnr_db,
                    disparity.reach_px,
                    field.disparity is not None and disparity.confirmed >= CONFIRMED,
                ),
            )
            progress("method", 1, 1)
        write_manifest(folder, manifest)


def run_parallel(
    work: Callable[[T], None],
    items: Sequence[T],
    item_bytes: int,
    report: Callable[[int], None],
    before: int = 0,
) -> None:
    """Runs work(item) for every item in a few threads, fewer if each needs much memory; the first
    error stops it. report: called with the number of items done, including earlier ones.
    """
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # the pool is the parallelism
    pool = ThreadPoolExecutor(max(1, min(4, len(usable_cores()), _BUFFER_BYTES // item_bytes)))
    try:
        for number, _ in enumerate(pool.map(work, items), before + 1):
            report(number)
    finally:
        pool.shutdown(cancel_futures=True)
        cv2.setNumThreads(threads)


def write_disparity(scene: AnalysedScene, folder: Path, progress: Progress) -> Disparity:
    """Writes disparity.npy into the folder of a pack with views; returns its entry in the manifest.

    min_px and max_px are those of true disparity if there is any ("source"), else robust extremes
    of the estimates.
    """
    frames, rows, cols, _, height, width = scene.shape
    if scene.too_far_apart or int(scene.present.sum()) < 2 or min(height, width) < SMALLEST_PX:
        return Disparity(**attrs.asdict(scene.depth)) if scene.too_far_apart else Disparity()
    shape = (frames, rows, cols, (height + 1) // 2, (width + 1) // 2)
    views = mapper(folder / VIEWS)
    interim_file = folder / INTERIM
    interim = make_array(interim_file, shape, np.int16)
    out = make_array(folder / DISPARITY, shape, np.int8)
    about = _estimate(scene, views, interim, progress)
    scale_px = about.scale_px
    for place in scene.views:
        steps = interim()[place].astype(np.float32)
        steps[steps == _UNKNOWN] = np.nan
        out()[place] = quantised(steps * np.float32(_INTERIM_PX), scale_px)
    for row, col in np.argwhere(~scene.present).tolist():
        out()[:, row, col] = out()[:, *nearest_present(scene.present, row, col)]
    ends = out()[scene.source.telling, rows // 2, [0, cols // 2, cols - 1]]
    interim_file.unlink()
    low, high = border_range(np.where(ends == UNKNOWN, np.nan, ends * np.float32(scale_px)))
    confirmed = 1.0
    if rows * cols == 2:
        pair = out()[scene.source.telling].reshape(2, *shape[3:])
        confirmed = confirmed_share(pair, scale_px, 0 if cols == 2 else 1)
    return attrs.evolve(about, border_low_px=low, border_high_px=high, confirmed=confirmed)


def _estimate(
    scene: AnalysedScene,
    views: Callable[[], NDArray[Any]],
    interim: Callable[[], NDArray[Any]],
    progress: Progress,
) -> Disparity:
    """Writes every present view's map to interim(), in steps of _INTERIM_PX; returns the manifest's
    entry.
    """
    source = scene.source
    ranges: dict[FrameIndex, NDArray[np.float64]] = {}
    true_ranges: list[tuple[float, float]] = []

    @lru_cache(maxsize=3 * scene.cols + 4)
    def grey(frame: int, row: int, col: int) -> NDArray[np.uint8]:
        return compared(luma(views()[frame, row, col]))

    factor = shrinking(source.height_px, source.width_px)
    sign = scene.orientation.truth_sign

    def estimate(place: FrameIndex) -> None:
        frame, row, col = place
        here = grey(*place)
        around = neighbours_of(partial(grey, frame), row, col, scene.present, scene.offsets)
        best = view_disparity(here, around) if around and not source.rendered else None
        read = source.truth.get(scene.file_index(row, col)) if sign and not frame else None
        if read is not None:
            true = read() * np.float32(sign)  # true disparity refers to the layout's order
            true_ranges.append((float(true.min()), float(true.max())))
            true = true if factor == 1 else halved(true) / np.float32(factor)
            # True disparity is sharp at edges, where warped views duplicate hidden parts; flow
            # bends around them. The better match with the neighbouring views wins: flow, in all
            # scenes tried (HCI antinous 47.7 dB, true disparity 41.9).
            if best is None or mean_square_mismatch(here, around, true) < mean_square_mismatch(
                here, around, best
            ):
                best = true
        stored, unknown = stored_map(here, around, best, factor)
        ranges[place] = np.percentile(stored, (0.1, 99.9))
        steps = np.clip(stored * np.float32(1 / _INTERIM_PX), _UNKNOWN + 1, -_UNKNOWN - 1)
        steps[unknown] = _UNKNOWN
        interim()[place] = np.rint(steps).astype(np.int16)

    progress("disparity", 0, len(scene.views))
    run_parallel(
        estimate,
        scene.views,
        100 * source.height_px * source.width_px,  # bytes per px while it is estimated
        lambda done: progress("disparity", done, len(scene.views)),
    )
    spans = np.array(list(ranges.values()))
    scale = scale_for(*(round(float(v), 4) for v in (spans[:, 0].min(), spans[:, 1].max())))
    # true disparity is exact; the extremes of an estimate are its errors,
    # so use robust extremes over all views
    low, high = (round(float(v), 4) for v in np.median(spans, axis=0))
    if true_ranges:
        low = min(span[0] for span in true_ranges)
        high = max(span[1] for span in true_ranges)
    return Disparity(
        source=DisparitySource.TRUTH if true_ranges else DisparitySource.ESTIMATED,
        scale_px=scale,
        min_px=low,
        max_px=high,
    )
