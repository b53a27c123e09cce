"""Stored frames on disk: one file of concatenated encoded pictures, and one with a line of JSON per picture. Both append only.

    frames.bin     the packets, back to back
    frames.jsonl   {"seq", "source_seq", "epoch", "t_sensor_ns", "t_read_ns", "codec", "offset", "bytes", "crc32"} per packet

A packet is written before its line, each with one write. However the writer ends, every whole line belongs to a whole packet,
so all frames but the current one can be read. Nothing calls fsync: a recording survives a crash of the program, but not a
power cut. A packet of codec "eyes" holds no picture but a line of JSON, recorded where the mouse is the viewer.
"""

import hashlib
import json
import os
import zlib
from pathlib import Path

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.files.decoding import picture_of
from lfpipe.files.pictures import MAX_DECODING_BYTES, header_of
from lfpipe.files.safe_files import PRIVATE, check_regular, lines, open_regular, reason
from lfpipe.files.untrusted import json_fields
from lfpipe.host.files import CAREFUL, exists

PACKETS, INDEX = "frames.bin", "frames.jsonl"
CODECS = ("jpeg", "png", "raw", "eyes")
MAX_PIXELS = 8192 * 8192  # of a frame
PACKET_BYTES = 3 * MAX_PIXELS + (1 << 20)  # a packet is at most as large as the raw frame, plus headers
MAX_PACKETS = 1 << 20  # 9.7 hours at 30 Hz; each takes 300 bytes of memory
LINE_BYTES = 1024
COPY = "copy the whole folder again from where it was recorded"
CHANGED = "its bytes were changed after recording (checksum)"
SCAN, MAX_SCANS = b"\xff\xda", 100  # of a JPEG: each scan of a dozen bytes can cost one more pass over the whole picture
FORMATS = {"jpeg": "JPEG", "png": "PNG"}  # codec -> name of the picture's format
_TIME_NS = 1 << 61  # keeps differences, and sums over loops of the recording, within 64 bits
BOUNDS = {  # field of a line with a number -> (lowest, highest)
    "seq": (0, MAX_PACKETS),
    "source_seq": (0, 1 << 62),
    "epoch": (0, 1 << 62),
    "t_sensor_ns": (-_TIME_NS, _TIME_NS),
    "t_read_ns": (-_TIME_NS, _TIME_NS),
    "offset": (0, 1 << 62),
    "bytes": (0, PACKET_BYTES),
    "crc32": (0, (1 << 32) - 1),
}


@attrs.frozen
class Packet:
    """A line of the index. seq counts stored frames from 0; source_seq is the camera's count. Times are of CLOCK_MONOTONIC."""

    seq: int
    source_seq: int
    epoch: int
    t_sensor_ns: int
    t_read_ns: int
    codec: str
    offset: int
    bytes: int
    crc32: int


def line_of(packet: Packet) -> bytes:
    """The line of the index."""
    return json.dumps(attrs.asdict(packet)).encode() + b"\n"


def parse_line(line: bytes, where: str) -> Packet:
    """The packet of a line of the index. Raises UserError with the field's name."""
    fields = json_fields(line, where, COPY)
    if (codec := fields.text("codec")) not in CODECS:
        raise UserError(f"{where}: codec is {codec!r}, expected one of {', '.join(CODECS)}", COPY)
    return Packet(codec=codec, **{name: fields.integer(name, *bounds) for name, bounds in BOUNDS.items()})


def read_index(folder: Path, complete: bool) -> list[Packet]:
    """The packets in folder, in order. complete: the recording ended properly, so exactly all its frames must exist.

    Raises UserError with the first frame that is missing, damaged or out of order.
    """
    path, packets = folder / INDEX, list[Packet]()
    end, last_ns = 0, -_TIME_NS - 1
    try:
        check_regular(folder / PACKETS)
        size = (folder / PACKETS).stat().st_size
        for seq, (number, line) in enumerate(lines(path, LINE_BYTES, COPY)):
            if not line.endswith(b"\n"):  # an unfinished line: not yet a frame
                if complete:
                    raise UserError(f"{path}: its last line is cut off", COPY)
                break
            packet = parse_line(line, f"{path}:{number}")
            if packet.seq != seq:
                raise UserError(f"{folder}: frame {seq} is missing; frame {packet.seq} is in its place", COPY)
            if packet.offset != end:
                raise UserError(f"{folder}: frame {seq} does not begin where the previous frame ends", COPY)
            if packet.t_sensor_ns <= last_ns:
                back = f"its time stamp {packet.t_sensor_ns} ns is not after {last_ns} ns of the previous frame"
                raise UserError(f"{folder}: frame {seq}: {back}", "record it again: time stamps that go back cannot be replayed")
            end, last_ns = packet.offset + packet.bytes, packet.t_sensor_ns
            if end > size:
                if complete:
                    raise UserError(f"{folder / PACKETS} ends after {size} bytes, within frame {seq} ({end})", COPY)
                break
            if seq == MAX_PACKETS:
                raise UserError(f"{path}: more than {MAX_PACKETS} frames", "use a shorter recording")
            packets.append(packet)
    except OSError as error:
        raise UserError(f"{error.filename}: {reason(error)}", COPY) from None
    return packets


def encoded(picture: NDArray[np.uint8], fast: bool) -> tuple[str, bytes]:
    """(codec, packet) of a uint8 (height, width, 3) BGR picture without loss: PNG, or raw if there is no time."""
    if fast:
        return "raw", picture.tobytes()
    done, data = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, 3])
    assert done, "a uint8 picture is always a PNG"
    return "png", data.tobytes()


def packet_data(folder: Path, packet: Packet, remedy: str) -> bytes:
    """The bytes of a packet in folder. Raises UserError if they cannot be read."""
    try:
        with open_regular(folder / PACKETS) as file:
            return os.pread(file.fileno(), packet.bytes, packet.offset)
    except OSError as error:
        raise UserError(f"{folder / PACKETS}: frame {packet.seq}: cannot be read: {reason(error)}", remedy) from None


def changed(packet: Packet, data: bytes) -> bool:
    """Whether data differs from what was stored as packet."""
    return len(data) != packet.bytes or zlib.crc32(data) != packet.crc32


def decoded(packet: Packet, data: bytes, width_px: int, height_px: int, folder: Path) -> NDArray[np.uint8]:
    """The picture in data, uint8 (height_px, width_px, 3) BGR. Raises UserError if it is not whole or has another size.

    The header's claims are checked before a decoder allocates memory. folder: for the message.
    """
    wrong = _wrong(packet, data, width_px, height_px)
    if not wrong:
        if packet.codec == "raw":
            return np.frombuffer(data, np.uint8).reshape(height_px, width_px, 3)
        picture = picture_of(np.frombuffer(data, np.uint8))
        if picture is not None and picture.shape == (height_px, width_px, 3):
            return picture
        wrong = f"not a whole {packet.codec} picture of {width_px}x{height_px}"
    remedy = "`lfpipe sequence check` lists all such frames; `lfpipe sequence cut` copies the frames before it"
    raise UserError(f"{folder}: frame {packet.seq}: {wrong}", remedy)


def _wrong(packet: Packet, data: bytes, width_px: int, height_px: int) -> str:
    """The reason for not decoding data as that packet, or ""."""
    size = 3 * width_px * height_px
    if changed(packet, data):
        return CHANGED
    if packet.codec == "eyes":
        return "eyes, not a picture"
    if packet.codec == "raw":
        return "" if len(data) == size else f"{len(data)} bytes, not a raw picture of {width_px}x{height_px}"
    header = header_of(data)
    if header is None or header.format != FORMATS[packet.codec]:
        return f"not a {packet.codec} picture of {width_px}x{height_px}"
    if (header.width_px, header.height_px) not in ((width_px, height_px), (height_px, width_px)):  # JPEG orientation
        return f"a {packet.codec} picture that claims {header.width_px}x{header.height_px}, not {width_px}x{height_px}"
    if packet.codec == "jpeg" and (scans := data.count(SCAN)) > MAX_SCANS:
        return f"a jpeg picture with {scans} scans; at most {MAX_SCANS} are decoded"
    if size + len(data) > MAX_DECODING_BYTES:
        return f"decoding needs {(size + len(data)) / 1e6:.0f} MB; at most {MAX_DECODING_BYTES / 1e6:.0f} MB are allowed"
    return ""


class PacketWriter:
    """Appends to the two files in folder. Existing contents are kept up to the last whole frame."""

    def __init__(self, folder: Path) -> None:
        """Raises OSError if the files cannot be written."""
        self.count, self._offset = 0, 0
        self._sums = {name: hashlib.sha256() for name in (PACKETS, INDEX)}
        if exists(folder / INDEX):
            found = read_index(folder, complete=False)
            self.count, self._offset = len(found), found[-1].offset + found[-1].bytes if found else 0
            os.truncate(folder / INDEX, sum(len(line_of(packet)) for packet in found))
            os.truncate(folder / PACKETS, self._offset)
            for name, sum_ in self._sums.items():
                with (folder / name).open("rb") as file:
                    while block := file.read(1 << 20):
                        sum_.update(block)
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | CAREFUL
        self._packets, self._index = (os.open(folder / name, flags, PRIVATE) for name in (PACKETS, INDEX))

    def append(self, data: bytes, codec: str, source_seq: int, epoch: int, t_sensor_ns: int, t_read_ns: int) -> Packet:
        """Stores one packet. Raises OSError if the disk is full; the files then end with the previous frame."""
        stamps = (source_seq, epoch, t_sensor_ns, t_read_ns)
        packet = Packet(self.count, *stamps, codec, self._offset, len(data), zlib.crc32(data))
        line = line_of(packet)
        start = os.fstat(self._index).st_size
        try:
            for fd, written in ((self._packets, data), (self._index, line)):
                if os.write(fd, written) != len(written):
                    raise OSError(28, "No space left on device")
        except OSError:
            os.ftruncate(self._packets, self._offset)
            os.ftruncate(self._index, start)
            raise
        self.count, self._offset = self.count + 1, self._offset + len(data)
        self._sums[PACKETS].update(data)
        self._sums[INDEX].update(line)
        return packet

    def checksums(self) -> dict[str, str]:
        """sha256 of everything written so far, by file name."""
        return {name: sum_.hexdigest() for name, sum_ in self._sums.items()}

    def close(self) -> None:
        os.close(self._packets)
        os.close(self._index)
