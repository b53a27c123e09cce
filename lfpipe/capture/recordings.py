"""Sources of frames: the demo's viewer (a portrait moves on a known smooth path),
and recordings: a video, pictures in order of name, or a recorded sequence. The due times of their
frames are absolute, in whole nanoseconds, so that errors never add up.
"""

import math
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
from lfpipe.files.codecs import BrokenFrame, fitted, is_jpeg, picture_of
from lfpipe.files.pictures import MAX_DECODING_BYTES
from lfpipe.files.safe_files import open_regular, reason
from lfpipe.host.files import is_dir
from lfpipe.host.terminal import opencv_logging
from lfpipe.scene.source import natural
from lfpipe.scene.video import RecordedFrame, Video
from lfpipe.sequence.folder import is_sequence, open_sequence
from lfpipe.transport.ring import MS_NS, SECOND_NS

PORTRAIT = Path(__file__).with_name("portrait.jpg")  # in the public domain: portrait.md
# Mean of the 16 landmarks around each eye in the portrait, the left eye of the sitter first, as
# FaceMesh finds them.
PORTRAIT_EYES_PX = np.array([[308.0, 188.1], [220.2, 193.0]])
EYE_DISTANCE_PX = 65.0  # in a frame of 640x480: a viewer 600 mm from a webcam
EYE_LINE = 0.47  # share of the frame's height, at the middle of the path
FRAME_PX = (640, 480)  # lengths in px refer to this size; other sizes scale


def _scale(width_px: int, height_px: int) -> float:
    """The scale of lengths in a frame of that size."""
    return min(width_px / FRAME_PX[0], height_px / FRAME_PX[1])


def _portrait_scale(width_px: int, height_px: int) -> float:
    return (
        EYE_DISTANCE_PX
        * _scale(width_px, height_px)
        / float(np.linalg.norm(PORTRAIT_EYES_PX[0] - PORTRAIT_EYES_PX[1]))
    )


def _head_matrix(t_s: float, width_px: int, height_px: int) -> NDArray[np.float64]:
    """(2, 3): from px about the point between the eyes, in a head of mean size, to px of the frame
    at time t_s.

    Sums of sines: smooth, endless, and slow enough for a head (at most 90 px/s in a frame of
    640x480).
    """
    turn = 2 * math.pi * t_s
    scale = _scale(width_px, height_px)
    right_px = 62 * math.sin(turn / 7.3) + 14 * math.sin(turn / 3.1)
    down_px = 16 * math.sin(turn / 5.9 + 1.0)
    roll_rad = 0.05 * math.sin(turn / 6.7 + 0.4)
    size = 1 + 0.04 * math.sin(turn / 9.1)
    cos, sin = size * math.cos(roll_rad), size * math.sin(roll_rad)
    x, y = width_px / 2 + scale * right_px, EYE_LINE * height_px + scale * down_px
    return np.array([[cos, -sin, x], [sin, cos, y]])


def demo_eyes_px(
    t_s: float, width_px: int = FRAME_PX[0], height_px: int = FRAME_PX[1]
) -> NDArray[np.float64]:
    """Eyes in the frame of time t_s: (2, 2) px, [[left x, left y], [right x, right y]], the
    sitter's own left and right.
    """
    about_px = (PORTRAIT_EYES_PX - PORTRAIT_EYES_PX.mean(axis=0)) * _portrait_scale(
        width_px, height_px
    )
    matrix = _head_matrix(t_s, width_px, height_px)
    return np.asarray(about_px @ matrix[:, :2].T + matrix[:, 2], np.float64)


def backdrop(width_px: int, height_px: int) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """The scaled portrait with blurred surroundings: (BGR picture, point between the eyes).

    Larger than a frame by the margin that the path needs on each side.
    """
    portrait = np.asarray(cv2.imread(str(PORTRAIT), cv2.IMREAD_COLOR))
    scale = _portrait_scale(width_px, height_px)
    small = cv2.resize(portrait, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    rows, cols = small.shape[:2]
    middle = PORTRAIT_EYES_PX.mean(axis=0) * scale
    reach = np.array([width_px, height_px]) * 0.72
    left, top = (math.ceil(v) for v in np.maximum(reach - middle, 0))
    right, bottom = (math.ceil(v) for v in np.maximum(reach - (np.array([cols, rows]) - middle), 0))
    wide = cv2.copyMakeBorder(small, top, bottom, left, right, cv2.BORDER_REPLICATE)
    soft = cv2.GaussianBlur(wide, (0, 0), 0.05 * height_px)
    mask = np.zeros((rows, cols), np.float32)
    edge = max(2, round(0.06 * rows))
    mask[edge:, edge:-edge] = 1.0
    mask = cv2.GaussianBlur(mask, (0, 0), edge / 2.5, borderType=cv2.BORDER_REPLICATE)
    mask = cv2.copyMakeBorder(mask, top, bottom, left, right, cv2.BORDER_REPLICATE)[..., None]
    mixed = wide * mask + soft * (1 - mask)
    return np.asarray(mixed + 0.5, np.uint8), middle + np.array([left, top])


class DemoSource:
    """Frames of camera.width_px x camera.height_px at camera.rate_hz, endlessly; frame k shows the
    head at k / rate_hz.
    """

    def __init__(self, camera: config.Camera) -> None:
        self._size = camera.width_px, camera.height_px
        picture, self._middle = backdrop(*self._size)
        # Warping four channels takes 0.65 ms, three 1.65 (640x480, OpenCV 5); the values are equal.
        self._picture = cv2.cvtColor(picture, cv2.COLOR_BGR2BGRA)
        self._warped: NDArray[np.uint8] = np.empty((0, 0, 4), np.uint8)
        self._schedule = Schedule(camera.nominal_hz)
        self._seq = self._start_ns = 0
        self.info = SourceInfo("demo", self._size, camera.nominal_hz, live=False)

    def read(self, out: NDArray[np.uint8]) -> Frame | None:
        """See `FrameSource.read`; out may have another size than the camera's.

        Never returns None.
        """
        height_px, width_px = out.shape[:2]
        after_ns = self._schedule.due_ns(self._seq)
        matrix = _head_matrix(after_ns / 1e9, *self._size)
        matrix[:, 2] -= matrix[:, :2] @ self._middle
        fit = np.diag([width_px / self._size[0], height_px / self._size[1]])
        if self._warped.shape[:2] != out.shape[:2]:
            self._warped = np.empty((height_px, width_px, 4), np.uint8)
        cv2.warpAffine(
            self._picture,
            fit @ matrix,
            (width_px, height_px),
            dst=self._warped,
            borderMode=cv2.BORDER_REPLICATE,
        )
        cv2.cvtColor(self._warped, cv2.COLOR_BGRA2BGR, dst=out)
        self._start_ns = self._start_ns or time.monotonic_ns()
        self._seq += 1
        return Frame(self._seq - 1, self._start_ns + after_ns, 0)

    def close(self) -> None:
        pass


# A container that counts milliseconds rounds each stamp by up to 0.5 ms, the encoder by as much
# again. Within that, the even grid of the frame rate is more accurate than the stamps.
STAMP_ROUNDING_NS = MS_NS


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
            data = np.fromfile(file, np.uint8, MAX_DECODING_BYTES)
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
    black = np.broadcast_to(np.uint8(0), (sequence.height_px, sequence.width_px, 3))

    def read(index: int) -> RecordedFrame | None:
        if index == len(sequence.packets):
            return None
        packet = sequence.packets[index]
        data = sequence.data(index)
        picture = black if sequence.holds_eyes else sequence.frame(index, data)
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
        jpeg=sequence.packets.codecs == {"jpeg"},
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
