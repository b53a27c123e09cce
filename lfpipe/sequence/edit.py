"""New sequences from what is there: a part of one, a video; and a sequence as a plain video with a table."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from lfpipe.errors import UserError
from lfpipe.sequence.folder import EYES, TRUTH, Sequence, begin_manifest, check_out, end_manifest
from lfpipe.sequence.packets import PacketWriter, encoded
from lfpipe.versions import versions

STAMPS = ("seq", "source_seq", "epoch", "t_sensor_ns", "t_read_ns")


def eyes_lines(sequence: Sequence) -> list[dict[str, Any]]:
    """What was tracked while it was recorded; empty where that was not asked for. A line that was cut off is left out."""
    path = sequence.path / EYES
    text = path.read_text() if path.exists() else ""
    return [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()]


def cut(sequence: Sequence, out: Path, begin_s: float, end_s: float) -> int:
    """Frames from begin_s up to, not including, end_s after the first one, as a sequence of their own; packets stay as they are.

    Returns how many. Raises UserError where there are none, or out cannot be made.
    """
    first_ns = sequence.packets[0].t_sensor_ns
    chosen = [p for p in sequence.packets if begin_s * 1e9 <= p.t_sensor_ns - first_ns < end_s * 1e9]
    if not chosen:
        raise UserError(f"no frame from {begin_s:g} s to {end_s:g} s", f"{sequence.path} lasts {sequence.duration_s:.3f} s")
    check_out(out)
    about = {key: value for key, value in sequence.manifest.items() if key in ("versions", "config", "cut_from")}
    about["cut_from"] = {"name": sequence.path.name, "begin_s": begin_s, "end_s": end_s}
    source = str(sequence.manifest.get("source", ""))
    manifest = begin_manifest(out, source, sequence.width_px, sequence.height_px, sequence.rate_hz, **about)
    writer = PacketWriter(out)
    for p in chosen:
        writer.append(sequence.data(p.seq), p.codec, p.source_seq, p.epoch, p.t_sensor_ns, p.t_read_ns)
    writer.close()
    kept = {p.source_seq for p in chosen}
    eyes = [line for line in eyes_lines(sequence) if line["source_seq"] in kept]
    if eyes:
        (out / EYES).write_text("".join(json.dumps(line) + "\n" for line in eyes))
    if (sequence.path / TRUTH).exists():
        _cut_truth(sequence.path / TRUTH, out / TRUTH, chosen[0].seq, len(chosen))
    end_manifest(out, manifest, writer.count, writer.checksums())
    return writer.count


def _cut_truth(path: Path, out: Path, start: int, count: int) -> None:
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))[start : start + count]
    base_ns = int(rows[0]["t_ns"])
    with out.open("w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        for number, row in enumerate(rows):
            table.writerow({**row, "source_seq": number, "t_ns": int(row["t_ns"]) - base_ns})


def from_video(video: Path, out: Path, truth: Path | None = None) -> int:
    """A video as a sequence at its own rate: the packets of Motion JPEG unchanged, frames of anything else as PNG.

    truth: a table as of tools/make_sequence.py. Returns the number of frames. Raises UserError where video cannot be read.
    """
    capture = cv2.VideoCapture(str(video), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
    codec = int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little", signed=False) if capture.isOpened() else b""
    jpeg = codec == b"MJPG"
    size = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
    rate_hz = float(capture.get(cv2.CAP_PROP_FPS))
    if not codec or not 0.01 <= rate_hz <= 1000 or not all(size):
        raise UserError(f"{video}: no video that can be read", "give a video with a frame rate (avi, mkv, mp4, ...)")
    if truth is not None and not truth.is_file():
        raise UserError(f"{truth}: no such file", "a table as tools/make_sequence.py writes it")
    check_out(out)
    manifest = begin_manifest(out, f"file:{video.name}", *size, rate_hz, versions=versions())
    if jpeg:
        capture.set(cv2.CAP_PROP_FORMAT, -1)  # packets as they are in the file
    writer = PacketWriter(out)
    while (taken := capture.read())[0]:
        frame = np.asarray(taken[1], np.uint8)
        kind, data = ("jpeg", frame.tobytes()) if jpeg else encoded(frame, fast=False)
        t_ns = round(writer.count * 1e9 / rate_hz)
        writer.append(data, kind, writer.count, 0, t_ns, t_ns)
    capture.release()
    writer.close()
    if truth is not None:
        shutil.copyfile(truth, out / TRUTH)
    end_manifest(out, manifest, writer.count, writer.checksums())
    return writer.count


def export(sequence: Sequence, video: Path) -> Path:
    """A lossless video (HuffYUV) at the even rate of the sequence; beside it a CSV of exact stamps, and of eyes where known.

    Returns the path of the CSV. Raises UserError where they cannot be written.
    """
    if video.suffix.lower() not in (".mkv", ".avi"):
        raise UserError(f"{video}: not .mkv or .avi", "for example walk.mkv; both hold RGB without loss")
    table = video.with_suffix(".csv")
    eyes = {line["source_seq"]: line for line in eyes_lines(sequence)}
    points = ("left_x_px", "left_y_px", "right_x_px", "right_y_px")
    try:
        with table.open("w", newline="") as file:
            rows = csv.writer(file)
            known = ["face", *(f"{kind}_{name}" for kind in ("raw", "filtered") for name in points)] if eyes else []
            rows.writerow([*STAMPS, *known])
            for packet in sequence.packets:
                row: list[Any] = [getattr(packet, name) for name in STAMPS]
                if line := eyes.get(packet.source_seq):
                    row += [line["face"], *(v for kind in ("raw_px", "filtered_px") for eye in line[kind] for v in eye)]
                rows.writerow(row)
    except OSError as error:
        raise UserError(f"{table}: {error.strerror}", "a directory that you may write to") from None
    size = sequence.width_px, sequence.height_px
    writer = cv2.VideoWriter(str(video), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"HFYU"), sequence.measured_hz, size)
    if not writer.isOpened():
        raise UserError(f"{video}: the video cannot be written", "a directory that you may write to")
    for packet in sequence.packets:
        writer.write(sequence.frame(packet.seq))
    writer.release()
    return table
