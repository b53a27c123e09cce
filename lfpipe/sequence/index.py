"""The index of a recording: one line of JSON per stored frame, checked line by line, stored as numbers."""

import json
from array import array
from collections.abc import Sequence
from pathlib import Path
from typing import overload

import attrs

from lfpipe.errors import UserError
from lfpipe.files.safe_files import check_regular, lines, reason
from lfpipe.files.untrusted import Fields, json_fields

PACKETS, INDEX = "frames.bin", "frames.jsonl"
CODECS = ("jpeg", "png", "raw")
MAX_PIXELS = 8192 * 8192  # of a frame
PACKET_BYTES = 3 * MAX_PIXELS + (1 << 20)  # a packet is at most as large as the raw frame, plus headers
MAX_PACKETS = 1 << 21  # 19 hours at 30 Hz
LINE_BYTES = 1024
COPY = "copy the whole folder again from where it was recorded"
_TIME_NS = 1 << 61  # keeps differences, and sums over loops of the recording, within 64 bits


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


NUMBERS = {  # of a line -> (lowest, highest)
    "seq": (0, MAX_PACKETS),
    "t_sensor_ns": (-_TIME_NS, _TIME_NS),
    "offset": (0, 1 << 62),
    "bytes": (0, PACKET_BYTES),
    "source_seq": (0, 1 << 62),
    "epoch": (0, 1 << 62),
    "t_read_ns": (-_TIME_NS, _TIME_NS),
    "crc32": (0, (1 << 32) - 1),
}
_BOUNDS = list(NUMBERS.items())
Line = tuple[list[int], str]  # values of NUMBERS, and the codec


class Packets(Sequence[Packet]):
    """Packets in order, one row of numbers each: compact even for hours."""

    def __init__(self) -> None:
        self._rows, self._codecs = array("q"), bytearray()

    def append(self, line: Line) -> None:
        """Appends one."""
        self._rows.extend(line[0])
        self._codecs.append(CODECS.index(line[1]))

    def __len__(self) -> int:
        return len(self._codecs)

    @overload
    def __getitem__(self, index: int) -> Packet: ...

    @overload
    def __getitem__(self, index: slice) -> list[Packet]: ...

    def __getitem__(self, index: int | slice) -> Packet | list[Packet]:
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        at = range(len(self))[index] * len(NUMBERS)
        row = dict(zip(NUMBERS, self._rows[at : at + len(NUMBERS)], strict=True))
        return Packet(codec=CODECS[self._codecs[index]], **row)


def line_of(packet: Packet) -> bytes:
    """The line of the index."""
    return json.dumps(attrs.asdict(packet)).encode() + b"\n"


def parse_line(line: bytes, where: str) -> Line:
    """Raises UserError with the field's name."""
    try:
        found = json.loads(line)
    except (ValueError, RecursionError):
        found = None
    if isinstance(found, dict) and len(found) == len(NUMBERS) + 1 and found.get("codec") in CODECS:
        numbers = []
        for name, (low, high) in _BOUNDS:
            value = found.get(name)
            if type(value) is not int or not low <= value <= high:
                break
            numbers.append(value)
        else:
            return numbers, found["codec"]
    return _explained(json_fields(line, where, COPY))


def _explained(fields: Fields) -> Line:
    """Parses a wrong line again, slowly, to raise a precise UserError."""
    if strange := sorted(set(fields.values) - set(NUMBERS) - {"codec"}):
        raise UserError(f"{fields.where}: unknown field {strange[0]!r}", COPY)
    if (codec := fields.text("codec")) not in CODECS:
        raise UserError(f"{fields.where}: codec is {codec!r}, expected one of {', '.join(CODECS)}", COPY)
    return [fields.integer(name, *bounds) for name, bounds in _BOUNDS], codec


def read_index(folder: Path, complete: bool) -> Packets:
    """The packets in folder, in order. complete: the recording ended properly, so exactly all its frames must exist.

    Raises UserError with the first frame that is missing, damaged or out of order.
    """
    path, packets = folder / INDEX, Packets()
    end, last_ns = 0, -_TIME_NS - 1
    try:
        check_regular(folder / PACKETS)
        size = (folder / PACKETS).stat().st_size
        for number, line in lines(path, LINE_BYTES, COPY):
            if not line.endswith(b"\n"):  # an unfinished line: not yet a frame
                if complete:
                    raise UserError(f"{path}: its last line is cut off", COPY)
                break
            found = parse_line(line, f"{path}:{number}")
            seq, t_ns, offset, count, *_ = found[0]
            if seq != number - 1:
                raise UserError(f"{folder}: frame {number - 1} is missing; frame {seq} is in its place", COPY)
            if offset != end:
                raise UserError(f"{folder}: frame {seq} does not begin where the previous frame ends", COPY)
            if t_ns <= last_ns:
                back = f"its time stamp {t_ns} ns is not after {last_ns} ns of the previous frame"
                raise UserError(f"{folder}: frame {seq}: {back}", "record it again: time stamps that go back cannot be replayed")
            end, last_ns = offset + count, t_ns
            if end > size:
                if complete:
                    ends = f"{folder / PACKETS} ends after {size} bytes"
                    raise UserError(f"{ends}, within frame {seq} ({end})", COPY)
                break
            if len(packets) == MAX_PACKETS:
                raise UserError(f"{path}: more than {MAX_PACKETS} frames", "use a shorter recording")
            packets.append(found)
    except OSError as error:
        raise UserError(f"{error.filename}: {reason(error)}", COPY) from None
    return packets
