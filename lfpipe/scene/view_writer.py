"""Writes the views of a pack: decodes them on a few threads, the nearest to the middle of the grid first."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.host.processes import usable_cores
from lfpipe.scene.examination import STRIP_ROWS, Examined, FrameIndex, is_grey
from lfpipe.scene.pack import array

Progress = Callable[[str, int, int], None]  # task, steps done, steps in total
T = TypeVar("T")
FIRST_VIEWS = 5  # the middle and its neighbours: a viewer begins in the middle of the grid
_ROOM_BYTES = 200_000_000  # for views decoded at the same time


class NotGreyError(Exception):
    """A view has colour although the examined ones had none."""


def run_parallel(work: Callable[[T], None], items: Sequence[T], item_bytes: int, done: Callable[[int], None]) -> None:
    """Runs work(item) for every item on a few threads, fewer if each needs much memory; the first error ends it. done: called
    with the number of items done so far."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # the pool is the parallelism
    pool = ThreadPoolExecutor(max(1, min(4, len(usable_cores()), _ROOM_BYTES // item_bytes)))
    try:
        for number, _ in enumerate(pool.map(work, items), 1):
            done(number)
    finally:
        pool.shutdown(cancel_futures=True)
        cv2.setNumThreads(threads)


def nearest_present(present: NDArray[np.bool_], row: int, col: int) -> tuple[int, int]:
    """The present view closest to (row, col), the first in order among equals."""
    rows, cols = np.nonzero(present)
    best = int(np.argmin((rows - row) ** 2 + (cols - col) ** 2))
    return int(rows[best]), int(cols[best])


def write_views(scene: Examined, out: Path, can_be_shown: Callable[[], None], progress: Progress) -> None:
    """Decodes every view into the array in the file out; places without a view get a copy of the nearest one.

    can_be_shown: called once, when FIRST_VIEWS are there, and copies of them in all other places. Raises UserError, and
    NotGreyError if a view has colour but the pack has no planes for it.
    """
    source = scene.source
    values = np.arange(source.max_value + 1, dtype=np.float64) / source.max_value
    table = np.asarray(np.rint(255 * values ** (1 / scene.gamma)), np.uint8)  # the screen value of each value of the source

    def write(place: FrameIndex) -> None:
        frame, row, col = place
        pixels = source.read(frame, *scene.file_index(row, col))
        if scene.channels == 1 and not is_grey(pixels):
            raise NotGreyError
        planes = array(out)[place]
        for top in range(0, len(pixels), STRIP_ROWS):
            screen = table[np.minimum(pixels[top : top + STRIP_ROWS], source.max_value)]
            for channel, plane in enumerate(planes):
                plane[top : top + STRIP_ROWS] = screen if screen.ndim == 2 else screen[..., channel]

    def copy_to_others(written: NDArray[np.bool_]) -> None:
        for row, col in np.argwhere(~written).tolist():
            views = array(out)
            views[:, row, col] = views[:, *nearest_present(written, row, col)]

    def away(place: FrameIndex) -> float:
        return (place[1] - (scene.rows - 1) / 2) ** 2 + (place[2] - (scene.cols - 1) / 2) ** 2

    views, item_bytes = sorted(scene.views, key=away), 6 * source.height_px * source.width_px
    first = len(views) if source.frames > 1 else min(len(views), FIRST_VIEWS)
    written = np.zeros_like(scene.present)
    for _, row, col in views[:first]:
        written[row, col] = True
    progress("views", 0, len(views))
    run_parallel(write, views[:first], item_bytes, lambda done: progress("views", done, len(views)))
    copy_to_others(written)
    can_be_shown()
    run_parallel(write, views[first:], item_bytes, lambda done: progress("views", first + done, len(views)))
    if first < len(views):
        copy_to_others(scene.present)
