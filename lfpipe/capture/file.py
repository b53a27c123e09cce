"""A recording as a source, with due times that never drift."""

import time

import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.capture.frame_source import BrokenFrame, Frame, SourceInfo, decoding
from lfpipe.capture.pictures import open_recording
from lfpipe.capture.schedule import EvenSchedule, StampSchedule
from lfpipe.capture.spec import FileSpec
from lfpipe.errors import UserError
from lfpipe.files.decoding import fit_note

MAX_BROKEN = 50


class FileSource:
    """Plays a video or a folder of pictures. Frame 0 is due when first decoded, the others relative to it.

    pace a number: frame k is due exactly k periods later; "recorded": at the file's own stamps and rate (camera.rate_hz if it
    has none); "max": each frame is due the moment it is decoded. source_seq continues when a looped file starts over.
    """

    def __init__(self, spec: FileSpec, camera: config.Camera) -> None:
        """Raises UserError if the file is missing or cannot be decoded."""
        self._spec = spec
        self._recording = open_recording(spec.path)
        own_hz = self._recording.rate_hz
        rate_hz = spec.pace if isinstance(spec.pace, float) else own_hz or camera.rate_hz
        stamped = spec.pace == "recorded" and own_hz > 0
        self._stamps = StampSchedule(rate_hz) if stamped else None
        self._even = EvenSchedule(rate_hz)
        self._seq = 0
        self._start_ns = 0
        self._broken = 0  # frames in a row
        width_px, height_px = self._recording.width_px, self._recording.height_px
        jpeg = self._recording.packet is not None
        notes = []
        if (width_px, height_px) != (camera.width_px, camera.height_px):
            notes.append(fit_note((width_px, height_px), (camera.width_px, camera.height_px)))
        if spec.pace == "recorded" and own_hz == 0:
            notes.append(f"no frame rate in the file: played at camera.rate_hz = {rate_hz:g} Hz")
        self.info = SourceInfo(f"file:{spec.path}", width_px, height_px, rate_hz, live=False, jpeg=jpeg, notes=tuple(notes))

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `FrameSource.read`; never sleeps, and returns None at the end of a file that is not looped."""
        stamp_ns = self._next(out)
        if stamp_ns is None and self._spec.loop:
            self._recording.rewind()
            if self._stamps is not None:
                self._stamps.restart()
            stamp_ns = self._next(out)
            if stamp_ns is None:
                raise UserError(f"{self._spec.path}: cannot be read a second time", "play it once with loop=0")
        if stamp_ns is None:
            return None
        now_ns = time.monotonic_ns()
        self._start_ns = self._start_ns or now_ns
        if self._spec.pace == "max":
            due_ns = now_ns
        elif self._stamps is not None:
            due_ns = self._start_ns + self._stamps.due_ns(stamp_ns)
        else:
            due_ns = self._start_ns + self._even.due_ns(self._seq)
        frame = Frame(self._seq, due_ns, 0, self._recording.packet)
        self._seq += 1
        return frame

    def _next(self, out: NDArray[np.uint8]) -> int | None:
        """As `Recording.next`; gives up after MAX_BROKEN undecodable frames in a row."""
        try:
            with decoding(str(self._spec.path)):
                stamp_ns = self._recording.next(out)
        except BrokenFrame as error:
            self._broken += 1
            if self._broken > MAX_BROKEN:
                raise UserError(f"{error.message}; the {MAX_BROKEN} before it are broken too", error.remedy) from None
            self._seq += 1
            raise
        self._broken = self._broken if stamp_ns is None else 0
        return stamp_ns

    def close(self) -> None:
        self._recording.close()
