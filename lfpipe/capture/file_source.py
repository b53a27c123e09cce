"""Recordings as sources, with due times that never drift."""

import time

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.capture.frame_source import BrokenFrame, Frame, SourceInfo, size_notes, undecodable
from lfpipe.capture.recordings import open_recording
from lfpipe.capture.schedule import EvenSchedule, StampSchedule
from lfpipe.capture.spec import FileSpec
from lfpipe.errors import UserError

MAX_BROKEN = 50  # frames in a row: 2 s of a video


class FileSource:
    """Plays a recording. Frame 0 is due when first decoded, the others relative to it.

    pace a number: frame k is due exactly k periods later; "recorded": at the recording's own stamps and rate (camera.rate_hz if
    it has none); "max": each frame is due the moment it is decoded, but those of a sequence at their stamps without waiting for
    them: consumers that use stamps alone see the same as at the recorded pace. source_seq continues when a looped file starts
    over.
    """

    def __init__(self, spec: FileSpec, camera: config.Camera) -> None:
        """Raises UserError if the file is missing or cannot be decoded."""
        self._spec, self._recording = spec, open_recording(spec.path)
        recording = self._recording
        rate_hz = spec.pace if isinstance(spec.pace, float) else recording.rate_hz or camera.rate_hz
        stamped = recording.rate_hz > 0 and (spec.pace == "recorded" or (spec.pace == "max" and recording.exact))
        self._stamps = StampSchedule(rate_hz, recording.exact) if stamped else None
        self._even = EvenSchedule(rate_hz)
        self._seq = self._start_ns = 0
        self._broken = 0  # frames in a row
        notes = [*([] if recording.eyes else size_notes(recording.width_px, recording.height_px, camera)), *recording.notes]
        if spec.pace == "recorded" and not recording.rate_hz:
            notes.append(f"no frame rate in the file: played at camera.rate_hz = {rate_hz:g} Hz")
        name, size = f"file:{spec.path}", (recording.width_px, recording.height_px)
        self.info = SourceInfo(name, *size, rate_hz, live=False, jpeg=recording.jpeg, eyes=recording.eyes, notes=tuple(notes))

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `FrameSource.read`; never sleeps, and returns None at the end of a file that is not looped."""
        t_read_ns = time.monotonic_ns()
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
        now_ns, hurries = time.monotonic_ns(), self._spec.pace == "max"
        self._start_ns = self._start_ns or now_ns
        if self._stamps is not None:
            due_ns = self._start_ns + self._stamps.due_ns(stamp_ns)
        else:
            due_ns = now_ns if hurries else self._start_ns + self._even.due_ns(self._seq)
        self._seq += 1
        return Frame(self._seq - 1, due_ns, t_read_ns if hurries and self._stamps is not None else 0, self._recording.packet)

    def _next(self, out: NDArray[np.uint8]) -> int | None:
        """As `Recording.next`; gives up after MAX_BROKEN undecodable frames in a row."""
        try:
            stamp_ns = self._recording.next(out)
        except (BrokenFrame, MemoryError, cv2.error) as error:
            broken = error if isinstance(error, BrokenFrame) else undecodable(str(self._spec.path), error)
            self._broken += 1
            if self._broken > MAX_BROKEN:
                raise UserError(f"{broken.message}; the {MAX_BROKEN} before it are broken too", broken.remedy) from None
            self._seq += 1
            raise broken from None
        self._broken = self._broken if stamp_ns is None else 0
        return stamp_ns

    def close(self) -> None:
        self._recording.close()
