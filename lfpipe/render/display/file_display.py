"""Pictures in files: a video of what the viewer sees, and a single picture."""

import contextlib
import errno
import os
import queue
import shutil
import threading
import time
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.files.codecs import (
    IN_FRAGMENTS,
    VideoWriter,
    fitted,
    opencv_name,
    require_encoder,
    write_error,
)
from lfpipe.files.safe_files import check_regular, create_private, write_output
from lfpipe.host.terminal import OPENCV_ERROR, opencv_logging
from lfpipe.render.display.display import Display, DisplayNotice
from lfpipe.render.synthesis.anaglyph import Pair

# FFmpeg prints its own errors; notices repeat them
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

SUFFIXES = (".mkv", ".avi", ".mp4")
QUEUE_PICTURES = 8  # a short wait for the disk
# an encoder that lags by more than a short wait for the disk no longer repeats pictures
BEHIND_S = 0.5
AHEAD_FRAMES = 2  # pictures faster than the rate are accepted until the video is this far ahead


def check_file(path: Path) -> None:
    """Raises UserError if path names no kind of video that can be written here."""
    if path.suffix.lower() not in SUFFIXES:
        raise UserError(
            f"--display file:{path}: not .mkv, .avi or .mp4",
            "use for example file:out.mkv, which is lossless; .mp4 and .avi are small and play"
            " everywhere",
        )
    opencv_name(path)
    if path.suffix.lower() == ".mp4":
        try:
            require_encoder()
        except UserError as error:
            raise UserError(f"--display file:{path}: {error.message}", error.remedy) from None


class FileDisplay(Display):
    """Writes pictures at a constant rate in its own thread: a picture stays until the next one, as
    on a screen. The overlay is not in it.

    `show` never waits: if the encoder lags, pictures are dropped and counted in `dropped`. A full
    disk or a lost file ends the video with a notice; the session continues.
    """

    def __init__(
        self,
        path: Path,
        size_px: tuple[int, int],
        rate_hz: float,
        reserve_bytes: int = 64 << 20,
    ) -> None:
        """path: as `check_file` accepts. size_px: (width, height) of the pictures. reserve_bytes:
        left free on the disk, so that the video makes nothing else on the machine fail. Raises
        UserError if it cannot be created.
        """
        target = Path(os.path.realpath(path))
        try:
            check_regular(target)
            target.unlink(missing_ok=True)
            create_private(target).close()
        except OSError as error:
            raise write_error(path, error) from None
        self._writer = VideoWriter(target, size_px, rate_hz, IN_FRAGMENTS)
        self._path = path
        self._size = size_px
        self._period_ns = 1e9 / rate_hz
        self._reserve = reserve_bytes
        self._queue: queue.Queue[tuple[int, NDArray[np.uint8] | None]] = queue.Queue(QUEUE_PICTURES)
        self.fds = None
        self._written = self.dropped = 0
        self._thread = threading.Thread(target=self._run, name="video", daemon=True)
        self._thread.start()

    def show(self, picture: NDArray[np.uint8], pair: Pair | None = None, how: str = "") -> int:
        t_ns = time.monotonic_ns()
        if self._thread.is_alive():
            copy = np.empty((self._size[1], self._size[0], 3), np.uint8)
            fitted(picture, copy)  # it may be of another scene
            try:
                self._queue.put_nowait((t_ns, copy))
            except queue.Full:
                self.dropped += 1
        return t_ns

    def close(self) -> None:
        while self._thread.is_alive():
            # a full disk may end the thread before it takes this
            with contextlib.suppress(queue.Full):
                self._queue.put((time.monotonic_ns(), None), timeout=0.1)
                break
        self._thread.join()

    @opencv_logging(OPENCV_ERROR)  # otherwise a full disk gives a warning for every picture
    def _run(self) -> None:
        why = ""
        for task in (self._write_all, self._writer.release):
            try:
                task()
            except OSError as error:
                why = why or error.strerror or "it cannot be written"
        text = (
            f"{self._path}: {self.dropped} pictures are missing: they came faster than they could"
            " be written"
        )
        if why:
            text = f"{self._path}: the video ends here after {self._written} pictures: {why}"
        if why or self.dropped:
            self.notice = DisplayNotice(text, lost=bool(why))

    def _write_all(self) -> None:
        """Writes pictures until the end. Raises OSError."""
        start_ns, picture = self._queue.get()
        t_ns = start_ns
        while picture is not None:
            if self._written - round((t_ns - start_ns) / self._period_ns) <= AHEAD_FRAMES:
                self._put(picture)
            else:
                self.dropped += 1
            t_ns, following = self._next(picture, start_ns)
            behind_ns = time.monotonic_ns() - start_ns - self._written * self._period_ns
            if behind_ns > BEHIND_S * 1e9 + QUEUE_PICTURES * self._period_ns:
                start_ns += int(behind_ns)  # the encoder cannot keep up: skip this time
            while self._written < round((t_ns - start_ns) / self._period_ns):
                self._put(picture)
            picture = following

    def _next(
        self, shown: NDArray[np.uint8], start_ns: int
    ) -> tuple[int, NDArray[np.uint8] | None]:
        """The next of the queue; without a new picture, repeats the current one.

        Raises OSError.
        """
        while True:
            due_ns = start_ns + (self._written + QUEUE_PICTURES) * self._period_ns
            with contextlib.suppress(queue.Empty):
                return self._queue.get(timeout=max(0.0, (due_ns - time.monotonic_ns()) / 1e9))
            self._put(shown)

    def _put(self, picture: NDArray[np.uint8]) -> None:
        """Writes a picture. Raises OSError, also for a full disk, which OpenCV does not report."""
        self._writer.write(picture)
        self._written += 1
        free = shutil.disk_usage(self._path.parent).free
        if free < self._reserve:
            raise OSError(errno.ENOSPC, f"the disk is full ({free / 1e6:.0f} MB free)")


def save(path: Path, picture: NDArray[np.uint8]) -> str:
    """Writes picture, uint8 (height, width, 3) BGR, as the PNG path; returns why it failed, "" if
    it did not. An existing file stays until the new one is complete.
    """
    _, data = cv2.imencode(".png", picture)
    try:
        write_output(path, data.tobytes())
    except UserError as error:
        return f"{error.message}; the picture is not saved"
    return ""
