"""Stored frames on disk: one file of concatenated encoded pictures, and one with a line of JSON per
picture. Both append only.

    frames.bin     the packets, back to back
    frames.jsonl   per packet {"seq", "source_seq", "epoch", "t_sensor_ns", "t_read_ns", "codec",
                   "offset", "bytes", "crc32"}

A packet is written before its line, each with one write. However the writer ends, every whole line
belongs to a whole packet, so all frames but the current one can be read. Nothing calls fsync: a
recording survives a crash of the program, but not a power cut. A packet of codec "eyes" holds no
picture but a line of JSON, recorded where the mouse is the viewer. A generated sequence has a file
of the true eyes, too.
"""

import csv
import errno
import json
import os
import zlib
from array import array
from collections.abc import Iterator
from pathlib import Path

import attrs
import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfpipe.errors import UserError, quoted
from lfpipe.eyes import EYES, MAX_EYE_PX
from lfpipe.files.codecs import MAX_FRAMES, picture_of
from lfpipe.files.pictures import MAX_DECODING_BYTES, header_of
from lfpipe.files.safe_files import (
    MAX_NS,
    PRIVATE,
    finite,
    json_fields,
    lines,
    open_regular,
    reason,
)
from lfpipe.host.files import CREATING, exists

PACKETS, INDEX = "frames.bin", "frames.jsonl"
CODECS = ("jpeg", "png", "raw", "eyes")
# bytes per pixel: imdecode needs two pictures, a progressive JPEG two bytes for each coefficient
_PICTURE_BYTES, _PROGRESSIVE_BYTES = 6, 12
# of a frame; `picture_of` decodes no more; 8K: 33 million
MAX_PIXELS = MAX_DECODING_BYTES // _PICTURE_BYTES
HEADER_BYTES = 1 << 20  # a packet is at most as large as the raw frame, plus headers
PACKET_BYTES = 3 * MAX_PIXELS + HEADER_BYTES
# of a packet of eyes, or a row of true ones: as JSON it takes forty times as much; one of ours has
# 400 or 200
EYES_BYTES = 4096
# A packet and what decodes it: who checks a sequence needs at most 300 MB, 80 MB of it for itself.
DECODING_BYTES = 210_000_000
LINE_BYTES = 1024  # one of ours has some 150
COPY = "copy the whole folder again from where it was recorded"
REPAIR = "copy the frames before it with `lfpipe sequence cut`"
_PROGRESSIVE = b"\xff\xc2"  # the frame header of such a JPEG
# Each scan is one more pass over the whole picture, for a dozen bytes; encoders use some ten.
_SCAN, MAX_SCANS = b"\xff\xda", 100
_ENCODING = {  # codec -> parameters of OpenCV
    # 10 s of noisy 640x480 camera pictures take less than 10 MB; one costs 2 ms of CPU
    "jpeg": [cv2.IMWRITE_JPEG_QUALITY, 85],
    "png": [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, 3],  # the fastest
}
BOUNDS = {  # field of a line with a number -> (lowest, highest)
    "seq": (0, MAX_FRAMES),
    "source_seq": (0, 1 << 62),
    "epoch": (0, 1 << 62),
    "t_sensor_ns": (-MAX_NS, MAX_NS),
    "t_read_ns": (-MAX_NS, MAX_NS),
    "offset": (0, 1 << 62),
    "bytes": (0, PACKET_BYTES),
    "crc32": (0, (1 << 32) - 1),
}


@attrs.frozen(kw_only=True)
class Packet:
    """A line of the index.

    seq counts stored frames from 0; source_seq is the camera's count. Times are of CLOCK_MONOTONIC.
    """

    seq: int
    source_seq: int
    epoch: int
    t_sensor_ns: int
    t_read_ns: int
    codec: str
    offset: int
    bytes: int
    crc32: int


class Packets:
    """The packets of an index in order, in little memory."""

    def __init__(self) -> None:
        self._numbers = {name: array("q") for name in BOUNDS}
        self._codecs = bytearray()

    def append(self, packet: Packet) -> None:
        """Adds a packet at the end."""
        for name, numbers in self._numbers.items():
            numbers.append(getattr(packet, name))
        self._codecs.append(CODECS.index(packet.codec))

    def __len__(self) -> int:
        return len(self._codecs)

    def __getitem__(self, index: int) -> Packet:
        numbers = {name: numbers[index] for name, numbers in self._numbers.items()}
        return Packet(codec=CODECS[self._codecs[index]], **numbers)

    def __iter__(self) -> Iterator[Packet]:
        return map(self.__getitem__, range(len(self)))

    @property
    def codecs(self) -> set[str]:
        """The codecs that occur."""
        return {CODECS[code] for code in set(self._codecs)}


def line_of(packet: Packet) -> bytes:
    """The line of the index."""
    return json.dumps(attrs.asdict(packet)).encode() + b"\n"


def parse_line(line: bytes, where: str) -> Packet:
    """The packet of a line of the index. Raises UserError with the field's name."""
    fields = json_fields(line, where, COPY)
    if (codec := fields.text("codec")) not in CODECS:
        raise UserError(f"{where}: codec is {codec!r}, expected one of {', '.join(CODECS)}", COPY)
    numbers = {name: fields.integer(name, *bounds) for name, bounds in BOUNDS.items()}
    if codec == "eyes" and numbers["bytes"] > EYES_BYTES:
        raise UserError(
            f"{where}: {numbers['bytes']} bytes of eyes; at most {EYES_BYTES} are read", COPY
        )
    return Packet(codec=codec, **numbers)


def read_index(folder: Path, most: int = MAX_FRAMES) -> Packets:
    """The whole packets in folder, in order, `most` at most.

    Raises UserError with the first frame that is missing, damaged or out of order.
    """
    path = folder / INDEX
    packets = Packets()
    end = 0
    last_ns = -MAX_NS - 1
    try:
        with open_regular(folder / PACKETS) as file:
            size = os.fstat(file.fileno()).st_size
        for seq, (number, line) in enumerate(lines(path, LINE_BYTES, COPY)):
            if seq == most or not line.endswith(b"\n"):  # an unfinished line: not yet a frame
                break
            packet = parse_line(line, f"{path}:{number}")
            if (packet.seq, packet.offset) != (seq, end):
                raise UserError(
                    f"{folder}: in place of frame {seq} at byte {end}, there is frame {packet.seq}"
                    f" at byte {packet.offset}",
                    COPY,
                )
            if packet.t_sensor_ns <= last_ns:
                raise UserError(
                    f"{folder}: frame {seq}: its time stamp {packet.t_sensor_ns} ns is not after"
                    f" {last_ns} ns of the previous frame",
                    "record it again: time stamps that go back cannot be replayed",
                )
            end = packet.offset + packet.bytes
            last_ns = packet.t_sensor_ns
            if end > size:
                break
            packets.append(packet)
    except OSError as error:
        raise UserError(f"{error.filename}: {reason(error)}", COPY) from None
    return packets


def encoded(picture: NDArray[np.uint8], codec: str = "png") -> bytes:
    """The packet of a uint8 (height, width, 3) BGR picture: without loss, unless it is a JPEG."""
    done, data = cv2.imencode(f".{codec}", picture, _ENCODING[codec])
    assert done, f"a uint8 picture is always a {codec}"
    return data.tobytes()


def read_packet(folder: Path, packet: Packet) -> bytes:
    """The bytes of a packet in folder.

    Raises UserError if they cannot be read, or were changed after recording.
    """
    try:
        with open_regular(folder / PACKETS) as file:
            data = os.pread(file.fileno(), packet.bytes, packet.offset)
    except OSError as error:
        raise UserError(
            f"{folder / PACKETS}: frame {packet.seq}: cannot be read: {reason(error)}", COPY
        ) from None
    if len(data) != packet.bytes or zlib.crc32(data) != packet.crc32:
        raise UserError(
            f"{folder}: frame {packet.seq}: its bytes were changed after recording (checksum)",
            REPAIR,
        )
    return data


def decoded(
    packet: Packet, data: bytes, width_px: int, height_px: int, folder: Path
) -> NDArray[np.uint8]:
    """The picture in data, uint8 (height_px, width_px, 3) BGR. Raises UserError if it is not whole
    or has another size.

    The header's claims are checked before a decoder allocates memory. folder: for the message.
    """
    wrong = ""
    codec = packet.codec
    shape = (height_px, width_px, 3)
    if codec == "raw" and len(data) == 3 * width_px * height_px:
        return np.frombuffer(data, np.uint8).reshape(shape)
    pixels = width_px * height_px
    progressive = codec == "jpeg" and _PROGRESSIVE in data
    px_bytes = _PROGRESSIVE_BYTES if progressive else _PICTURE_BYTES
    needs = len(data) + px_bytes * pixels
    small = len(data) <= 3 * pixels + HEADER_BYTES
    header = header_of(data) if codec in _ENCODING and small else None
    if codec == "jpeg" and data.count(_SCAN) > MAX_SCANS:
        wrong = f"a {codec} picture of more than {MAX_SCANS} scans"
    if codec in _ENCODING and needs > DECODING_BYTES:
        limit = f"at most {DECODING_BYTES / 1e6:.0f} MB are used"
        wrong = f"decoding it needs {needs / 1e6:.0f} MB; {limit}"
    if (
        not wrong
        and header is not None
        and header.format == codec.upper()
        and header.width_px * header.height_px == pixels
        and (picture := picture_of(np.frombuffer(data, np.uint8))) is not None
        and picture.shape == shape
    ):
        return picture
    wrong = wrong or f"not a whole {codec} picture of {width_px}x{height_px}"
    raise UserError(f"{folder}: frame {packet.seq}: {wrong}", REPAIR)


class PacketWriter:
    """Appends to the two files in folder. Existing contents are kept up to the last whole frame."""

    def __init__(self, folder: Path) -> None:
        """Raises OSError if the files cannot be written."""
        packets = read_index(folder) if exists(folder / INDEX) else Packets()
        self.count = len(packets)
        self._ends = [
            sum(packet.bytes for packet in packets),
            sum(len(line_of(packet)) for packet in packets),
        ]
        self._files = [
            os.open(folder / name, os.O_WRONLY | os.O_CREAT | CREATING, PRIVATE)
            for name in (PACKETS, INDEX)
        ]
        for file, end in zip(self._files, self._ends, strict=True):
            os.ftruncate(file, end)

    def append(
        self, data: bytes, codec: str, source_seq: int, epoch: int, t_sensor_ns: int, t_read_ns: int
    ) -> None:
        """Stores one packet.

        Raises OSError if the disk is full; the sequence then ends with the previous frame.
        """
        packet = Packet(
            seq=self.count,
            source_seq=source_seq,
            epoch=epoch,
            t_sensor_ns=t_sensor_ns,
            t_read_ns=t_read_ns,
            codec=codec,
            offset=self._ends[0],
            bytes=len(data),
            crc32=zlib.crc32(data),
        )
        line = line_of(packet)
        for file, end, new in zip(self._files, self._ends, (data, line), strict=True):
            if os.pwrite(file, new, end) != len(new):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self.count += 1
        self._ends = [self._ends[0] + len(data), self._ends[1] + len(line)]

    def close(self) -> None:
        """Ends both files with the last whole frame."""
        for file, end in zip(self._files, self._ends, strict=True):
            os.ftruncate(file, end)
            os.close(file)


TRUTH = "truth.csv"
COLUMNS = ("left_x_px", "left_y_px", "right_x_px", "right_y_px")
REMEDY = (
    f"write one row per frame with columns t_ns, {', '.join(COLUMNS)}, and optionally visible (0"
    " or 1)"
)


@attrs.frozen(eq=False)
class Truth:
    """Ground truth of a recording."""

    t_ns: NDArray[np.int64]
    """(n,) since the first frame."""
    eyes_px: NDArray[np.float64]
    """(n, 2, 2)."""
    visible: NDArray[np.bool_]
    """(n,): both eyes are in view."""
    still: NDArray[np.bool_] = attrs.Factory(
        lambda self: np.zeros(len(self.t_ns), np.bool_), takes_self=True
    )
    """(n,): the head rests."""

    def at(self, t_ns: ArrayLike) -> NDArray[np.float64]:
        """The eyes (..., 2, 2) px at times (...) after the first frame, between its rows; constant
        before and after them.
        """
        columns = [
            np.interp(np.asarray(t_ns), self.t_ns, column)
            for column in self.eyes_px.reshape(-1, 4).T
        ]
        return np.stack(columns, axis=-1).reshape(*np.shape(t_ns), 2, 2)

    def sees(self, t_ns: ArrayLike) -> NDArray[np.bool_]:
        """Whether both eyes are in view in the frames before and after times (...); not before the
        first and after the last.
        """
        after = np.searchsorted(self.t_ns, t_ns)
        inside = (np.asarray(t_ns) >= self.t_ns[0]) & (after < len(self.t_ns))
        return np.asarray(
            inside
            & self.visible[np.maximum(after - 1, 0)]
            & self.visible[np.minimum(after, len(self.t_ns) - 1)]
        )

    def error_px(self, eyes_px: ArrayLike, t_ns: ArrayLike) -> NDArray[np.float64]:
        """Root mean square over both eyes (..., 2, 2) of the distance from the truth at times
        (...), px; NaN where hidden.
        """
        error_px = np.sqrt(np.square(np.subtract(eyes_px, self.at(t_ns))).sum(axis=(-2, -1)) / 2)
        return np.where(self.sees(t_ns), error_px, np.nan)


def eyes_line(record: NDArray[np.void], **stamps: int) -> bytes:
    """A record of dtype EYES as a packet: a line of JSON."""
    return (
        json.dumps(
            {**stamps, **{name: record[name].tolist() for name in EYES.names or ()}}
        ).encode()
        + b"\n"
    )


def eyes_of(line: bytes, where: str) -> NDArray[np.void]:
    """The record of dtype EYES in a line of `eyes_line`; what it does not name is 0.

    Raises UserError.
    """
    fields = json_fields(line, where, COPY)
    record = np.zeros((), EYES)
    # which its player sets
    for name in set(EYES.names or ()) & fields.values.keys() - {"t_tracked_ns"}:
        most = 1 if name == "face" else MAX_EYE_PX
        shape = record[name].shape
        try:
            value = np.asarray(fields.values[name], np.float64)
        except (ValueError, TypeError):
            value = np.array(np.nan)
        if value.shape != shape or not (np.abs(value) <= most).all():
            expected = f"{'x'.join(map(str, shape))} numbers" if shape else "a number"
            raise UserError(
                f"{where}: {name} is {quoted(fields.values[name])}, expected {expected} up to"
                f" {most:g}",
                COPY,
            )
        record[name] = value
    return record


def read_truth(folder: Path) -> Truth | None:
    """The truth of the sequence in folder, or None. Raises UserError if it cannot be read."""
    path = folder / TRUTH
    return table_of(path) if os.path.lexists(path) else None


def table_of(path: Path) -> Truth:
    """The truth in a table. Raises UserError with the wrong row and column."""
    stamps = array("q")
    numbers = array("d")
    visible = bytearray()
    still = bytearray()
    where = str(path)
    try:
        table = csv.DictReader(
            (line.decode() for _, line in lines(path, EYES_BYTES, REMEDY)), strict=True
        )
        columns = list(table.fieldnames or ())
        if missing := [name for name in ("t_ns", *COLUMNS) if columns.count(name) != 1]:
            raise UserError(
                f"{path}: not a table of true eyes: column {missing[0]} must exist exactly once",
                REMEDY,
            )
        for row in table:
            where = f"{path}:{table.line_num}"
            if None in row or None in row.values():
                raise ValueError(f"expected {len(columns)} values")
            for name in COLUMNS:
                if (px := finite(row[name], -MAX_EYE_PX, MAX_EYE_PX)) is None:
                    raise UserError(
                        f"{where}: {name} is {quoted(row[name])}, expected a number of px", REMEDY
                    )
                numbers.append(px)
            t_ns = int(row["t_ns"])
            last_ns = stamps[-1] if stamps else -MAX_NS - 1
            if not last_ns < t_ns <= MAX_NS:
                raise UserError(
                    f"{where}: times must rise: t_ns is {quoted(t_ns)}, after {last_ns}", REMEDY
                )
            if len(stamps) == MAX_FRAMES:
                raise UserError(f"{where}: more than {MAX_FRAMES} rows", REMEDY)
            stamps.append(t_ns)
            visible.append(row.get("visible") != "0")
            still.append(row.get("phase") == "still")
    except (csv.Error, ValueError) as error:
        raise UserError(f"{where}: not a line of a table: {error}", REMEDY) from None
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {reason(error)}", REMEDY) from None
    if not stamps:
        raise UserError(f"{path}: contains no row", REMEDY)
    t_ns_of = np.array(stamps, np.int64)
    points = np.array(numbers).reshape(-1, 2, 2)
    return Truth(
        t_ns_of - t_ns_of[0], points, np.array(visible, np.bool_), np.array(still, np.bool_)
    )


def summary(errors_px: NDArray[np.float64]) -> dict[str, float] | None:
    """{"n", "rms_px", "p95_px", "max_px"} of the errors that are numbers; None without any."""
    errors = errors_px[np.isfinite(errors_px)]
    if not len(errors):
        return None
    metrics = {
        "rms_px": np.sqrt(np.mean(errors**2)),
        "p95_px": np.percentile(errors, 95),
        "max_px": errors.max(),
    }
    return {"n": len(errors), **{name: round(float(value), 4) for name, value in metrics.items()}}
