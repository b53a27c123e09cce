"""A recorded sequence: a folder with manifest.json, the packets of the frames, and further data about them.

manifest.json  format, version, source, size, rate, versions, config; at its end also frames and checksums (sha256)
frames.bin, frames.jsonl   frames, or the eyes of the mouse: see lfpipe.sequence.packets
truth.csv      true eyes of a generated sequence: source_seq,t_ns,left_x_px,left_y_px,right_x_px,right_y_px,...
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
from lfpipe.files.safe_files import PRIVATE_FOLDER, check_links, open_regular, read_bytes, reason, replaced
from lfpipe.files.untrusted import Fields, json_fields
from lfpipe.host.files import exists
from lfpipe.sequence.eyes import TRUTH, eyes_of
from lfpipe.sequence.packets import CHANGED, COPY, INDEX, MAX_PIXELS, PACKETS, Packet, changed, decoded, packet_data, read_index

FORMAT, VERSION = "lfpipe-sequence", 1
MANIFEST = "manifest.json"
FILES = (PACKETS, INDEX, TRUTH)
MANIFEST_BYTES = 1 << 18
TRUTH_BYTES = 4096  # of TRUTH, per frame
MOST_HZ = 100_000.0


def is_sequence(path: Path) -> bool:
    """Whether path is the folder of a sequence, readable or not."""
    return os.path.lexists(path / MANIFEST)


def check_out(path: Path) -> None:
    """Creates the empty folder of a new sequence, private to its owner: frames show a person.

    Raises UserError if that fails, or if path exists.
    """
    try:
        path.mkdir(PRIVATE_FOLDER, parents=True)
    except FileExistsError:
        raise UserError(f"{path}: already exists", "use another name; nothing is overwritten") from None
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: {reason(error)}", "name a folder in a directory that you may write to") from None


@contextlib.contextmanager
def new_folder(path: Path) -> Iterator[None]:
    """`check_out`; removes the folder again if the body fails. Raises UserError if the disk is full."""
    check_out(path)
    try:
        yield
    except BaseException as error:
        shutil.rmtree(path, ignore_errors=True)
        if isinstance(error, OSError):
            raise UserError(f"{path}: {reason(error)}; nothing was written", "use a disk with enough free space") from None
        raise


def begin_manifest(path: Path, source: str, width_px: int, height_px: int, rate_hz: float, **more: Any) -> dict[str, Any]:
    """Writes the manifest of a sequence before recording starts, and returns it. more: versions, config.

    Raises OSError if the disk is full.
    """
    created = time.strftime("%Y-%m-%dT%H:%M:%S%z")
    about = {"source": plain(source, 4096), "width_px": width_px, "height_px": height_px, "rate_hz": rate_hz}
    manifest = {"format": FORMAT, "version": VERSION, "created": created, **about, **more, "complete": False}
    _write_manifest(path, manifest)
    return manifest


def end_manifest(path: Path, manifest: dict[str, Any], frames: int, checksums: dict[str, str]) -> None:
    """Rewrites the manifest after the last frame. checksums: of the files that `PacketWriter` wrote.

    Raises OSError if the disk is full; the old manifest is then kept.
    """
    if exists(path / TRUTH):
        with open_regular(path / TRUTH) as file:
            checksums = {**checksums, TRUTH: hashlib.file_digest(file, "sha256").hexdigest()}
    _write_manifest(path, {**manifest, "complete": True, "frames": frames, "checksums": checksums})


def _write_manifest(path: Path, manifest: dict[str, Any]) -> None:
    with replaced(path / MANIFEST) as file:
        file.write(json.dumps(manifest, indent=1, allow_nan=False).encode() + b"\n")


@attrs.frozen(eq=False)
class Sequence:
    """An opened sequence. complete: its recording ended properly; otherwise it holds the frames up to the cut."""

    path: Path
    manifest: dict[str, Any]
    packets: list[Packet]
    width_px: int
    height_px: int
    rate_hz: float
    complete: bool

    def data(self, index: int) -> bytes:
        """The packet of a frame as it was stored. Raises UserError if it cannot be read, or has changed."""
        packet = self.packets[index]
        data = packet_data(self.path, packet, COPY)
        if changed(packet, data):
            raise UserError(f"{self.path / PACKETS}: frame {index}: {CHANGED}", COPY)
        return data

    def frame(self, index: int) -> NDArray[np.uint8]:
        """A frame, uint8 (height, width, 3) BGR. Raises UserError if its packet is damaged, or holds eyes."""
        return decoded(self.packets[index], packet_data(self.path, self.packets[index], COPY), *self.size_px, self.path)

    def eyes(self, index: int) -> NDArray[np.void]:
        """The record, of dtype EYES, that stands in place of a frame. Raises UserError if its packet is damaged."""
        return eyes_of(self.data(index), f"{self.path}: frame {index}")[1]

    @property
    def codecs(self) -> set[str]:
        """The codecs of its packets."""
        return {packet.codec for packet in self.packets}

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
        return sum(max(0, b.source_seq - a.source_seq - 1) for a, b in itertools.pairwise(self.packets))

    @property
    def measured_hz(self) -> float:
        """Frames per second by the stamps; rate_hz if there is only one frame."""
        return (len(self.packets) - 1) / self.duration_s if len(self.packets) > 1 else self.rate_hz


def open_sequence(path: Path, verify: bool = True) -> Sequence:
    """The sequence at path. verify: also compare every file with its checksum.

    Raises UserError if it is not a sequence, has an unknown version, is damaged, or has no frame.
    """
    check_links(path, (MANIFEST, *FILES))
    fields = _manifest(path)
    width_px, height_px = fields.integer("width_px", 1, MAX_PIXELS), fields.integer("height_px", 1, MAX_PIXELS)
    if width_px * height_px > MAX_PIXELS:
        raise UserError(f"{fields.where}: frames of {width_px}x{height_px}; at most {MAX_PIXELS} px are allowed", COPY)
    rate_hz, complete = fields.number("rate_hz", 1e-3, MOST_HZ), fields.flag("complete")
    packets = read_index(path, complete)
    if not packets:
        raise UserError(f"{path}: contains no whole frame", "record it again")
    sequence = Sequence(path, dict(fields.values), packets, width_px, height_px, rate_hz, complete)
    if sequence.codecs > {"eyes"}:
        raise UserError(f"{path}: holds frames and eyes in their place", COPY)
    if sequence.measured_hz > MOST_HZ:
        raise UserError(f"{path}: {len(packets)} frames in {sequence.duration_s:g} s: no camera is that fast", "record it again")
    if complete:
        _check_files(sequence, fields, verify)
    return sequence


def _manifest(path: Path) -> Fields:
    """The manifest; the types of its optional entries have been checked."""
    where = path / MANIFEST
    try:
        data = read_bytes(where, MANIFEST_BYTES)
    except FileNotFoundError:
        what = f"not a recorded sequence: {MANIFEST} is missing" if os.path.lexists(path) else "no such folder"
        raise UserError(f"{path}: {what}", "`lfpipe record OUT` or `lfpipe sequence import` makes one") from None
    except OSError as error:
        raise UserError(f"{where}: cannot be read: {reason(error)}", COPY) from None
    fields = json_fields(data, str(where), COPY)
    if fields.values.get("format") != FORMAT:
        raise UserError(f"{where}: not the manifest of a recorded sequence", f'its "format" must be "{FORMAT}"')
    if fields.values.get("version") != VERSION:
        version = fields.integer("version", 0, 1 << 30)
        remedy = "read it with the lfpipe that recorded it (versions in its manifest)"
        raise UserError(f"{where}: the sequence has version {version}; this lfpipe reads version {VERSION}", remedy)
    for name in {"source", "created", "made"} & fields.values.keys():
        fields.text(name)
    for name in {"versions", "config", "checksums"} & fields.values.keys():
        fields.table(name)
    if "camera" in fields.values.get("config", ()):
        fields.table("config").table("camera")
    return fields


def _check_files(sequence: Sequence, fields: Fields, verify: bool) -> None:
    """Raises UserError if a complete sequence does not match its manifest."""
    path, end = sequence.path, sequence.packets[-1].offset + sequence.packets[-1].bytes
    frames = fields.integer("frames", 1, 1 << 62)
    if len(sequence.packets) != frames:
        raise UserError(f"{path}: {len(sequence.packets)} frames, but {frames} were recorded", COPY)
    if (size := (path / PACKETS).stat().st_size) != end:
        raise UserError(f"{path / PACKETS}: has {size} bytes, but its index ends at {end}", COPY)
    sums = fields.table("checksums") if "checksums" in fields.values else Fields({}, fields.where, COPY)
    for name in set(FILES) & sums.values.keys():
        try:
            with open_regular(path / name) as file:
                if name == TRUTH and (size := os.fstat(file.fileno()).st_size) > (frames + 16) * TRUTH_BYTES:
                    raise UserError(f"{path / name}: has {size} bytes, too many for {frames} frames", COPY)
                if verify and hashlib.file_digest(file, "sha256").hexdigest() != sums.text(name, 64):
                    raise UserError(f"{path / name}: wrong checksum: it was changed after recording", COPY)
        except OSError as error:
            raise UserError(f"{path / name}: cannot be read: {reason(error)}", COPY) from None
