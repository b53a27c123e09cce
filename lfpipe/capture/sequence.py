"""A recorded sequence as a source: stored packets, decoded, with the recorded stamps shifted to now."""

import time

import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.capture.frame_source import Frame, SourceInfo
from lfpipe.capture.schedule import EvenSchedule
from lfpipe.capture.spec import FileSpec
from lfpipe.errors import UserError
from lfpipe.files.decoding import fit_note, fitted
from lfpipe.files.safe_files import open_regular
from lfpipe.sequence.folder import open_sequence
from lfpipe.sequence.index import PACKETS
from lfpipe.sequence.packets import decoded


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
        width_px, height_px = self._sequence.width_px, self._sequence.height_px
        notes = []
        if (width_px, height_px) != (camera.width_px, camera.height_px):
            notes.append(fit_note((width_px, height_px), (camera.width_px, camera.height_px)))
        if not self._sequence.complete:
            notes.append(f"{spec.path} was cut off after {len(self._sequence.packets)} frames")
        jpeg = all(packet.codec == "jpeg" for packet in self._sequence.packets)
        self.info = SourceInfo(f"file:{spec.path}", width_px, height_px, rate_hz, live=False, jpeg=jpeg, notes=tuple(notes))

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
        size = self._sequence.width_px, self._sequence.height_px
        fitted(decoded(packet, data, *size, self._sequence.path), out)
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
