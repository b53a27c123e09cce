"""Converts a sequence to an MCAP file and back, byte for byte.

    /camera          foxglove.CompressedImage   the stored packets, JPEG or PNG
    /camera/raw      foxglove.RawImage          packets left uncompressed because of a slow disk
    /camera/stamps   lfpipe.Frame               the line of the index
    /eyes            lfpipe.Eyes                the line of eyes.jsonl
    /latency         lfpipe.Latency             ms from the sensor to the decoded frame, and from there to its eyes
    attachments      manifest.json, truth.csv

The time of a message is wall-clock time, from the manifest's date and the stamps. Messages also contain the stamps themselves.
"""

import base64
import binascii
import datetime
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lfpipe.errors import UserError
from lfpipe.files.mcap_file import BYTES, COPY, RECORD_BYTES, TIME, McapFile, read_records, schema, time_of
from lfpipe.files.safe_files import create_private, lines, read_bytes
from lfpipe.files.untrusted import json_fields
from lfpipe.sequence.edit import check_eyes
from lfpipe.sequence.folder import BESIDE_BYTES, EYES, MANIFEST, MANIFEST_BYTES, TRUTH, Sequence, new_folder, open_sequence
from lfpipe.sequence.index import LINE_BYTES, NUMBERS, Packet, line_of, parse_line
from lfpipe.sequence.packets import PacketWriter

IMAGE, RAW, STAMPS, EYES_TOPIC, LATENCY = "/camera", "/camera/raw", "/camera/stamps", "/eyes", "/latency"
NUMBER, COUNT, TEXT = {"type": "number"}, {"type": "integer"}, {"type": "string"}
POINTS = {"type": "array", "items": {"type": "array", "items": NUMBER}}
SCHEMAS: dict[str, tuple[str, dict[str, Any]]] = {
    IMAGE: ("foxglove.CompressedImage", {"timestamp": TIME, "frame_id": TEXT, "data": BYTES, "format": TEXT}),
    RAW: (
        "foxglove.RawImage",
        {"timestamp": TIME, "frame_id": TEXT, "width": COUNT, "height": COUNT, "encoding": TEXT, "step": COUNT, "data": BYTES},
    ),
    STAMPS: ("lfpipe.Frame", {name: COUNT for name in ("seq", "source_seq", "epoch", "t_sensor_ns", "t_read_ns")}),
    EYES_TOPIC: ("lfpipe.Eyes", {"source_seq": COUNT, "face": COUNT, "raw_px": POINTS, "filtered_px": POINTS}),
    LATENCY: ("lfpipe.Latency", {"capture_ms": NUMBER, "track_ms": NUMBER}),
}


def export_mcap(sequence: Sequence, out: Path) -> int:
    """Writes sequence to the new file out; returns the number of frames. Raises UserError."""
    largest = max(packet.bytes for packet in sequence.packets) * 4 // 3 + 4096
    if largest > RECORD_BYTES:
        what = f"a frame has {largest >> 20} MB; at most {RECORD_BYTES >> 20} MB fit"
        raise UserError(f"{sequence.path}: {what}", "use a sequence of smaller frames")
    base_ns = _wall_ns(sequence) - sequence.packets[0].t_sensor_ns
    eyes = _eyes(sequence)
    following = next(eyes, None)
    with McapFile(out) as file:
        for topic, (title, properties) in SCHEMAS.items():
            file.channel(topic, title, schema(title, **properties))
        file.attach(MANIFEST, "application/json", read_bytes(sequence.path / MANIFEST, MANIFEST_BYTES))
        if os.path.lexists(sequence.path / TRUTH):
            most = min((len(sequence.packets) + 16) * BESIDE_BYTES, RECORD_BYTES - 4096)
            file.attach(TRUTH, "text/csv", read_bytes(sequence.path / TRUTH, most))
        for packet in sequence.packets:
            t_ns = base_ns + packet.t_sensor_ns
            topic, image = _image(sequence, packet, t_ns)
            file.message(topic, t_ns, json.dumps(image).encode())
            file.message(STAMPS, t_ns, line_of(packet).rstrip(b"\n"))
            latency = {"capture_ms": (packet.t_read_ns - packet.t_sensor_ns) / 1e6}
            while following is not None and _stamp(following[0], "t_sensor_ns", packet.t_sensor_ns) <= packet.t_sensor_ns:
                values, line = following
                if values["source_seq"] == packet.source_seq and "t_tracked_ns" in values:
                    latency["track_ms"] = (_stamp(values, "t_tracked_ns", packet.t_read_ns) - packet.t_read_ns) / 1e6
                file.message(EYES_TOPIC, t_ns, line)
                following = next(eyes, None)
            file.message(LATENCY, t_ns, json.dumps(latency).encode())
        while following is not None:  # of frames that were not stored
            file.message(EYES_TOPIC, base_ns + sequence.packets[-1].t_sensor_ns, following[1])
            following = next(eyes, None)
    return len(sequence.packets)


def _stamp(values: dict[str, Any], name: str, otherwise: int) -> int:
    """A time in a line of eyes; its extra fields are unchecked."""
    value = values.get(name)
    return value if type(value) is int else otherwise


def _wall_ns(sequence: Sequence) -> int:
    """Time of the first frame in ns since 1970, with the manifest's resolution of one second."""
    try:
        begun = datetime.datetime.strptime(str(sequence.manifest.get("created", "")), "%Y-%m-%dT%H:%M:%S%z")
        return max(0, int(begun.timestamp())) * 1_000_000_000
    except (ValueError, OverflowError):
        return 0


def _eyes(sequence: Sequence) -> Iterator[tuple[dict[str, Any], bytes]]:
    path = sequence.path / EYES
    if os.path.lexists(path):
        for number, line in lines(path, 4 * LINE_BYTES, COPY):
            if line.endswith(b"\n"):
                yield check_eyes(json_fields(line, f"{path}:{number}", COPY)), line[:-1]


def _image(sequence: Sequence, packet: Packet, t_ns: int) -> tuple[str, dict[str, Any]]:
    image = {"timestamp": time_of(t_ns), "frame_id": "camera", "data": base64.b64encode(sequence.data(packet.seq)).decode()}
    if packet.codec != "raw":
        return IMAGE, image | {"format": packet.codec}
    width = sequence.width_px
    return RAW, image | {"width": width, "height": sequence.height_px, "encoding": "bgr8", "step": 3 * width}


def import_mcap(path: Path, out: Path) -> int:
    """Converts a file of `export_mcap` to the new folder out; returns the number of frames. Raises UserError."""
    manifest = b""
    with new_folder(out):
        writer = PacketWriter(out)
        eyes = None
        try:
            data: bytes | None = None
            for topic, content in read_records(path):
                if topic in (IMAGE, RAW):
                    data = _packet(path, writer.count, content)
                elif topic == STAMPS:
                    _store(path, writer, content, data)
                    data = None
                elif topic == EYES_TOPIC:
                    eyes = eyes or create_private(out / EYES)
                    eyes.write(content + b"\n")
                elif topic == TRUTH:
                    with create_private(out / TRUTH) as file:
                        file.write(content)
                elif topic == MANIFEST:
                    manifest = content
        finally:
            writer.close()
            if eyes is not None:
                eyes.close()
        if not manifest:
            raise UserError(f"{path}: contains no {MANIFEST} of a sequence", "use a file that `lfpipe sequence export` wrote")
        with create_private(out / MANIFEST) as file:
            file.write(manifest)
        try:
            open_sequence(out)
        except UserError as error:
            raise UserError(f"{path}: {error.message.replace(str(out), 'its sequence')}", COPY) from None
    return writer.count


def _packet(path: Path, number: int, content: bytes) -> bytes:
    try:
        return base64.b64decode(json.loads(content)["data"], validate=True)
    except (ValueError, KeyError, TypeError, RecursionError, binascii.Error):
        raise UserError(f"{path}: frame {number}: contains no picture", COPY) from None


def _store(path: Path, writer: PacketWriter, content: bytes, data: bytes | None) -> None:
    """Appends a frame whose picture arrived before its stamps, and verifies the stored packet against them."""
    where = f"{path}: frame {writer.count}"
    numbers, codec = parse_line(content + b"\n", where)
    if data is None:
        raise UserError(f"{where}: has stamps but no picture", COPY)
    said = dict(zip(NUMBERS, numbers, strict=True))
    packet = writer.append(data, codec, said["source_seq"], said["epoch"], said["t_sensor_ns"], said["t_read_ns"])
    if any(getattr(packet, name) != value for name, value in said.items()):
        raise UserError(f"{where}: its picture was changed after recording (checksum)", COPY)
