"""Makes sequences from a part of a sequence or from a video, and exports a sequence as a plain video with a table.

If anything fails, existing files are unchanged and unfinished new files are removed.
"""

import csv
import errno
import io
import itertools
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import cv2
import numpy as np

from lfpipe.errors import UserError, plain
from lfpipe.files.decoding import is_video, opencv_name
from lfpipe.files.output import PLACE, check_output, finished_output, mark_video, output_file
from lfpipe.files.safe_files import create_private, lines, open_regular, reason
from lfpipe.files.untrusted import Fields, json_fields
from lfpipe.host.files import path_of
from lfpipe.host.machine import versions
from lfpipe.sequence.folder import EYES, TRUTH, Sequence, begin_manifest, end_manifest, new_folder
from lfpipe.sequence.index import COPY, LINE_BYTES, MAX_PIXELS
from lfpipe.sequence.packets import PacketWriter, decoded, encoded
from lfpipe.sequence.truth import table_of, truth_rows

STAMPS = ("seq", "source_seq", "epoch", "t_sensor_ns", "t_read_ns")
POINTS = ("raw_px", "filtered_px")
MAX_PX = 1e9


def eyes_lines(sequence: Sequence) -> Iterator[dict[str, Any]]:
    """The eyes that were tracked during recording, if any. A cut-off last line is ignored.

    Raises UserError with the wrong line.
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
    """A line of eyes.jsonl. Raises UserError if a value is wrong."""
    fields.integer("source_seq", 0, 1 << 62)
    fields.integer("face", 0, 1)
    for name in POINTS:
        points = dict(zip(("left", "right"), fields.items(name, 2), strict=False))
        sides = Fields(points, f"{fields.where}: {name}", fields.remedy)
        for side in ("left", "right"):
            sides.numbers(side, 2, -MAX_PX, MAX_PX)
    return dict(fields.values)


def cut(sequence: Sequence, out: Path, begin_s: float, end_s: float) -> int:
    """Copies the frames from begin_s to end_s (exclusive) after the first one to a new sequence. Packets are copied unchanged.

    Returns the number of frames. Raises UserError if there are none, or if out cannot be created.
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
    """Converts a video to a sequence at its own rate: packets of Motion JPEG unchanged, frames of other codecs as PNG.

    video: must have passed `lfpipe.scene.video.examine`, because a decoder trusts the claims of a stream. truth: a table as
    written by tools/make_sequence.py. Returns the number of frames. Raises UserError if video cannot be read.
    """
    if truth is not None:
        table_of(truth)
    try:
        file = open_regular(video)
    except OSError as error:
        raise UserError(f"{video}: cannot be read: {reason(error)}", "name a video file") from None
    with file:
        if not is_video(file.read(12)):  # FFmpeg would probe for other formats, without a time limit
            raise UserError(f"{video}: not a readable video", "use MP4, QuickTime, Matroska, WebM or AVI")
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
        raise UserError(f"{video}: its frames have {width_px}x{height_px}; at most {MAX_PIXELS} px are allowed", "scale it down")
    if jpeg:
        capture.set(cv2.CAP_PROP_FORMAT, -1)  # return packets without decoding
    with new_folder(out):
        manifest = begin_manifest(out, f"file:{video.name}", width_px, height_px, rate_hz, versions=versions())
        writer = PacketWriter(out)
        while (taken := capture.read())[0]:
            frame = np.asarray(taken[1], np.uint8)
            if not jpeg and frame.shape != (height_px, width_px, 3):
                what = f"{frame.shape[1]}x{frame.shape[0]} px, the first frame {width_px}x{height_px}"
                raise UserError(f"{video}: frame {writer.count} has {what}", "use a video with frames of one size")
            kind, data = ("jpeg", frame.tobytes()) if jpeg else encoded(frame, fast=False)
            t_ns = round(writer.count * 1e9 / rate_hz)
            packet = writer.append(data, kind, writer.count, 0, t_ns, t_ns)
            if jpeg:
                decoded(packet, data, width_px, height_px, video)
        writer.close()
        if not writer.count:
            raise UserError(f"{video}: contains no readable frame", "use another video, or download it again")
        if truth is not None:
            with create_private(out / TRUTH) as file, open_regular(truth) as table:
                shutil.copyfileobj(table, file)
        end_manifest(out, manifest, writer.count, writer.checksums())
    return writer.count


def export(sequence: Sequence, video: Path) -> Path:
    """Writes a lossless video (HuffYUV) at a constant rate, and next to it a CSV of exact stamps, and of eyes if known.

    Returns the path of the CSV. Raises UserError if they must not or cannot be written.
    """
    if video.suffix.lower() not in (".mkv", ".avi"):
        raise UserError(f"{video}: not .mkv or .avi", "use for example walk.mkv; both store RGB without loss")
    opencv_name(video)
    table = video.with_suffix(".csv")
    for path in (video, table):
        check_output(path, [sequence.path])
    try:
        with finished_output(video) as pictures, output_file(table) as rows:
            _write_table(sequence, rows)
            _write_video(sequence, pictures.beside)
            mark_video(pictures.beside)
    except OSError as error:
        raise UserError(f"{video}: {reason(error)}", PLACE) from None
    return table


def _write_table(sequence: Sequence, file: IO[bytes]) -> None:
    eyes = {line["source_seq"]: line for line in eyes_lines(sequence)}
    points = ("left_x_px", "left_y_px", "right_x_px", "right_y_px")
    text = io.TextIOWrapper(file, "ascii", newline="", write_through=True)
    rows = csv.writer(text)
    known = ["face", *(f"{kind}_{name}" for kind in ("raw", "filtered") for name in points)] if eyes else []
    rows.writerow([*STAMPS, *known])
    for packet in sequence.packets:
        row: list[Any] = [getattr(packet, name) for name in STAMPS]
        if line := eyes.get(packet.source_seq):
            row += [line["face"], *(v for kind in POINTS for eye in line[kind] for v in eye)]
        rows.writerow(row)
    text.detach()


def _write_video(sequence: Sequence, path: Path) -> None:
    """Raises UserError if it cannot be created, OSError if its end is missing: FFmpeg does not report a full disk."""
    size = sequence.width_px, sequence.height_px
    where = opencv_name(path.absolute())
    writer = cv2.VideoWriter(where, cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"HFYU"), sequence.measured_hz, size)
    if not writer.isOpened():
        what = f"{size[0]}x{size[1]} at {sequence.measured_hz:g} Hz"
        raise UserError(f"{path}: cannot write a video of {what}", "export another SEQ")
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
