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
FIRST_VIEWS = 9  # enough for the first picture: a viewer begins in the middle of the grid
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


def write_views(job: PackJob, out: PlaneFile, table: NDArray[np.uint8], can_be_shown: Callable[[], None]) -> None:
    """Decodes every view into out, the nearest to the middle of the grid first; missing views get a copy of the nearest one.

    table: from a source value to a screen value. can_be_shown: called once, when FIRST_VIEWS are there, and copies of them in all
    other places. Raises UserError, and NotGreyError if a view has colour but the pack has no planes for it.
    """
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

    def away(place: FrameIndex) -> float:
        return (place[1] - (job.rows - 1) / 2) ** 2 + (place[2] - (job.cols - 1) / 2) ** 2

    there = sorted((place for place in job.view_indices() if job.present[place[1:]]), key=away)
    first = len(there) if source.frames > 1 else min(len(there), FIRST_VIEWS)
    written = np.zeros_like(job.present)
    written[tuple(np.array([place[1:] for place in there[:first]]).T)] = True
    tick, item_bytes = job.ticker("views", len(there)), 6 * source.height_px * source.width_px
    run_parallel(one, there[:first], tick, item_bytes)
    for place in job.view_indices():
        if not written[place[1:]]:
            out.write(place, out.read((place[0], *nearest_present(written, *place[1:]))))
    can_be_shown()
    run_parallel(one, there[first:], tick, item_bytes)
    for place in job.view_indices() if first < len(there) else ():
        if not job.present[place[1:]]:
            out.write(place, out.read((place[0], *nearest_present(job.present, *place[1:]))))
