"""Stored frames on disk: one file of concatenated encoded pictures, and one with a line of JSON per picture. Both append only.

    frames.bin     the packets, back to back
    frames.jsonl   {"seq", "source_seq", "epoch", "t_sensor_ns", "t_read_ns", "codec", "offset", "bytes", "crc32"} per packet

A packet is written before its line, each with one write. However the writer ends, every whole line belongs to a whole packet,
so all frames but the current one can be read. Nothing calls fsync: a recording survives a crash of the program, but not a
power cut.
"""

import hashlib
import os
import zlib
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.files.decoding import picture_of
from lfpipe.files.pictures import MAX_DECODING_BYTES, header_of
from lfpipe.files.safe_files import PRIVATE
from lfpipe.host.files import CAREFUL, exists
from lfpipe.sequence.index import INDEX, PACKETS, Packet, line_of, read_index

SCAN, MAX_SCANS = b"\xff\xda", 100  # of a JPEG: each scan of a dozen bytes can cost one more pass over the whole picture
CHANGED = "its bytes were changed after recording (checksum)"
FORMATS = {"jpeg": "JPEG", "png": "PNG"}  # codec -> name of the picture's format


def encoded(picture: NDArray[np.uint8], fast: bool) -> tuple[str, bytes]:
    """(codec, packet) of a uint8 (height, width, 3) BGR picture without loss: PNG, or raw if there is no time."""
    if fast:
        return "raw", picture.tobytes()
    done, data = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, 3])
    assert done, "a uint8 picture is always a PNG"
    return "png", data.tobytes()


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
        if exists(folder / INDEX):
            found = read_index(folder, complete=False)
            self.count, self._offset = len(found), found[-1].offset + found[-1].bytes if found else 0
            os.truncate(folder / INDEX, sum(len(line_of(packet)) for packet in found))
            os.truncate(folder / PACKETS, self._offset)
        self._sums = {name: hashlib.sha256() for name in (PACKETS, INDEX)}
        for name, sum_ in self._sums.items():
            if exists(folder / name):
                with (folder / name).open("rb") as file:
                    while part := file.read(1 << 20):
                        sum_.update(part)
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | CAREFUL
        self._packets, self._index = (os.open(folder / name, flags, PRIVATE) for name in (PACKETS, INDEX))

    def append(self, data: bytes, codec: str, source_seq: int, epoch: int, t_sensor_ns: int, t_read_ns: int) -> Packet:
        """Stores one packet. Raises OSError if the disk is full; the files then end with the previous frame."""
        stamps = (source_seq, epoch, t_sensor_ns, t_read_ns)
        packet = Packet(self.count, *stamps, codec, self._offset, len(data), zlib.crc32(data))
        line = line_of(packet)
        start = os.fstat(self._index).st_size
        try:
            for fd, part in ((self._packets, data), (self._index, line)):
                if os.write(fd, part) != len(part):
                    raise OSError(28, "No space left on device")
        except OSError:
            os.ftruncate(self._packets, self._offset)
            os.ftruncate(self._index, start)
            raise
        self.count, self._offset = self.count + 1, self._offset + len(data)
        self._sums[PACKETS].update(data)
        self._sums[INDEX].update(line)
        return packet

    def in_place(self, folder: Path) -> bool:
        """Whether folder still contains the files being written."""
        try:
            return (folder / INDEX).stat().st_ino == os.fstat(self._index).st_ino
        except FileNotFoundError:
            return False

    def checksums(self) -> dict[str, str]:
        """sha256 of everything written so far, by file name."""
        return {name: sum_.hexdigest() for name, sum_ in self._sums.items()}

    def close(self) -> None:
        os.close(self._packets)
        os.close(self._index)
