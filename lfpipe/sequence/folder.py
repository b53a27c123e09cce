"""A recorded sequence: a folder with manifest.json, the packets of the frames, and further data
about them.

    manifest.json   format, version, source, size, rate, versions, config;
                    once it is complete also frames, and sha256 of the files in SUMMED
    frames.bin      the frames, or the eyes of the mouse (`lfpipe.sequence.packets`)
    frames.jsonl    their index
    truth.csv       true eyes of a generated sequence:
                    source_seq,t_ns,left_x_px,left_y_px,right_x_px,right_y_px,...
"""

import contextlib
import hashlib
import itertools
import json
import os
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError, plain
from lfpipe.files.codecs import MAX_FRAMES
from lfpipe.files.safe_files import (
    PRIVATE_FOLDER,
    WORK_NAME,
    Fields,
    check_links,
    create_private,
    json_fields,
    lines,
    open_file,
    read_bytes,
    reason,
    replaced,
)
from lfpipe.host.files import exists
from lfpipe.sequence.packets import (
    COPY,
    EYES_BYTES,
    INDEX,
    LINE_BYTES,
    MAX_PIXELS,
    PACKETS,
    REMEDY,
    TRUTH,
    Packets,
    PacketWriter,
    decoded,
    eyes_of,
    read_index,
    read_packet,
)

FORMAT = "lfpipe-sequence"
VERSION = 1
MANIFEST = "manifest.json"
FILES = (PACKETS, INDEX, TRUTH)
# files whose sums the manifest holds; every packet has its own in the index
SUMMED = (INDEX, TRUTH)
SUMMED_BYTES = MAX_FRAMES * LINE_BYTES  # of the longest index
MAX_HZ = 100_000.0  # no camera is faster


def is_sequence(path: Path) -> bool:
    """Whether path is the folder of a sequence, readable or not."""
    return os.path.lexists(path / MANIFEST)


def make_out(path: Path) -> None:
    """Creates the empty folder of a new sequence, private to its owner: frames show a person.

    Raises UserError if that fails, or if path exists.
    """
    try:
        path.mkdir(PRIVATE_FOLDER, parents=True)
    except FileExistsError:
        raise UserError(
            f"{path}: already exists", "use another name; nothing is overwritten"
        ) from None
    except (OSError, ValueError) as error:
        raise UserError(
            f"{path}: {reason(error)}", "name a folder in a directory that you may write to"
        ) from None


def check_out(path: Path) -> None:
    """Raises UserError unless `make_out` would succeed now. Leaves nothing."""
    missing = [folder for folder in (path, *path.parents) if not os.path.lexists(folder)]
    make_out(path)
    with contextlib.suppress(OSError):  # another program uses one of them already
        for folder in missing:
            folder.rmdir()


def remove_empty(path: Path) -> None:
    """Removes the folder of a sequence without a complete frame, unless it holds other files."""
    with contextlib.suppress(OSError, UserError):
        names = {entry.name for entry in path.iterdir() if not WORK_NAME.fullmatch(entry.name)}
        if names <= {MANIFEST, PACKETS, INDEX} and not (INDEX in names and read_index(path)):
            shutil.rmtree(path)


class SequenceWriter(PacketWriter):
    """A sequence under way in an existing folder: begins with a manifest that is not complete."""

    def __init__(
        self, folder: Path, source: str, size_px: tuple[int, int], rate_hz: float, **more: Any
    ) -> None:
        """more: versions, config. Raises OSError if nothing can be written."""
        about = {
            "source": plain(source, 4096),
            "width_px": size_px[0],
            "height_px": size_px[1],
            "rate_hz": rate_hz,
        }
        created = time.strftime("%Y-%m-%dT%H:%M:%S%z")
        self._folder = folder
        self._manifest = {
            "format": FORMAT,
            "version": VERSION,
            "created": created,
            **about,
            **more,
            "complete": False,
        }
        self._write_manifest()
        super().__init__(folder)

    def _write_manifest(self) -> None:
        with replaced(self._folder / MANIFEST) as file:
            file.write(json.dumps(self._manifest, indent=1, allow_nan=False).encode() + b"\n")

    def complete(self) -> None:
        """Ends the sequence.

        Raises OSError if the disk is full; the first manifest is then kept.
        """
        self.close()
        checksums = {
            name: _sha256(self._folder / name) for name in SUMMED if exists(self._folder / name)
        }
        self._manifest |= {"complete": True, "frames": self.count, "checksums": checksums}
        self._write_manifest()


@contextlib.contextmanager
def new_sequence(
    path: Path, source: str, size_px: tuple[int, int], rate_hz: float, **more: Any
) -> Iterator[SequenceWriter]:
    """A `SequenceWriter` in a new folder. If the body fails, the folder is removed. Raises
    UserError as `make_out`, and if the disk is full.
    """
    make_out(path)
    try:
        writer = SequenceWriter(path, source, size_px, rate_hz, **more)
        yield writer
        writer.complete()
    except BaseException as error:
        shutil.rmtree(path, ignore_errors=True)
        if isinstance(error, OSError):
            raise UserError(
                f"{path}: {reason(error)}; nothing was written", "use a disk with enough free space"
            ) from None
        raise


def _sha256(path: Path) -> str:
    """Raises UserError if the file cannot be read, or is too large."""
    with open_file(path, SUMMED_BYTES) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@attrs.frozen(eq=False, kw_only=True)
class Sequence:
    """An opened sequence."""

    path: Path
    manifest: dict[str, Any]
    packets: Packets
    width_px: int
    height_px: int
    rate_hz: float
    complete: bool
    """Its recording ended properly; otherwise it holds the frames up to the cut."""

    def data(self, index: int) -> bytes:
        """The packet of a frame as it was stored.

        Raises UserError if it cannot be read, or has changed.
        """
        return read_packet(self.path, self.packets[index])

    def frame(self, index: int, data: bytes | None = None) -> NDArray[np.uint8]:
        """A frame, uint8 (height, width, 3) BGR. data: its packet, if it has been read. Raises
        UserError if that is damaged, or holds eyes.
        """
        return decoded(
            self.packets[index],
            self.data(index) if data is None else data,
            *self.size_px,
            self.path,
        )

    def eyes(self, index: int) -> NDArray[np.void]:
        """The record, of dtype EYES, that replaces a frame.

        Raises UserError if its packet is damaged.
        """
        return eyes_of(self.data(index), f"{self.path}: frame {index}")

    @property
    def holds_eyes(self) -> bool:
        """Whether it holds the eyes of the mouse instead of frames."""
        return self.packets[0].codec == "eyes"

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the frames."""
        return self.width_px, self.height_px

    @property
    def duration_s(self) -> float:
        """Time from the first frame's stamp to the last one's."""
        return (self.packets[-1].t_sensor_ns - self.packets[0].t_sensor_ns) / 1e9

    @property
    def lost(self) -> int:
        """Frames that the camera counted but that were not stored."""
        return sum(
            max(0, b.source_seq - a.source_seq - 1) for a, b in itertools.pairwise(self.packets)
        )

    @property
    def measured_hz(self) -> float:
        """Frames per second by the stamps; rate_hz if there is only one frame."""
        return (len(self.packets) - 1) / self.duration_s if len(self.packets) > 1 else self.rate_hz


def open_sequence(path: Path, verify: bool = True) -> Sequence:
    """The sequence at path. verify: also compare every packet and file with its checksum.

    Raises UserError if it is not a sequence, has an unknown version, is damaged, or has no frame.
    """
    check_links(path, (MANIFEST, *FILES))
    fields = _manifest(path)
    width_px = fields.integer("width_px", 1, MAX_PIXELS)
    height_px = fields.integer("height_px", 1, MAX_PIXELS)
    if width_px * height_px > MAX_PIXELS:
        raise UserError(
            f"{fields.where}: frames of {width_px}x{height_px}; at most {MAX_PIXELS} px are"
            " allowed",
            COPY,
        )
    rate_hz = fields.number("rate_hz", 1e-3, MAX_HZ)
    complete = fields.flag("complete")
    frames = fields.integer("frames", 1, MAX_FRAMES) if complete else MAX_FRAMES
    packets = read_index(path, frames + 1)
    if not len(packets):
        raise UserError(f"{path}: contains no whole frame", "record it again")
    if complete and len(packets) != frames:
        raise UserError(f"{path}: {len(packets)} frames, but {frames} were recorded", COPY)
    sequence = Sequence(
        path=path,
        manifest=dict(fields.values),
        packets=packets,
        width_px=width_px,
        height_px=height_px,
        rate_hz=rate_hz,
        complete=complete,
    )
    if sequence.packets.codecs > {"eyes"}:
        raise UserError(f"{path}: mixes frames with eyes", COPY)
    if sequence.measured_hz > MAX_HZ:
        raise UserError(
            f"{path}: {len(packets)} frames in {sequence.duration_s:g} s: no camera is that fast",
            "record it again",
        )
    if verify:
        check_sums(sequence)
        for packet in packets:
            read_packet(path, packet)
    return sequence


def _manifest(path: Path) -> Fields:
    """The manifest; the types of its optional entries have been checked."""
    where = path / MANIFEST
    try:
        data = read_bytes(where)
    except (FileNotFoundError, NotADirectoryError):
        what = (
            f"not a recorded sequence: {MANIFEST} is missing"
            if os.path.lexists(path)
            else "no such folder"
        )
        raise UserError(
            f"{path}: {what}", "make one with `lfpipe record OUT` or `lfpipe sequence import`"
        ) from None
    except OSError as error:
        raise UserError(f"{where}: cannot be read: {reason(error)}", COPY) from None
    fields = json_fields(data, str(where), COPY)
    if fields.values.get("format") != FORMAT:
        raise UserError(
            f"{where}: is not the manifest of a recorded sequence",
            f'give a folder whose manifest has the "format" "{FORMAT}"',
        )
    if fields.values.get("version") != VERSION:
        version = fields.integer("version", 0, 1 << 30)
        raise UserError(
            f"{where}: the sequence has version {version}; this lfpipe reads version {VERSION}",
            "read it with the lfpipe that recorded it (versions in its manifest)",
        )
    for name in {"source", "created", "made"} & fields.values.keys():
        fields.text(name)
    for name in {"versions", "config", "checksums"} & fields.values.keys():
        fields.table(name)
    if "camera" in fields.values.get("config", ()):
        fields.table("config").table("camera")
    return fields


def check_sums(sequence: Sequence) -> None:
    """Raises UserError if a file beside the packets has another checksum than when the recording
    ended.
    """
    checksums = sequence.manifest.get("checksums", {})
    for path, name in ((sequence.path / name, name) for name in SUMMED if name in checksums):
        if _sha256(path) != checksums[name]:
            raise UserError(f"{path}: wrong checksum: it was changed after recording", COPY)


def cut(sequence: Sequence, out: Path, begin_s: float, end_s: float) -> int:
    """Copies the frames from begin_s to end_s (exclusive) after the first one to a new sequence.
    Packets are copied unchanged.

    Returns the number of frames. Raises UserError if there are none, or if out cannot be created.
    """
    first_ns = sequence.packets[0].t_sensor_ns
    chosen = [
        packet
        for packet in sequence.packets
        if begin_s * 1e9 <= packet.t_sensor_ns - first_ns < end_s * 1e9
    ]
    if not chosen:
        raise UserError(
            f"{sequence.path}: has no frame from {begin_s:g} s to {end_s:g} s",
            f"use times up to {sequence.duration_s:.3f} s, where it ends",
        )
    about = {
        key: value for key, value in sequence.manifest.items() if key in ("versions", "config")
    }
    about["cut_from"] = {
        "name": plain(sequence.path.name, 255),
        "begin_s": begin_s,
        "end_s": min(end_s, sequence.duration_s),
    }
    source = str(sequence.manifest.get("source", ""))
    with new_sequence(out, source, sequence.size_px, sequence.rate_hz, **about) as writer:
        for p in chosen:
            writer.append(
                sequence.data(p.seq), p.codec, p.source_seq, p.epoch, p.t_sensor_ns, p.t_read_ns
            )
        if os.path.lexists(truth := sequence.path / TRUTH):
            with create_private(out / TRUTH) as file:
                file.writelines(_rows(truth, chosen[0].seq, chosen[-1].seq))
    return len(chosen)


def _rows(truth: Path, first: int, last: int) -> Iterator[bytes]:
    """The head of a table, and its rows from first to last. Raises UserError."""
    try:
        for number, row in itertools.islice(lines(truth, EYES_BYTES, REMEDY), last + 2):
            if number == 1 or number >= first + 2:
                yield row
    except OSError as error:
        raise UserError(f"{truth}: cannot be read: {reason(error)}", REMEDY) from None
