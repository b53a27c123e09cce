"""Makes a sequence from a part of another, and exports a sequence as a plain video with a table.

If anything fails, existing files are unchanged and unfinished new files are removed.
"""

import errno
import itertools
import os
from collections.abc import Iterator
from pathlib import Path

import cv2

from lfpipe.errors import UserError, plain
from lfpipe.files.decoding import opencv_name
from lfpipe.files.output import PLACE, TABLE, check_output
from lfpipe.files.safe_files import create_private, lines, reason, replaced
from lfpipe.files.video_writer import VideoWriter
from lfpipe.sequence.eyes import LINE_BYTES, REMEDY, TRUTH
from lfpipe.sequence.folder import Sequence, new_sequence

STAMPS = ("seq", "source_seq", "epoch", "t_sensor_ns", "t_read_ns")


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
        for number, row in itertools.islice(lines(truth, LINE_BYTES, REMEDY), last + 2):
            if number == 1 or number >= first + 2:
                yield row
    except OSError as error:
        raise UserError(f"{truth}: cannot be read: {reason(error)}", REMEDY) from None


def export(sequence: Sequence, video: Path) -> Path:
    """Writes a lossless video (HuffYUV) at a constant rate, and next to it a CSV of exact stamps.

    Returns the path of the CSV. Raises UserError if they must not or cannot be written, or if there
    are no frames.
    """
    if video.suffix.lower() != ".mkv":
        raise UserError(f"{video}: not .mkv", "use for example walk.mkv, which is lossless")
    opencv_name(video)
    table = video.with_suffix(".csv")
    check_output(video, [sequence.path])
    check_output(table, [sequence.path], writes=TABLE)
    try:
        with replaced(video) as pictures, replaced(table) as rows:
            rows.write((",".join(STAMPS) + "\r\n").encode())
            for packet in sequence.packets:
                rows.write(b"%d,%d,%d,%d,%d\r\n" % tuple(getattr(packet, name) for name in STAMPS))
            _write_video(sequence, Path(pictures.name))
    except OSError as error:
        raise UserError(f"{video}: {reason(error)}", PLACE) from None
    return table


def _write_video(sequence: Sequence, path: Path) -> None:
    """Raises UserError if it cannot be created, OSError if its end is missing: FFmpeg does not
    report a full disk.
    """
    writer = VideoWriter(path, sequence.size_px, sequence.measured_hz)
    for packet in sequence.packets:
        writer.write(sequence.frame(packet.seq))
    writer.release(path)
    packets = [cv2.CAP_PROP_FORMAT, -1]  # counted, not decoded
    reader = cv2.VideoCapture(opencv_name(path.absolute()), cv2.CAP_FFMPEG, packets)
    count = 0
    while reader.grab():
        count += 1
    reader.release()
    if count != len(sequence.packets):
        raise OSError(
            errno.ENOSPC,
            f"only {count} of {len(sequence.packets)} frames could be written",
            str(path),
        )
