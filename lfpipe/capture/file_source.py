"""Recordings as sources, with due times that never drift: videos, pictures and sequences."""

import time

import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.capture.frame_source import BrokenFrame, Frame, SourceInfo, decoding
from lfpipe.capture.pictures import open_recording
from lfpipe.capture.schedule import EvenSchedule, StampSchedule
from lfpipe.capture.spec import FileSpec
from lfpipe.errors import UserError
from lfpipe.files.decoding import fit_note, fitted
from lfpipe.files.safe_files import open_regular
from lfpipe.sequence.folder import open_sequence
from lfpipe.sequence.packets import PACKETS, decoded

MAX_BROKEN = 50
GREY = 128  # of a frame that was not recorded


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


class SequenceSource:
    """Plays a sequence. Frame 0 is due when first decoded, the others follow by their recorded stamps.

    pace a number: that even rate instead. pace max: recorded stamps without waiting for them; consumers that use stamps alone
    see the same as at the recorded pace.
    """

    def __init__(self, spec: FileSpec, camera: config.Camera) -> None:
        """Raises UserError if the sequence cannot be read."""
        self._spec, self._sequence = spec, open_sequence(spec.path, verify=False)
        rate_hz = spec.pace if isinstance(spec.pace, float) else self._sequence.measured_hz
        self._even = EvenSchedule(rate_hz) if isinstance(spec.pace, float) else None
        self._file = open_regular(spec.path / PACKETS)
        self._first_ns = self._sequence.packets[0].t_sensor_ns
        self._seq, self._start_ns, self._round_ns = 0, 0, 0
        width_px, height_px = self._sequence.size_px
        notes = []
        if (width_px, height_px) != (camera.width_px, camera.height_px):
            notes.append(fit_note((width_px, height_px), (camera.width_px, camera.height_px)))
        if not self._sequence.complete:
            notes.append(f"{spec.path} was cut off after {len(self._sequence.packets)} frames")
        jpeg = self._sequence.packets.codecs == ["jpeg"]
        eyes = str(spec.path.resolve()) if self._sequence.holds_eyes else ""
        notes = ["holds the eyes of the mouse"] if eyes else notes
        name = f"file:{spec.path}"
        self.info = SourceInfo(name, width_px, height_px, rate_hz, live=False, jpeg=jpeg, eyes=eyes, notes=tuple(notes))

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `FrameSource.read`; never sleeps, and returns None at the end of a sequence that is not looped."""
        packets = self._sequence.packets
        index = self._seq % len(packets)
        if self._seq and index == 0:
            if not self._spec.loop:
                return None
            self._file.seek(0)
            self._round_ns += packets[-1].t_sensor_ns - self._first_ns + round(1e9 / self._sequence.measured_hz)
        t_read_ns = time.monotonic_ns()
        packet = packets[index]
        try:
            data = self._file.read(packet.bytes)
        except OSError as error:
            raise UserError(f"{self._spec.path}: frame {index}: {error.strerror}", "check its disk or network drive") from None
        if self.info.eyes:
            out[:] = GREY
        else:
            fitted(decoded(packet, data, *self._sequence.size_px, self._sequence.path), out)
        if self._seq == 0:
            self._start_ns = time.monotonic_ns()
        after_ns = self._round_ns + packet.t_sensor_ns - self._first_ns
        due_ns = self._start_ns + (self._even.due_ns(self._seq) if self._even else after_ns)
        jpeg = np.frombuffer(data, np.uint8) if packet.codec == "jpeg" else None
        frame = Frame(self._seq, due_ns, t_read_ns if self._spec.pace == "max" else 0, jpeg)
        self._seq += 1
        return frame

    def close(self) -> None:
        self._file.close()
