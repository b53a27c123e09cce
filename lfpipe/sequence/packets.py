"""Stored frames on disk: encoded pictures one after the other in one file, a line of JSON for each in another, append only.

    frames.bin     the packets, back to back
    frames.jsonl   {"seq", "source_seq", "epoch", "t_sensor_ns", "t_read_ns", "codec", "offset", "bytes", "crc32"} per packet

A packet is written before its line, each with one write: whatever ends the writer, every line that is whole leads to a packet
that is whole, so all but the frame under way can be read. Nothing waits for the disk: a recording outlives the program, not a
power cut.
"""

from __future__ import annotations

import hashlib
import json
import os
import zlib
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.decode import picture_of
from lfpipe.errors import UserError

PACKETS, INDEX = "frames.bin", "frames.jsonl"
CODECS = ("jpeg", "png", "raw")


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


def encoded(picture: NDArray[np.uint8], fast: bool) -> tuple[str, bytes]:
    """(codec, packet) of a uint8 (height, width, 3) BGR picture without loss: PNG, or as it stands where there is no time."""
    if fast:
        return "raw", picture.tobytes()
    done, data = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, 3])
    assert done, "a uint8 picture is always a PNG"
    return "png", data.tobytes()


def decoded(packet: Packet, data: bytes, width_px: int, height_px: int) -> NDArray[np.uint8]:
    """The picture in data, uint8 (height_px, width_px, 3) BGR. Raises UserError where it is not whole or of another size."""
    wrong = ""
    picture: Any = None
    if zlib.crc32(data) != packet.crc32:
        wrong = "its bytes are not those that were recorded (checksum)"
    elif packet.codec == "raw":
        size = height_px * width_px * 3
        picture = np.frombuffer(data, np.uint8).reshape(height_px, width_px, 3) if len(data) == size else None
    else:
        picture = picture_of(np.frombuffer(data, np.uint8))
    if not wrong and (picture is None or picture.shape != (height_px, width_px, 3)):
        wrong = f"no {packet.codec} picture of {width_px}x{height_px}"
    if wrong:
        raise UserError(f"frame {packet.seq}: {wrong}", "`lfpipe sequence check` tells what else is wrong; record it anew")
    return np.asarray(picture, np.uint8)


class PacketWriter:
    """Appends to the two files in folder; what is there already is kept up to its last whole frame."""

    def __init__(self, folder: Path) -> None:
        """Raises OSError where the files cannot be written."""
        self.count, self._offset = 0, 0
        if (folder / INDEX).exists():
            found = read_index(folder, complete=False)
            self.count, self._offset = len(found), found[-1].offset + found[-1].bytes if found else 0
            os.truncate(folder / INDEX, sum(len(_line(packet)) for packet in found))
            os.truncate(folder / PACKETS, self._offset)
        self._sums = {name: hashlib.sha256() for name in (PACKETS, INDEX)}
        for name, sum_ in self._sums.items():
            if (folder / name).exists():
                with (folder / name).open("rb") as file:
                    while part := file.read(1 << 20):
                        sum_.update(part)
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT
        self._packets, self._index = (os.open(folder / name, flags, 0o644) for name in (PACKETS, INDEX))

    def append(self, data: bytes, codec: str, source_seq: int, epoch: int, t_sensor_ns: int, t_read_ns: int) -> Packet:
        """Stores one packet. Raises OSError where the disk is full; the files then end with the frame before."""
        stamps = (source_seq, epoch, t_sensor_ns, t_read_ns)
        packet = Packet(self.count, *stamps, codec, self._offset, len(data), zlib.crc32(data))
        line = _line(packet)
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

    def checksums(self) -> dict[str, str]:
        """sha256 of what was written so far, by file name."""
        return {name: sum_.hexdigest() for name, sum_ in self._sums.items()}

    def close(self) -> None:
        os.close(self._packets)
        os.close(self._index)


def _line(packet: Packet) -> bytes:
    return json.dumps(attrs.asdict(packet)).encode() + b"\n"


def _parsed(line: str) -> Packet | None:
    try:
        found = json.loads(line)
        packet = Packet(**found)
    except (ValueError, TypeError):
        return None
    numbers = [value for name, value in found.items() if name != "codec"]
    good = packet.codec in CODECS and all(type(value) is int for value in numbers) and packet.offset >= 0 and packet.bytes >= 0
    return packet if good else None


def read_index(folder: Path, complete: bool) -> list[Packet]:
    """The packets in folder, in order. complete: the recording came to its end, so that all of it must be there.

    Raises UserError that names the first frame that is missing, damaged or out of order.
    """
    remedy = "`lfpipe sequence cut` keeps the part before it"
    try:
        text = (folder / INDEX).read_text(errors="replace")
        size = (folder / PACKETS).stat().st_size
    except OSError as error:
        raise UserError(f"{error.filename}: {error.strerror}", "a sequence needs both its files: copy the whole folder") from None
    lines = text.split("\n")
    tail = lines.pop()  # of a line that was being written: no frame yet
    if tail and complete:
        raise UserError(f"{folder / INDEX}: its last line is cut off", "copy the file again")
    packets: list[Packet] = []
    for number, line in enumerate(lines):
        packet = _parsed(line)
        if packet is None:
            raise UserError(f"{folder / INDEX}:{number + 1}: not the line of a frame", remedy)
        if packet.seq != number:
            raise UserError(f"{folder}: frame {number} is missing, frame {packet.seq} stands in its place", remedy)
        last = packets[-1] if packets else None
        if packet.offset != (last.offset + last.bytes if last else 0):
            raise UserError(f"{folder}: frame {number} does not begin where the one before it ends", remedy)
        if last and packet.t_sensor_ns <= last.t_sensor_ns:
            back = f"its time stamp {packet.t_sensor_ns} ns is not after {last.t_sensor_ns} ns of the one before"
            raise UserError(f"{folder}: frame {number}: {back}", "a clock that went back cannot be replayed; " + remedy)
        if packet.offset + packet.bytes > size:
            if complete:
                end = f"{folder / PACKETS} ends after {size} bytes"
                raise UserError(f"{end}, within frame {number} ({packet.offset + packet.bytes})", "copy it again; " + remedy)
            break
        packets.append(packet)
    return packets
