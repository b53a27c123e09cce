"""A recorded sequence: a folder with manifest.json, the packets of the frames, and what was known beside them.

manifest.json  format, version, source, size, rate, versions, config; at its end also frames and checksums (sha256)
frames.bin, frames.jsonl   see lfpipe.sequence.packets
eyes.jsonl     what was tracked while recording, where that was asked for
truth.csv      where the eyes really are, of a made sequence: source_seq,t_ns,left_x_px,left_y_px,right_x_px,right_y_px,...
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.sequence.packets import INDEX, PACKETS, Packet, decoded, read_index

FORMAT, VERSION = "lfpipe-sequence", 1
MANIFEST, EYES, TRUTH = "manifest.json", "eyes.jsonl", "truth.csv"
FILES = (PACKETS, INDEX, EYES, TRUTH)


def is_sequence(path: Path) -> bool:
    """Whether path is the folder of a sequence."""
    return (path / MANIFEST).is_file()


def checksum(path: Path) -> str:
    """sha256 of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_out(path: Path) -> None:
    """Makes the empty folder of a new sequence. Raises UserError where that cannot be, or something is there."""
    try:
        path.mkdir(parents=True)
    except FileExistsError:
        raise UserError(f"{path}: is there already", "another name; nothing is ever overwritten") from None
    except OSError as error:
        raise UserError(f"{path}: {error.strerror}", "a folder in a directory that you may write to") from None


def begin_manifest(path: Path, source: str, width_px: int, height_px: int, rate_hz: float, **more: Any) -> dict[str, Any]:
    """Writes the manifest of a sequence that is still to be recorded, and returns it. more: versions, config.

    Raises OSError where there is no room.
    """
    created = time.strftime("%Y-%m-%dT%H:%M:%S%z")
    about = {"source": source, "width_px": width_px, "height_px": height_px, "rate_hz": rate_hz}
    manifest = {"format": FORMAT, "version": VERSION, "created": created, **about, **more, "complete": False}
    _write_manifest(path, manifest)
    return manifest


def end_manifest(path: Path, manifest: dict[str, Any], frames: int, checksums: dict[str, str]) -> None:
    """Writes the manifest anew when all frames are there. checksums: of the files that `PacketWriter` wrote.

    Raises OSError where the disk is full; the old manifest then stands.
    """
    sums = checksums | {name: checksum(path / name) for name in FILES if name not in checksums and (path / name).exists()}
    _write_manifest(path, {**manifest, "complete": True, "frames": frames, "checksums": sums})


def _write_manifest(path: Path, manifest: dict[str, Any]) -> None:
    new = path / (MANIFEST + ".new")
    try:
        new.write_text(json.dumps(manifest, indent=1) + "\n")
        new.replace(path / MANIFEST)
    except OSError:
        new.unlink(missing_ok=True)
        raise


@attrs.frozen(eq=False)
class Sequence:
    """An opened sequence. complete: it was ended in order; else it holds what was whole when it was cut off."""

    path: Path
    manifest: dict[str, Any]
    packets: list[Packet]
    width_px: int
    height_px: int
    rate_hz: float
    complete: bool

    def data(self, index: int) -> bytes:
        """The packet of a frame as it is stored."""
        packet = self.packets[index]
        fd = os.open(self.path / PACKETS, os.O_RDONLY)
        try:
            return os.pread(fd, packet.bytes, packet.offset)
        finally:
            os.close(fd)

    def frame(self, index: int) -> NDArray[np.uint8]:
        """A frame, uint8 (height, width, 3) BGR. Raises UserError where its packet is damaged."""
        return decoded(self.packets[index], self.data(index), self.width_px, self.height_px)

    @property
    def duration_s(self) -> float:
        """From the first frame's stamp to the last one's."""
        return (self.packets[-1].t_sensor_ns - self.packets[0].t_sensor_ns) / 1e9

    @property
    def lost(self) -> int:
        """Frames that the camera counted and that were not stored."""
        return sum(max(0, b.source_seq - a.source_seq - 1) for a, b in zip(self.packets, self.packets[1:], strict=False))

    @property
    def measured_hz(self) -> float:
        """Frames per second by the stamps; rate_hz where there is one frame only."""
        return (len(self.packets) - 1) / self.duration_s if len(self.packets) > 1 else self.rate_hz


def open_sequence(path: Path, verify: bool = True) -> Sequence:
    """The sequence at path. verify: also compare every file with its checksum.

    Raises UserError where it is no sequence, of an unknown version, damaged, or without a frame.
    """
    try:
        manifest = json.loads((path / MANIFEST).read_text())
    except FileNotFoundError:
        what = "no such folder" if not path.exists() else f"no recorded sequence: {MANIFEST} is missing"
        raise UserError(f"{path}: {what}", "`lfpipe record OUT` makes one, `lfpipe sequence import` from a video") from None
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else "not JSON"
        raise UserError(f"{path / MANIFEST}: cannot be read: {why}", "copy it again from where it was recorded") from None
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise UserError(f"{path / MANIFEST}: not of a recorded sequence", f'its "format" must be "{FORMAT}"')
    if manifest.get("version") != VERSION:
        raise UserError(
            f"{path}: a sequence of version {manifest.get('version')!r}, this lfpipe reads version {VERSION}",
            "read it with the lfpipe that recorded it (versions in its manifest)",
        )
    try:
        size = int(manifest["width_px"]), int(manifest["height_px"])
        rate_hz, complete = float(manifest["rate_hz"]), bool(manifest["complete"])
    except (KeyError, TypeError, ValueError):
        raise UserError(f"{path / MANIFEST}: width_px, height_px, rate_hz or complete is missing", "copy it again") from None
    packets = read_index(path, complete)
    if not packets:
        raise UserError(f"{path}: holds no whole frame", "record it anew")
    if complete and len(packets) != manifest.get("frames"):
        raise UserError(f"{path}: {len(packets)} frames, {manifest.get('frames')} were recorded", "copy it again")
    if complete and verify:
        for name, wanted in dict(manifest.get("checksums", {})).items():
            if not (path / name).is_file():
                raise UserError(f"{path / name} is missing", "copy the whole folder again")
            if checksum(path / name) != wanted:
                raise UserError(f"{path / name}: wrong checksum: it was changed after it was recorded", "copy it again")
    return Sequence(path, manifest, packets, *size, rate_hz, complete)
