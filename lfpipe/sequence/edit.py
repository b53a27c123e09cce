"""Makes a sequence from a part of another.

If anything fails, existing files are unchanged and unfinished new files are removed.
"""

import itertools
import os
from collections.abc import Iterator
from pathlib import Path

from lfpipe.errors import UserError, plain
from lfpipe.files.safe_files import create_private, lines, reason
from lfpipe.sequence.eyes import LINE_BYTES, REMEDY, TRUTH
from lfpipe.sequence.folder import Sequence, new_sequence


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
