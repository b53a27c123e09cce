"""Makes sequences from a part of a sequence or from a video, and exports a sequence as a plain video with a table.

If anything fails, existing files are unchanged and unfinished new files are removed.
"""

import csv
import errno
import io
import itertools
import os
import shutil
from pathlib import Path
from typing import IO

import cv2
import numpy as np

from lfpipe.errors import UserError, plain
from lfpipe.files.decoding import is_video, opencv_name
from lfpipe.files.output import PLACE, check_output, finished_output, output_file
from lfpipe.files.safe_files import create_private, open_regular, reason
from lfpipe.files.video_writer import VideoWriter
from lfpipe.host.files import path_of
from lfpipe.host.machine import versions
from lfpipe.sequence.eyes import EYES, TRUTH, eyes_lines, table_of, truth_rows
from lfpipe.sequence.folder import Sequence, begin_manifest, end_manifest, new_folder
from lfpipe.sequence.packets import MAX_PIXELS, PacketWriter, decoded, encoded

STAMPS = ("seq", "source_seq", "epoch", "t_sensor_ns", "t_read_ns")
POINTS = ("left_x_px", "left_y_px", "right_x_px", "right_y_px")


def cut(sequence: Sequence, out: Path, begin_s: float, end_s: float) -> int:
    """Copies the frames from begin_s to end_s (exclusive) after the first one to a new sequence. Packets are copied unchanged.

    Returns the number of frames. Raises UserError if there are none, or if out cannot be created.
    """
    first_ns = sequence.packets[0].t_sensor_ns
    chosen = [p.seq for p in sequence.packets if begin_s * 1e9 <= p.t_sensor_ns - first_ns < end_s * 1e9]
    if not chosen:
        raise UserError(f"no frame from {begin_s:g} s to {end_s:g} s", f"{sequence.path} lasts {sequence.duration_s:.3f} s")
    about = {key: value for key, value in sequence.manifest.items() if key in ("versions", "config")}
    about["cut_from"] = {"name": plain(sequence.path.name, 255), "begin_s": begin_s, "end_s": min(end_s, sequence.duration_s)}
    with new_folder(out):
        manifest = begin_manifest(out, str(sequence.manifest.get("source", "")), *sequence.size_px, sequence.rate_hz, **about)
        writer = PacketWriter(out)
        for p in map(sequence.packets.__getitem__, chosen):
            writer.append(sequence.data(p.seq), p.codec, p.source_seq, p.epoch, p.t_sensor_ns, p.t_read_ns)
        writer.close()
        if os.path.lexists(sequence.path / EYES):
            kept = {sequence.packets[seq].source_seq for seq in chosen}
            with create_private(out / EYES) as file:
                file.writelines(line for source_seq, _, line in eyes_lines(sequence.path) if source_seq in kept)
        if os.path.lexists(sequence.path / TRUTH):
            _cut_truth(sequence.path / TRUTH, out / TRUTH, chosen[0], len(chosen))
        end_manifest(out, manifest, writer.count, writer.checksums())
    return writer.count


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

    video: must have passed `lfpipe.scene.video.Video`, because a decoder trusts the claims of a stream. truth: a table as
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
            return _copied(capture, video, out, truth)
        finally:
            capture.release()


def _copied(capture: cv2.VideoCapture, video: Path, out: Path, truth: Path | None) -> int:
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
        while (read := capture.read())[0]:
            frame = np.asarray(read[1], np.uint8)
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

    Returns the path of the CSV. Raises UserError if they must not or cannot be written, or if there are no frames.
    """
    if video.suffix.lower() not in (".mkv", ".avi"):
        raise UserError(f"{video}: not .mkv or .avi", "use for example walk.mkv; both store RGB without loss")
    if sequence.holds_eyes:
        raise UserError(
            f"{sequence.path}: holds the eyes of the mouse, no frames", "its frames.bin is JSON Lines, one per sample"
        )
    opencv_name(video)
    table = video.with_suffix(".csv")
    for path in (video, table):
        check_output(path, [sequence.path])
    try:
        with finished_output(video) as pictures, output_file(table) as rows:
            _write_table(sequence, rows)
            _write_video(sequence, pictures.beside)
    except OSError as error:
        raise UserError(f"{video}: {reason(error)}", PLACE) from None
    return table


def _write_table(sequence: Sequence, file: IO[bytes]) -> None:
    eyes = {source_seq: record for source_seq, record, _ in eyes_lines(sequence.path)}
    text = io.TextIOWrapper(file, "ascii", newline="", write_through=True)
    table = csv.writer(text)
    table.writerow([*STAMPS, *(["face", *(f"{kind}_{name}" for kind in ("raw", "filtered") for name in POINTS)] if eyes else [])])
    for packet in sequence.packets:
        row = [getattr(packet, name) for name in STAMPS]
        if (record := eyes.get(packet.source_seq)) is not None:
            row += [int(record["face"]), *record["raw_px"].ravel().tolist(), *record["filtered_px"].ravel().tolist()]
        table.writerow(row)
    text.detach()


def _write_video(sequence: Sequence, path: Path) -> None:
    """Raises UserError if it cannot be created, OSError if its end is missing: FFmpeg does not report a full disk."""
    writer = VideoWriter(path, sequence.size_px, sequence.measured_hz)
    for packet in sequence.packets:
        writer.write(sequence.frame(packet.seq))
    writer.release(path)
    reader = cv2.VideoCapture(
        opencv_name(path.absolute()), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1]
    )  # frames are counted, not decoded
    count = 0
    while reader.grab():
        count += 1
    reader.release()
    if count != len(sequence.packets):
        raise OSError(errno.ENOSPC, f"only {count} of {len(sequence.packets)} frames could be written", str(path))
