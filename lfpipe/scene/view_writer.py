"""Writes the views of a pack: decodes them on a few threads, a bounded number at a time."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from pathlib import Path
from typing import TypeVar

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.host.processes import usable_cores
from lfpipe.scene import screen_values
from lfpipe.scene.grid_geometry import nearest_present
from lfpipe.scene.orientation import Orientation
from lfpipe.scene.pack import PlaneFile
from lfpipe.scene.source import SceneSource

Progress = Callable[[str, int, int], None]  # task, steps done, steps in total
FrameIndex = tuple[int, int, int]  # frame, row, column
T = TypeVar("T")
_ROOM_BYTES = 200_000_000  # for views decoded at the same time


class NotGreyError(Exception):
    """A view has colour although the sampled ones had none."""


def workers(item_bytes: int = 0) -> int:
    """Number of threads that decode and estimate: the cores of this process, at most four, fewer if each needs much memory."""
    return max(1, min(4, len(usable_cores()), _ROOM_BYTES // max(1, item_bytes)))


def run_parallel(work: Callable[[T], None], items: Iterable[T], done: Callable[[], None], item_bytes: int = 0) -> None:
    """Runs work(item) for every item on a few threads, a bounded number in flight; the first error ends it.

    item_bytes: memory per item.
    """
    count = workers(item_bytes)
    waiting: Iterator[T] = iter(items)
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # the pool is the parallelism
    try:
        with ThreadPoolExecutor(count) as pool:
            while batch := list(islice(waiting, 4 * count)):
                for future in [pool.submit(work, item) for item in batch]:
                    future.result()
                    done()
    finally:
        cv2.setNumThreads(threads)


@attrs.frozen
class PackJob:
    """What one run of the packer works on. rows, cols, present and offsets are canonical."""

    source: SceneSource
    orientation: Orientation
    folder: Path
    rows: int
    cols: int
    channels: int
    present: NDArray[np.bool_]
    offsets: NDArray[np.float32]
    progress: Progress

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the views: (frames, rows, cols, channels, height, width)."""
        return self.source.frames, self.rows, self.cols, self.channels, self.source.height_px, self.source.width_px

    def view_indices(self) -> list[FrameIndex]:
        return [(f, r, c) for f in range(self.source.frames) for r in range(self.rows) for c in range(self.cols)]

    def ticker(self, what: str, total: int) -> Callable[[], None]:
        done = 0

        def tick() -> None:
            nonlocal done
            done += 1
            self.progress(what, done, total)

        self.progress(what, 0, total)
        return tick


def write_views(job: PackJob, out: PlaneFile, table: NDArray[np.uint8]) -> None:
    """Decodes every view into out; missing views get a copy of the nearest one. table: from a source value to a screen value.
    Raises UserError, and NotGreyError if a view has colour but the pack has no planes for it."""
    source = job.source

    def one(place: FrameIndex) -> None:
        frame, row, col = place
        pixels = source.read(frame, *job.orientation.turn.file_index(row, col, job.rows, job.cols))
        if job.channels == 1 and not screen_values.is_grey(pixels):
            raise NotGreyError
        for top in range(0, len(pixels), screen_values.STRIP_ROWS):
            screen = screen_values.to_screen(pixels[top : top + screen_values.STRIP_ROWS], table)
            planes = [screen] * job.channels if screen.ndim == 2 else cv2.split(screen)[: job.channels]
            for channel, plane in enumerate(planes):
                out.write((*place, channel, top), plane)

    there = [place for place in job.view_indices() if job.present[place[1:]]]
    run_parallel(one, there, job.ticker("views", len(there)), 6 * source.height_px * source.width_px)
    for place in job.view_indices():
        if not job.present[place[1:]]:
            out.write(place, out.read((place[0], *nearest_present(job.present, *place[1:]))))
