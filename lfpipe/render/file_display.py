"""Pictures in files: a video of what the viewer sees, and a single picture."""

import contextlib
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
from lfpipe.files.decoding import fit_area, opencv_name
from lfpipe.files.output import check_output, marked_picture, write_output
from lfpipe.files.safe_files import OutputFile
from lfpipe.files.video_writer import VideoWriter, require_encoder, write_error
from lfpipe.host.terminal import OPENCV_ERROR, opencv_logging
from lfpipe.render.display import Display, DisplayNotice
from lfpipe.render.pair_layout import Pair, scale_into

os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # it reports past Python; notices report the same

SUFFIXES = (".mkv", ".avi", ".mp4")
QUEUE_PICTURES = 8
RESERVE_BYTES = 64 << 20  # left free on the disk, so that the video makes nothing else on the machine fail
CHECK_FRAMES = 16
HELD_BYTES = 8 << 20  # not in the file yet: more than the 5 MB that the container may hold back
LEAST_BITS = 3  # a pixel takes at least a bit a channel
BEHIND_S = 0.5  # an encoder that lags by more than this no longer repeats pictures
AHEAD_FRAMES = 2  # pictures faster than the rate are accepted until the video is this far ahead


def check_file(path: Path) -> None:
    """Raises UserError if path names no kind of video that can be written here."""
    if path.suffix.lower() not in SUFFIXES:
        remedy = "use for example file:out.mkv, lossless RGB like .avi; .mp4 is small and plays everywhere"
        raise UserError(f"--display file:{path}: not .mkv, .avi or .mp4", remedy)
    opencv_name(path)
    if path.suffix.lower() == ".mp4":
        try:
            require_encoder()
        except UserError as error:
            raise UserError(f"--display file:{path}: {error.message}", error.remedy) from None


class FileDisplay(Display):
    """Writes pictures at a constant rate in its own thread: a picture stays until the next one, as on a screen. The
    overlay is not in it.

    `show` never waits: if the encoder lags, pictures are dropped and counted in `dropped`. A full disk or a lost file ends the
    video with a notice; the session continues.
    """

    def __init__(self, path: Path, size_px: tuple[int, int], rate_hz: float, reserve_bytes: int = RESERVE_BYTES) -> None:
        """path: as `check_file` accepts. size_px: (width, height) of the pictures. Raises UserError if it cannot be created."""
        try:
            self._output = OutputFile(path)
        except OSError as error:
            raise write_error(path, error) from None
        try:
            self._writer = VideoWriter(self._output.current, size_px, rate_hz)
        except UserError as error:
            self._output.close()
            raise UserError(f"--display file:{path}: the video cannot be written", error.remedy) from None
        self._path, self._size, self._period_ns, self._reserve = path, size_px, 1e9 / rate_hz, reserve_bytes
        self._queue: queue.Queue[tuple[int, NDArray[np.uint8] | None]] = queue.Queue(QUEUE_PICTURES)
        self._notices: list[DisplayNotice] = []
        self._lost = False
        self._written = self.dropped = 0
        self._thread = threading.Thread(target=self._run, name="video", daemon=True)
        self._thread.start()

    def show(self, picture: NDArray[np.uint8], pair: Pair | None = None, how: str = "") -> int:
        t_ns = time.monotonic_ns()
        if not self._lost:
            try:
                self._queue.put_nowait((t_ns, picture.copy()))
            except queue.Full:
                self.dropped += 1
        return t_ns

    def notices(self) -> list[DisplayNotice]:
        notices, self._notices = self._notices, []
        return notices

    def close(self) -> None:
        while self._thread.is_alive():
            with contextlib.suppress(queue.Full):  # a full disk may end the thread before it takes this
                self._queue.put((time.monotonic_ns(), None), timeout=0.1)
                break
        self._thread.join()

    @opencv_logging(OPENCV_ERROR)  # otherwise a full disk gives a warning for every picture
    def _run(self) -> None:
        try:
            self._write_all()
        except OSError as error:
            self._end(error.strerror or "it cannot be written")
        try:
            self._writer.release(self._output.current)
            self._place()
        except OSError as error:
            self._end(error.strerror or "it cannot be completed")
        self._output.close()
        if self.dropped and not self._lost:
            text = f"{self._path}: {self.dropped} pictures are missing: they came faster than they could be written"
            self._notices.append(DisplayNotice(text, lost=False))

    def _write_all(self) -> None:
        start_ns: int | None = None
        last: NDArray[np.uint8] | None = None
        while not self._lost:
            due_ns = None if start_ns is None else start_ns + (self._written + QUEUE_PICTURES) * self._period_ns
            try:
                wait_s = None if due_ns is None else max(0.0, (due_ns - time.monotonic_ns()) / 1e9)
                t_ns, picture = self._queue.get(timeout=wait_s)
            except queue.Empty:  # nothing new for a while: repeat the last picture
                if last is not None:
                    self._put(last)
                continue
            start_ns = t_ns if start_ns is None else start_ns
            behind_ns = time.monotonic_ns() - start_ns - self._written * self._period_ns
            if behind_ns > BEHIND_S * 1e9 + QUEUE_PICTURES * self._period_ns:
                start_ns += int(behind_ns)  # the encoder cannot keep up: skip this time
            index = round((t_ns - start_ns) / self._period_ns)
            while last is not None and self._written < index and not self._lost:
                self._put(last)
            if picture is None:
                break
            last = self._fitted(picture)
            if self._written - index <= AHEAD_FRAMES:
                self._put(last)
            else:
                self.dropped += 1

    def _fitted(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """A picture of another scene in the size of the video."""
        width, height = self._size
        if picture.shape[:2] == (height, width):
            return picture
        out = np.zeros((height, width, 3), np.uint8)
        x, y, w, h = fit_area((picture.shape[1], picture.shape[0]), self._size)
        scale_into(picture, out[y : y + h, x : x + w])
        return out

    def _put(self, picture: NDArray[np.uint8]) -> None:
        """Writes a picture. Raises OSError."""
        self._writer.write(picture)
        self._written += 1
        if self._written % CHECK_FRAMES or self._lost:
            return
        # a lossless video does not report a full disk: free space and the size of the file do
        self._place()
        free, size = shutil.disk_usage(self._path.parent).free, self._output.current.stat().st_size
        if free < self._reserve:
            self._end(f"the disk is full but for {free / 1e6:.0f} MB")
        elif self._writer.lossless and size + HELD_BYTES < self._written * self._size[0] * self._size[1] * LEAST_BITS / 8:
            self._end("it no longer grows (quota or size limit)")

    def _place(self) -> None:
        """Moves the file to its place once something is on the disk. Raises OSError."""
        if self._output.current.stat().st_size:
            self._output.place()

    def _end(self, why: str) -> None:
        """Notes the end of the video, once."""
        if not self._lost:
            self._lost = True
            text = f"{self._path}: the video ends here after {self._written} pictures: {why}"
            self._notices.append(DisplayNotice(text, lost=True))


def save(path: Path, picture: NDArray[np.uint8]) -> str:
    """Writes picture, uint8 (height, width, 3) BGR, as the PNG path; returns why it failed, "" if it did not. An existing file
    stays until the new one is complete.
    """
    done, data = cv2.imencode(".png", picture)
    assert done, "a uint8 picture is always a PNG"
    try:
        check_output(path)
        write_output(path, marked_picture(data.tobytes()))
    except UserError as error:
        return f"{error.message}; the picture is not saved"
    return ""
