"""Recordings for a file source: a video, pictures in order of name, or a recorded sequence."""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.frame_source import BrokenFrame, Recording
from lfpipe.capture.video import Video
from lfpipe.errors import UserError
from lfpipe.files.decoding import fitted, is_jpeg, picture_of
from lfpipe.files.safe_files import open_regular, reason
from lfpipe.host.files import is_dir
from lfpipe.host.terminal import opencv_logging
from lfpipe.sequence.folder import is_sequence, open_sequence
from lfpipe.sequence.packets import PACKETS, decoded

SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".ppm", ".pgm", ".tif", ".tiff", ".webp"})
MAX_FILE_BYTES = 1 << 28  # of one picture; larger files are refused
GREY = 128  # of a frame that was not recorded


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Sorts `frame2` before `frame10`."""
    parts = re.split(r"([0-9]+)", name.lower())  # odd parts are numbers
    return [(1, int(part), "") if index % 2 else (0, 0, part) for index, part in enumerate(parts)]


def _load(path: Path) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """The bytes of a file, uint8 (n,), and its picture. Raises BrokenFrame."""
    try:
        with open_regular(path) as file:
            data = np.fromfile(file, np.uint8, MAX_FILE_BYTES)
    except OSError as error:
        raise BrokenFrame(f"{path}: not a readable picture: {reason(error)}", "save it again") from None
    with opencv_logging():
        picture = picture_of(data)
    if picture is None:
        raise BrokenFrame(f"{path}: not a readable picture", "remove it from the folder, or save it again")
    return data, picture


class Pictures(Recording):
    """Pictures in natural order of name."""

    def __init__(self, paths: list[Path]) -> None:
        """Raises BrokenFrame if the first cannot be decoded."""
        self._paths, self._index = paths, 0
        data, first = _load(paths[0])
        self.height_px, self.width_px = first.shape[:2]
        self.jpeg = is_jpeg(data)

    def next(self, out: NDArray[np.uint8]) -> int | None:
        """See `Recording.next`."""
        if self._index == len(self._paths):
            return None
        self._index += 1
        data, picture = _load(self._paths[self._index - 1])
        own_size = picture.shape[:2] == (self.height_px, self.width_px)
        self.packet = data if own_size and is_jpeg(data) else None
        fitted(picture, out)
        return 0

    def rewind(self) -> None:
        self._index = 0


class SequenceRecording(Recording):
    """A recorded sequence, with the stamps of its frames."""

    exact = True

    def __init__(self, path: Path) -> None:
        """Raises UserError if the sequence cannot be read."""
        self._path, self._sequence, self._index = path, open_sequence(path, verify=False), 0
        self.width_px, self.height_px = self._sequence.size_px
        self.rate_hz = self._sequence.measured_hz
        self._file = open_regular(path / PACKETS)
        self.jpeg = self._sequence.codecs == {"jpeg"}
        if self._sequence.holds_eyes:
            self.eyes, self.notes = str(path.resolve()), ("holds the eyes of the mouse",)
        elif not self._sequence.complete:
            self.notes = (f"{path} was cut off after {len(self._sequence.packets)} frames",)

    def next(self, out: NDArray[np.uint8]) -> int | None:
        """See `Recording.next`. Raises UserError for a damaged frame: the frames after it are not where they should be."""
        if self._index == len(self._sequence.packets):
            return None
        packet = self._sequence.packets[self._index]
        try:
            data = self._file.read(packet.bytes)
        except OSError as error:
            raise UserError(f"{self._path}: frame {self._index}: {error.strerror}", "check its disk or network drive") from None
        if self.eyes:
            out[:] = GREY
        else:
            fitted(decoded(packet, data, self.width_px, self.height_px, self._sequence.path), out)
        self.packet = np.frombuffer(data, np.uint8) if packet.codec == "jpeg" else None
        self._index += 1
        return packet.t_sensor_ns

    def rewind(self) -> None:
        self._file.seek(0)
        self._index = 0

    def close(self) -> None:
        self._file.close()


def open_recording(path: Path) -> Recording:
    """Opens the sequence, video, picture or folder of pictures at path.

    Raises UserError if it is missing, unreadable, or a folder without pictures.
    """
    if is_sequence(path):
        return SequenceRecording(path)
    try:
        if not is_dir(path):
            file = open_regular(path)
            if path.suffix.lower() not in SUFFIXES:
                return Video(file, path)
            file.close()
            return Pictures([path])
        names = [entry.name for entry in path.iterdir()]
    except FileNotFoundError:
        raise UserError(f"{path}: no such file", "check the path; it is relative to the current directory") from None
    except (OSError, ValueError) as error:
        remedy = "give a video, a picture or a folder of pictures, and check its permissions"
        raise UserError(f"{path}: cannot be read: {reason(error)}", remedy) from None
    pictures = [name for name in names if Path(name).suffix.lower() in SUFFIXES and not name.startswith(".")]
    if not pictures:
        kinds = ", ".join(sorted(SUFFIXES))
        raise UserError(f"{path}: a folder without pictures", f"it needs {kinds} files, or name a video in it")
    return Pictures([path / name for name in sorted(pictures, key=natural_key)])
