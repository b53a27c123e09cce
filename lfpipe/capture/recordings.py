"""Recordings as sources: a video, pictures in order of name, or a recorded sequence. The due times
of their frames are absolute, in whole nanoseconds, so that errors never add up.
"""

import time
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe import config
from lfpipe.capture.frame_source import Frame, SourceInfo, size_notes, undecodable
from lfpipe.capture.spec import FileSpec
from lfpipe.errors import UserError
from lfpipe.files.decoding import BrokenFrame, fitted, is_jpeg, picture_of
from lfpipe.files.safe_files import open_regular, reason
from lfpipe.host.files import is_dir
from lfpipe.host.terminal import opencv_logging
from lfpipe.scene.files import natural
from lfpipe.scene.video import RecordedFrame, Video
from lfpipe.sequence.folder import is_sequence, open_sequence
from lfpipe.transport.clock import SECOND_NS

# A container that counts milliseconds rounds each stamp by up to 0.5 ms, the encoder by as much
# again. Within that, the even grid of the frame rate is more accurate than the stamps.
STAMP_ROUNDING_NS = 1_000_000


class Schedule:
    """Due times of a recording that may be played in rounds.

    Frame k of a round is due k periods after its first, by integer arithmetic: the error stays
    below 1 ns. rounding_ns: stamps that differ by more from this even grid are due by their stamps;
    None: the frames have no stamps. Due times always grow: a stamp that does not increase counts as
    one period after the frame before.
    """

    def __init__(self, rate_hz: float, rounding_ns: int | None = None) -> None:
        # 29.97002997 means 30000/1001
        period = 1_000_000_000 / Fraction(rate_hz).limit_denominator(1001)
        self._period_ns = period.numerator
        self._parts = period.denominator
        self._step_ns = max(1, self._period_ns // self._parts)
        self._rounding_ns = rounding_ns
        # due time and stamp of the first frame of this round
        self._round_ns = self._first_stamp_ns = 0
        self._index = self._last_ns = -1

    def due_ns(self, index: int, stamp_ns: int = 0) -> int:
        """Nanoseconds from the very first frame to the next one, number index of its round. A
        number that does not rise begins a round, one period after the last frame.
        """
        if index <= self._index or self._last_ns < 0:
            self._round_ns = self._last_ns + self._step_ns if self._last_ns >= 0 else 0
            self._first_stamp_ns = stamp_ns
        self._index = index
        due_ns = self._round_ns + index * self._period_ns // self._parts
        stamped_ns = self._round_ns + stamp_ns - self._first_stamp_ns
        if self._rounding_ns is not None and abs(stamped_ns - due_ns) > self._rounding_ns:
            due_ns = stamped_ns
        if due_ns <= self._last_ns:
            due_ns = self._last_ns + self._step_ns
        self._last_ns = due_ns
        return due_ns


class Lateness:
    """Drops or reschedules late frames of a recording. late_ns: tolerance, 0 for none.

    After a hiccup frames are dropped, as a camera's driver would overwrite them, until playback has
    caught up. If it does not, because decoding takes longer than a period, or if playback stood
    still for a second, catching up is impossible: the schedule is shifted instead of dropping every
    frame.
    """

    def __init__(self, late_ns: int) -> None:
        self._late_ns = late_ns
        self._behind_ns = 0
        self.moved_ns = 0  # delay of playback against the original schedule

    def drops(self, due_ns: int, t_read_ns: int) -> bool:
        """Whether to drop the frame due at due_ns that was read at t_read_ns; may move the
        schedule.
        """
        late_ns = t_read_ns - due_ns - self.moved_ns
        if not self._late_ns or late_ns <= self._late_ns:
            self._behind_ns = 0
            return False
        if late_ns > SECOND_NS or 0 < self._behind_ns <= late_ns:
            self.moved_ns += late_ns
            self._behind_ns = 0
            return False
        self._behind_ns = late_ns
        return True


SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".ppm", ".pgm", ".tif", ".tiff", ".webp"})
MAX_FILE_BYTES = 1 << 28  # of one picture; larger files are refused
GREY = 128  # of a frame that was not recorded
MAX_BROKEN = 50  # frames in a row: 2 s of a video


@attrs.frozen(eq=False)
class Recording:
    """A series of frames that can be played again and again."""

    info: SourceInfo
    """With the recording's own rate, 0 if it has none."""
    read: Callable[[int], RecordedFrame | None]
    """Called with 0, 1, 2, ..., it returns the next frame, None at the end; 0 starts over. It
    raises BrokenFrame for one that cannot be decoded."""
    close: Callable[[], None] = lambda: None
    """Call it when no more frames are needed."""
    exact: bool = False
    """Its stamps are those of its frames; else a container may have rounded them."""

    def read_into(self, index: int, out: NDArray[np.uint8]) -> RecordedFrame | None:
        """As `read`, with the picture also in out, uint8 (height, width, 3) BGR, scaled to fit."""
        frame = self.read(index)
        if frame is not None:
            fitted(frame.picture, out)
        return frame


def _load(path: Path) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """The bytes of a file, uint8 (n,), and its picture. Raises BrokenFrame."""
    try:
        with open_regular(path) as file:
            data = np.fromfile(file, np.uint8, MAX_FILE_BYTES)
    except OSError as error:
        raise BrokenFrame(
            f"{path}: not a readable picture: {reason(error)}", "save it again"
        ) from None
    with opencv_logging():
        picture = picture_of(data)
    if picture is None:
        raise BrokenFrame(
            f"{path}: not a readable picture", "remove it from the folder, or save it again"
        )
    return data, picture


def _pictures(paths: list[Path]) -> Recording:
    """Pictures in that order. Raises BrokenFrame if the first cannot be decoded."""

    def read(index: int) -> RecordedFrame | None:
        if index == len(paths):
            return None
        data, picture = _load(paths[index])
        return RecordedFrame(
            0, picture, data if picture.shape == first.shape and is_jpeg(data) else None
        )

    data, first = _load(paths[0])
    return Recording(
        SourceInfo(str(paths[0]), first.shape[1::-1], 0.0, live=False, jpeg=is_jpeg(data)), read
    )


def _sequence(path: Path) -> Recording:
    """A recorded sequence, with the stamps of its frames. Raises UserError if it cannot be read, as
    its frames do if they are damaged.
    """
    sequence = open_sequence(path, verify=False)
    grey = np.broadcast_to(np.uint8(GREY), (sequence.height_px, sequence.width_px, 3))

    def read(index: int) -> RecordedFrame | None:
        if index == len(sequence.packets):
            return None
        packet = sequence.packets[index]
        data = sequence.data(index)
        picture = grey if sequence.holds_eyes else sequence.frame(index, data)
        return RecordedFrame(
            packet.t_sensor_ns,
            picture,
            np.frombuffer(data, np.uint8) if packet.codec == "jpeg" else None,
        )

    notes = []
    if not sequence.complete:
        notes.append(f"{path} was cut off after {len(sequence.packets)} frames")
    if sequence.holds_eyes:
        notes = ["holds the eyes of the mouse"]
    info = SourceInfo(
        str(path),
        sequence.size_px,
        sequence.measured_hz,
        live=False,
        jpeg=sequence.codecs == {"jpeg"},
        eyes=str(path.resolve()) if sequence.holds_eyes else "",
        notes=tuple(notes),
    )
    return Recording(info, read, exact=True)


def open_recording(path: Path) -> Recording:
    """Opens the sequence, video, picture or folder of pictures at path.

    Raises UserError if it is missing, unreadable, or a folder without pictures.
    """
    if is_sequence(path):
        return _sequence(path)
    try:
        if not is_dir(path):
            open_regular(path).close()
            if path.suffix.lower() not in SUFFIXES:
                video = Video(path, recording=True)
                info = SourceInfo(
                    str(path),
                    (video.width_px, video.height_px),
                    video.rate_hz,
                    live=False,
                    jpeg=video.jpeg,
                )
                return Recording(info, video.read, video.close)
            return _pictures([path])
        names = [entry.name for entry in path.iterdir()]
    except FileNotFoundError:
        raise UserError(
            f"{path}: no such file", "check the path; it is relative to the current directory"
        ) from None
    except (OSError, ValueError) as error:
        remedy = "give a video, a picture or a folder of pictures, and check its permissions"
        raise UserError(f"{path}: cannot be read: {reason(error)}", remedy) from None
    pictures = [
        name for name in names if Path(name).suffix.lower() in SUFFIXES and not name.startswith(".")
    ]
    if not pictures:
        kinds = ", ".join(sorted(SUFFIXES))
        raise UserError(
            f"{path}: the folder has no pictures",
            f"give a folder of {kinds} files, or a video in it",
        )
    return _pictures(
        [path / name for name in sorted(pictures, key=lambda name: natural(name.lower()))]
    )


class FileSource:
    """Plays a recording. Frame 0 is due when first decoded, the others relative to it.

    pace a number: frame k is due exactly k periods later; "recorded": at the recording's own stamps
    and rate (camera.rate_hz if it has none); "max": each frame is due the moment it is decoded, but
    those of a sequence at their stamps without waiting for them: consumers that use stamps alone
    see the same as at the recorded pace. source_seq continues when a looped file starts over.
    """

    def __init__(self, spec: FileSpec, camera: config.Camera) -> None:
        """Raises UserError if the file is missing or cannot be decoded."""
        self._spec = spec
        self._recording = open_recording(spec.path)
        info = self._recording.info
        exact = self._recording.exact
        rate_hz = spec.pace if isinstance(spec.pace, float) else info.rate_hz or camera.nominal_hz
        self._stamped = info.rate_hz > 0 and (
            spec.pace == "recorded" or (spec.pace == "max" and exact)
        )
        rounding_ns = 0 if exact else STAMP_ROUNDING_NS
        self._schedule = Schedule(rate_hz, rounding_ns if self._stamped else None)
        self._seq = self._index = self._start_ns = 0  # index: in this round
        self._broken = 0  # frames in a row
        notes = [*([] if info.eyes else size_notes(info.size_px, camera)), *info.notes]
        if spec.pace == "recorded" and not info.rate_hz:
            notes.append(f"no frame rate in the file: played at camera.rate_hz = {rate_hz:g} Hz")
        self.info = attrs.evolve(
            info, name=f"file:{spec.path}", rate_hz=rate_hz, notes=tuple(notes)
        )

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `FrameSource.read`; never sleeps, and returns None at the end of a file that is not
        looped.
        """
        t_read_ns = time.monotonic_ns()
        hurries = self._spec.pace == "max"
        frame = self._next(out)
        if frame is None and self._spec.loop:
            self._index = 0
            frame = self._next(out)
        if frame is None:
            return None
        due_ns = time.monotonic_ns()
        self._start_ns = self._start_ns or due_ns
        if self._stamped or not hurries:
            due_ns = self._start_ns + self._schedule.due_ns(self._index - 1, frame.stamp_ns)
        self._seq += 1
        t_read_ns = t_read_ns if hurries and self._stamped else 0
        return Frame(self._seq - 1, due_ns, t_read_ns, frame.packet)

    def _next(self, out: NDArray[np.uint8]) -> RecordedFrame | None:
        """The next frame of this round; gives up after MAX_BROKEN undecodable frames in a row."""
        self._index += 1
        try:
            frame = self._recording.read_into(self._index - 1, out)
        except (BrokenFrame, MemoryError, cv2.error) as error:
            broken = undecodable(str(self._spec.path), error)
            self._seq += 1
            self._broken += 1
            if self._broken > MAX_BROKEN:
                raise UserError(
                    f"{broken.message}; the {MAX_BROKEN} before it are broken too", broken.remedy
                ) from None
            raise broken from None
        if frame is not None:
            self._broken = 0
        return frame

    def close(self) -> None:
        self._recording.close()
