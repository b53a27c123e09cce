"""Pictures in files: a video of what the viewer sees, and a single picture.

.mkv and .avi are lossless with full chroma, because chroma separates the two eyes of an anaglyph; .mp4 is small, plays anywhere
and has half the chroma.
"""

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
from lfpipe.files.h264 import H264Writer, encoder_name, write_error
from lfpipe.files.output import OutputFile, check_output, mark_video, marked_picture, write_output
from lfpipe.host.terminal import OPENCV_ERROR, opencv_logging
from lfpipe.render.display import Display, DisplayNotice
from lfpipe.render.pair_layout import Pair, scale_into

os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # it reports past Python; notices report the same


# Of the encoders in OpenCV's wheel, HuffYUV (on RGB), FFV1, PNG and raw RGBA preserve every RGB value. Measured on 512x512
# anaglyphs: 1.3, 13, 74 and 0.6 ms a picture, 0.30, 0.23, 0.31 and 1.0 MB. HuffYUV is the cheapest that is not raw.
CODEC = "HFYU"
SUFFIXES = (".mkv", ".avi", ".mp4")
QUEUE_PICTURES = 8
RESERVE_BYTES = 64 << 20  # left free on the disk, so that the video makes nothing else on the machine fail
CHECK_FRAMES = 16
GROWTH_BYTES = 8 << 20  # encoded without the file having grown: more than the 5 MB that the container may hold back
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
            encoder_name()
        except UserError as error:
            raise UserError(f"--display file:{path}: {error.message}", error.remedy) from None


class FileDisplay(Display):
    """Writes pictures at a constant rate in its own thread: a picture stays until the next one, as on a screen.

    A recording holds only the pictures: no overlays, no title, no size in mm.

    `show` never waits: if the encoder lags, pictures are dropped and counted in `dropped`. A full disk or a lost file ends the
    video with a notice; the session continues.
    """

    def __init__(self, path: Path, size_px: tuple[int, int], rate_hz: float, reserve_bytes: int = RESERVE_BYTES) -> None:
        """size_px: (width, height) of the pictures; odd sizes get a black row or column.

        Raises UserError if the file cannot be created.
        """
        check_file(path)
        try:
            self._output = OutputFile(path)
        except OSError as error:
            raise write_error(path, error) from None
        self._path, self._period_ns, self._reserve = path, 1e9 / rate_hz, reserve_bytes
        # the writer would cut off an odd row or column
        self._size = size_px[0] + size_px[0] % 2, size_px[1] + size_px[1] % 2
        self._lossless = path.suffix.lower() != ".mp4"
        self._writer: cv2.VideoWriter | H264Writer
        if self._lossless:
            codec, place = cv2.VideoWriter.fourcc(*CODEC), opencv_name(self._output.beside)
            self._writer = cv2.VideoWriter(place, cv2.CAP_FFMPEG, codec, rate_hz, self._size)
            if not self._writer.isOpened():
                self._output.close()
                raise UserError(f"--display file:{path}: the video cannot be written", "use another file, or --display none")
        else:
            self._writer = H264Writer(self._output.beside, self._size, rate_hz)
        self._queue: queue.Queue[tuple[int, NDArray[np.uint8] | None]] = queue.Queue(QUEUE_PICTURES)
        self._notices: queue.SimpleQueue[DisplayNotice] = queue.SimpleQueue()
        self._lost = threading.Event()
        self._written = self._bytes = self._grown = 0
        self.dropped = 0
        self._thread = threading.Thread(target=self._run, name="video", daemon=True)
        self._thread.start()

    def show(self, picture: NDArray[np.uint8], pair: Pair | None = None, how: str = "") -> int:
        """See `Display.show`; presented is when the picture was handed to the encoder."""
        t_ns = time.monotonic_ns()
        if not self._lost.is_set():
            try:
                self._queue.put_nowait((t_ns, picture.copy()))
            except queue.Full:
                self.dropped += 1
        return t_ns

    def notices(self) -> list[DisplayNotice]:
        said: list[DisplayNotice] = []
        while not self._notices.empty():
            said.append(self._notices.get())
        return said

    def close(self) -> None:
        """Writes the pending pictures and completes the file, so that any player opens it."""
        while self._thread.is_alive():
            try:
                self._queue.put((time.monotonic_ns(), None), timeout=0.1)
                break
            except queue.Full:  # a full disk may end the thread before it takes this
                continue
        self._thread.join()

    @opencv_logging(OPENCV_ERROR)  # otherwise a full disk gives a warning for every picture
    def _run(self) -> None:
        try:
            self._write_all()
        except OSError as error:  # of H264Writer
            self._end(error.strerror or "it cannot be written")
        finally:
            try:
                self._writer.release()
                self._place()
            except OSError as error:
                if not self._lost.is_set():
                    self._end(error.strerror or "it cannot be completed")
            self._output.close()
        if self.dropped and not self._lost.is_set():
            text = f"{self._path}: {self.dropped} pictures are missing: they came faster than they could be written"
            self._notices.put(DisplayNotice(text, lost=False))

    def _write_all(self) -> None:
        start_ns: int | None = None
        last: NDArray[np.uint8] | None = None
        while not self._lost.is_set():
            due_ns = None if start_ns is None else start_ns + (self._written + QUEUE_PICTURES) * self._period_ns
            try:
                wait_s = None if due_ns is None else max(0.0, (due_ns - time.monotonic_ns()) / 1e9)
                t_ns, picture = self._queue.get(timeout=wait_s)
            except queue.Empty:  # nothing new for a while: repeat the last picture
                if last is not None:
                    self._put(last)
                continue
            if start_ns is None:
                start_ns = t_ns
            behind_ns = time.monotonic_ns() - start_ns - self._written * self._period_ns
            if behind_ns > BEHIND_S * 1e9 + QUEUE_PICTURES * self._period_ns:
                start_ns += int(behind_ns)  # the encoder cannot keep up: skip this time
            index = round((t_ns - start_ns) / self._period_ns)
            while last is not None and self._written < index and not self._lost.is_set():
                self._put(last)
            if picture is None:
                break
            last = self._fitted(picture)
            if self._written - index <= AHEAD_FRAMES:
                self._put(last)
            else:
                self.dropped += 1

    def _fitted(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        if (picture.shape[1], picture.shape[0]) == self._size:
            return picture
        out = np.zeros((self._size[1], self._size[0], 3), np.uint8)
        height, width = picture.shape[:2]
        x, y, w, h = fit_area((width, height), self._size)
        if 0 <= self._size[0] - width <= 1 and 0 <= self._size[1] - height <= 1:
            x, y, w, h = 0, 0, width, height
        scale_into(picture, out[y : y + h, x : x + w])
        return out

    def _put(self, picture: NDArray[np.uint8]) -> None:
        if self._lost.is_set():
            return
        self._writer.write(picture)
        self._written += 1
        if self._written % CHECK_FRAMES:
            return
        # The writer does not report a full disk: free space and the growth of the file do.
        try:
            self._place()
            free, size = shutil.disk_usage(self._path.parent).free, self._output.current.stat().st_size
        except OSError as error:
            self._end(error.strerror or "gone")
            return
        if free < self._reserve:
            self._end(f"the disk is full but for {free / 1e6:.0f} MB")
        elif size > self._bytes:
            self._bytes, self._grown = size, self._written
        elif self._lossless and (self._written - self._grown) * self._size[0] * self._size[1] * LEAST_BITS / 8 > GROWTH_BYTES:
            self._end("it no longer grows (quota or size limit)")

    def _place(self) -> None:
        """Moves the file to its place once something is on the disk, and marks it as written by lfpipe. Raises OSError."""
        if self._lossless:
            mark_video(self._output.current)
        if self._output.current.stat().st_size:
            self._output.place()

    def _end(self, why: str) -> None:
        self._lost.set()
        self._notices.put(DisplayNotice(f"{self._path}: the video ends here after {self._written} pictures: {why}", lost=True))


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
