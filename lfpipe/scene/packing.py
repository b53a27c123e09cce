"""Makes a pack of a light field in any layout, in canonical order: first its views, then its
disparity.
"""

import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

import lfpipe
from lfpipe import config
from lfpipe.errors import plain
from lfpipe.host import file_lock
from lfpipe.scene import cache
from lfpipe.scene.disparity_maps import run_parallel, write_disparity
from lfpipe.scene.examination import (
    STRIP_ROWS,
    Examined,
    FrameIndex,
    checked_source,
    examine_source,
    is_grey,
)
from lfpipe.scene.files import library_errors
from lfpipe.scene.lightfield import Disparity, LightField, Manifest
from lfpipe.scene.missing_views import nearest_present
from lfpipe.scene.pack import (
    VIEWS,
    light_field,
    make_array,
    open_pack,
    write_manifest,
)
from lfpipe.scene.source import Progress
from lfpipe.scene.verdict import best_method

# PSNR in dB of held-out views of a packed light field by method
Score = Callable[[LightField], dict[str, float]]
FIRST_VIEWS = 5  # the middle and its neighbours: a viewer begins in the middle of the grid


def pack_scene(
    path: str | os.PathLike[str],
    settings: config.Scene,
    score: Score = lambda field: {},
    progress: Progress = lambda what, done, total: None,
    views_ready: Callable[[Path], None] = lambda pack: None,
) -> LightField:
    """The light field at path, from its pack, which is made now unless there is a complete one.
    Call it in a process with limits (`packer`): it reads a person's pictures.

    score: scores the methods, once there is disparity. progress: called from this thread.
    views_ready: called with the pack's folder as soon as it can be shown without disparity. Several
    processes may call this at once; what a killed one leaves, a later call makes again. Raises
    UserError.
    """
    field = cache.packed(path, settings, complete=True)
    if field is not None:
        return field
    mark = cache.stamp(path, settings)
    root = cache.prepare_cache(settings)
    with library_errors(path):
        source = checked_source(path, settings)
        key = cache.content_key(source, settings)
        folder = root / "scenes" / key

        def can_be_shown() -> None:
            cache.remember(root, mark, key)
            views_ready(folder)

        with file_lock.waited_for(
            root / "locks" / key, lambda: progress("waiting for another packer", 0, 1)
        ):
            if cache.usable(folder, settings, complete=True) is None:
                scene = examine_source(source, settings)
                try:
                    _write_views(scene, folder, can_be_shown, progress)
                except NotGreyError:
                    scene = attrs.evolve(scene, channels=3)
                    _write_views(scene, folder, can_be_shown, progress)
                _complete(scene, folder, score, progress)
            cache.remember(root, mark, key)
            return open_pack(folder, settings.half_turn)


def manifest_of(scene: Examined, key: str = "") -> Manifest:
    """The manifest of a pack without disparity.

    Its range is that of the few views that were compared.
    """
    source = scene.source
    known = scene.orientation.depth is not None
    path = source.path.resolve()
    return Manifest(
        complete=False,
        lfpipe=lfpipe.__version__,
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
        bit_depth=source.bit_depth,
        frame_rate_hz=source.frame_rate_hz,
        flips=scene.turn,
        orientation=scene.orientation.facts,
        gamma=scene.gamma,
        gamma_by=scene.gamma_by,
        geometry=source.geometry,
        present=scene.present.astype(int).tolist(),
        offsets=scene.offsets.tolist() if source.coordinates is not None else None,
        disparity=Disparity(**attrs.asdict(scene.depth)),
        notes=source.notes,
        method=best_method({}, scene.depth.reach_px, False) if known else "nearest",
    )


class NotGreyError(Exception):
    """A view has colour although the examined ones had none."""


def _view_writer(scene: Examined, out: Callable[[], NDArray[Any]]) -> Callable[[FrameIndex], None]:
    """A function that decodes one view into the array that out() maps; it raises UserError, and
    NotGreyError if the view has colour but the pack has no planes for it.
    """
    source = scene.source
    values = np.arange(source.max_value + 1, dtype=np.float64) / source.max_value
    # the screen value of each value of the source
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
    scene: Examined, folder: Path, can_be_shown: Callable[[], None], progress: Progress
) -> None:
    """Writes the views of a new pack, those nearest to the middle of the grid first; places without
    a view get a copy of the nearest one. The manifest, without which it is no pack, comes with the
    first views, and then can_be_shown is called.
    """

    def away(place: FrameIndex) -> float:
        return (place[1] - (scene.rows - 1) / 2) ** 2 + (place[2] - (scene.cols - 1) / 2) ** 2

    def report(done: int) -> None:
        progress("views", done, len(views))

    views = sorted(scene.views, key=away)
    written = np.zeros_like(scene.present)
    first = min(len(views), FIRST_VIEWS) if scene.source.frames == 1 else len(views)
    item_bytes = 6 * scene.source.height_px * scene.source.width_px
    with cache.writing(folder.parents[1]):
        cache.clear(folder)  # a killed packer's
        folder.mkdir()
    try:
        with cache.writing(folder.parents[1]):
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
                    can_be_shown()
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _complete(scene: Examined, folder: Path, score: Score, progress: Progress) -> None:
    """Writes the disparity of a pack with views; the manifest that announces it comes last."""
    with cache.writing(folder.parents[1]):
        disparity = write_disparity(scene, folder, progress)
        manifest = attrs.evolve(
            manifest_of(scene, folder.name), complete=True, disparity=disparity, method="nearest"
        )
        if scene.rows * scene.cols > 1 and not scene.too_far_apart:
            progress("method", 0, 1)
            field = light_field(folder, manifest)
            scores = score(field)
            manifest = attrs.evolve(
                manifest,
                scores=scores,
                method=best_method(scores, disparity.reach_px, field.disparity is not None),
            )
            progress("method", 1, 1)
        write_manifest(folder, manifest)
