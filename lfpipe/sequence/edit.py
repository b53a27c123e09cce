"""New sequences from what is there: a part of one, a video; and a sequence as a plain video with a table.

Whatever goes wrong on the way, what was there before stays as it is, and half of something new does not stay at all.
"""

from __future__ import annotations

import csv
import errno
import io
import itertools
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from lfpipe.errors import UserError, plain
from lfpipe.files.decoding import is_video, opencv_name
from lfpipe.files.safe_files import create_private, lines, open_regular, reason
from lfpipe.files.untrusted import Fields, json_fields
from lfpipe.host.descriptors import path_of
from lfpipe.host.versions import versions
from lfpipe.sequence.folder import EYES, TRUTH, Sequence, begin_manifest, end_manifest, new_folder
from lfpipe.sequence.index import COPY, LINE_BYTES, MAX_PIXELS
from lfpipe.sequence.packets import PacketWriter, decoded, encoded
from lfpipe.sequence.truth import table_of, truth_rows

STAMPS = ("seq", "source_seq", "epoch", "t_sensor_ns", "t_read_ns")
POINTS = ("raw_px", "filtered_px")
MAX_PX = 1e9


def eyes_lines(sequence: Sequence) -> Iterator[dict[str, Any]]:
    """What was tracked while it was recorded; nothing where that was not asked for. A line that was cut off is left out.

    Raises UserError that names a line that is wrong.
    """
    path = sequence.path / EYES
    if not os.path.lexists(path):
        return
    try:
        for number, line in lines(path, 4 * LINE_BYTES, COPY):
            if line.endswith(b"\n"):
                yield check_eyes(json_fields(line, f"{path}:{number}", COPY))
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {reason(error)}", COPY) from None


def check_eyes(fields: Fields) -> dict[str, Any]:
    """A line of eyes.jsonl. Raises UserError where a value is wrong."""
    fields.integer("source_seq", 0, 1 << 62)
    fields.integer("face", 0, 1)
    for name in POINTS:
        points = dict(zip(("left", "right"), fields.items(name, 2), strict=False))
        sides = Fields(points, f"{fields.where}: {name}", fields.remedy)
        for side in ("left", "right"):
            sides.numbers(side, 2, -MAX_PX, MAX_PX)
    return dict(fields.values)


def cut(sequence: Sequence, out: Path, begin_s: float, end_s: float) -> int:
    """Frames from begin_s up to, not including, end_s after the first one, as a sequence of their own; packets stay as they are.

    Returns how many. Raises UserError where there are none, or out cannot be made.
    """
    first_ns = sequence.packets[0].t_sensor_ns
    times = (p.t_sensor_ns - first_ns for p in sequence.packets)
    chosen = [seq for seq, t_ns in enumerate(times) if begin_s * 1e9 <= t_ns < end_s * 1e9]
    if not chosen:
        raise UserError(f"no frame from {begin_s:g} s to {end_s:g} s", f"{sequence.path} lasts {sequence.duration_s:.3f} s")
    about = {key: value for key, value in sequence.manifest.items() if key in ("versions", "config", "cut_from")}
    about["cut_from"] = {"name": plain(sequence.path.name, 255), "begin_s": begin_s, "end_s": min(end_s, sequence.duration_s)}
    source = str(sequence.manifest.get("source", ""))
    with new_folder(out):
        manifest = begin_manifest(out, source, sequence.width_px, sequence.height_px, sequence.rate_hz, **about)
        writer = PacketWriter(out)
        for p in map(sequence.packets.__getitem__, chosen):
            writer.append(sequence.data(p.seq), p.codec, p.source_seq, p.epoch, p.t_sensor_ns, p.t_read_ns)
        writer.close()
        kept = {sequence.packets[seq].source_seq for seq in chosen}
        _cut_eyes(sequence, out / EYES, kept)
        if os.path.lexists(sequence.path / TRUTH):
            _cut_truth(sequence.path / TRUTH, out / TRUTH, chosen[0], len(chosen))
        end_manifest(out, manifest, writer.count, writer.checksums())
    return writer.count


def _cut_eyes(sequence: Sequence, out: Path, kept: set[int]) -> None:
    found = (json.dumps(line).encode() + b"\n" for line in eyes_lines(sequence) if line["source_seq"] in kept)
    for first in found:
        with create_private(out) as file:
            file.writelines(itertools.chain([first], found))


def _cut_truth(path: Path, out: Path, start: int, count: int) -> None:
    rows = truth_rows(path)
    columns = next(rows, [])
    chosen = list(itertools.islice(rows, start, start + count))
    if not chosen:
        return
    stamp = columns.index("t_ns")
    base_ns = int(chosen[0][stamp])
    with create_private(out) as file, io.TextIOWrapper(file, "utf-8", newline="") as text:
        table = csv.writer(text)
        table.writerow(columns)
        for number, row in enumerate(chosen):
            row[stamp] = str(int(row[stamp]) - base_ns)
            if "source_seq" in columns:
                row[columns.index("source_seq")] = str(number)
            table.writerow(row)


def from_video(video: Path, out: Path, truth: Path | None = None) -> int:
    """A video as a sequence at its own rate: the packets of Motion JPEG unchanged, frames of anything else as PNG.

    video: one that was examined (`lfpipe.scene.video.examine`), for a decoder believes what a stream claims. truth: a table as
    of tools/make_sequence.py. Returns the number of frames. Raises UserError where video cannot be read.
    """
    if truth is not None:
        table_of(truth)
    try:
        file = open_regular(video)
    except OSError as error:
        raise UserError(f"{video}: cannot be read: {reason(error)}", "a video file") from None
    with file:
        if not is_video(file.read(12)):  # FFmpeg would look for a picture or a list of files in it, however long that takes
            raise UserError(f"{video}: not a readable video", "MP4, QuickTime, Matroska, WebM or AVI")
        capture = cv2.VideoCapture(path_of(file), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
        try:
            return _taken_over(capture, video, out, truth)
        finally:
            capture.release()


def _taken_over(capture: cv2.VideoCapture, video: Path, out: Path, truth: Path | None) -> int:
    codec = int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little", signed=False) if capture.isOpened() else b""
    jpeg = codec == b"MJPG"
    width_px, height_px = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
    rate_hz = float(capture.get(cv2.CAP_PROP_FPS))
    if not codec or not 0.01 <= rate_hz <= 1000 or width_px < 1 or height_px < 1:
        raise UserError(f"{video}: not a readable video", "give a video with a frame rate (avi, mkv, mp4, ...)")
    if width_px * height_px > MAX_PIXELS:
        raise UserError(f"{video}: its frames have {width_px}x{height_px}, {MAX_PIXELS} px at most are read", "a smaller video")
    if jpeg:
        capture.set(cv2.CAP_PROP_FORMAT, -1)  # packets as they are in the file
    with new_folder(out):
        manifest = begin_manifest(out, f"file:{video.name}", width_px, height_px, rate_hz, versions=versions())
        writer = PacketWriter(out)
        while (taken := capture.read())[0]:
            frame = np.asarray(taken[1], np.uint8)
            if not jpeg and frame.shape != (height_px, width_px, 3):
                what = f"{frame.shape[1]}x{frame.shape[0]} px, the first one {width_px}x{height_px}"
                raise UserError(f"{video}: frame {writer.count} has {what}", "a video of one size")
            kind, data = ("jpeg", frame.tobytes()) if jpeg else encoded(frame, fast=False)
            t_ns = round(writer.count * 1e9 / rate_hz)
            packet = writer.append(data, kind, writer.count, 0, t_ns, t_ns)
            if jpeg:
                decoded(packet, data, width_px, height_px, video)
        writer.close()
        if not writer.count:
            raise UserError(f"{video}: holds no readable frame", "another video, or the same one fetched again")
        if truth is not None:
            with create_private(out / TRUTH) as file, open_regular(truth) as table:
                shutil.copyfileobj(table, file)
        end_manifest(out, manifest, writer.count, writer.checksums())
    return writer.count


def export(sequence: Sequence, video: Path) -> Path:
    """A lossless video (HuffYUV) at the even rate of the sequence; beside it a CSV of exact stamps, and of eyes where known.

    Returns the path of the CSV. Raises UserError where they cannot be written, or are there already.
    """
    if video.suffix.lower() not in (".mkv", ".avi"):
        raise UserError(f"{video}: not .mkv or .avi", "for example walk.mkv; both hold RGB without loss")
    opencv_name(video)
    table = video.with_suffix(".csv")
    made: list[Path] = []
    try:
        for path in (video, table):
            create_private(path).close()
            made.append(path)
        _write_table(sequence, table)
        _write_video(sequence, video)
    except BaseException as error:
        for path in made:
            path.unlink(missing_ok=True)
        if isinstance(error, FileExistsError):
            raise UserError(f"{error.filename}: already exists", "another name; nothing is ever overwritten") from None
        if isinstance(error, OSError):
            remedy = "a directory that you may write to, with room"
            raise UserError(f"{error.filename or video}: {reason(error)}", remedy) from None
        raise
    return table


def _write_table(sequence: Sequence, path: Path) -> None:
    eyes = {line["source_seq"]: line for line in eyes_lines(sequence)}
    points = ("left_x_px", "left_y_px", "right_x_px", "right_y_px")
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        known = ["face", *(f"{kind}_{name}" for kind in ("raw", "filtered") for name in points)] if eyes else []
        rows.writerow([*STAMPS, *known])
        for packet in sequence.packets:
            row: list[Any] = [getattr(packet, name) for name in STAMPS]
            if line := eyes.get(packet.source_seq):
                row += [line["face"], *(v for kind in POINTS for eye in line[kind] for v in eye)]
            rows.writerow(row)


def _write_video(sequence: Sequence, path: Path) -> None:
    """Raises UserError where it cannot be made, OSError where its end is missing: FFmpeg does not say that the disk is full."""
    size = sequence.width_px, sequence.height_px
    where = opencv_name(path.absolute())
    writer = cv2.VideoWriter(where, cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"HFYU"), sequence.measured_hz, size)
    if not writer.isOpened():
        what = f"{size[0]}x{size[1]} at {sequence.measured_hz:g} Hz"
        raise UserError(f"{path}: no video of {what} can be written", "another SEQ")
    for packet in sequence.packets:
        writer.write(sequence.frame(packet.seq))
    writer.release()
    written = cv2.VideoCapture(where, cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])  # frames are counted, not decoded
    count = 0
    while written.grab():
        count += 1
    written.release()
    if count != len(sequence.packets):
        raise OSError(errno.ENOSPC, f"only {count} of {len(sequence.packets)} frames could be written", str(path))
