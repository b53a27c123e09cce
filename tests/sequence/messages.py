"""Refusals of recorded sequences."""

import json
from collections.abc import Callable
from pathlib import Path

from lfpipe.sequence.folder import MANIFEST, cut, open_sequence
from lfpipe.sequence.packets import INDEX, PACKETS, TRUTH, eyes_of, read_truth
from tests.support.hostile_sequences import made_sequence, typed


def damaged(damage: Callable[[Path], object]) -> Callable[[Path], object]:
    """Opens a sequence after a damage to its folder."""

    def cause(here: Path) -> None:
        damage(made_sequence(here / "seq"))
        open_sequence(here / "seq")

    return cause


def file(name: str, change: Callable[[bytes], bytes]) -> Callable[[Path], object]:
    """Replaces the contents of one file."""
    return damaged(lambda seq: (seq / name).write_bytes(change((seq / name).read_bytes())))


def line(**changes: object) -> Callable[[Path], object]:
    """Damage to line 3 of the index: a number is a step from what was there."""

    def change(data: bytes) -> bytes:
        lines = data.splitlines(keepends=True)
        old = json.loads(lines[2])
        steps = {
            name: old[name] + step if isinstance(step, int) else step
            for name, step in changes.items()
        }
        return b"".join([*lines[:2], json.dumps(old | steps).encode() + b"\n", *lines[3:]])

    return file(INDEX, change)


def manifest(**changes: object) -> Callable[[Path], object]:
    """Other values in the manifest."""
    return file(MANIFEST, lambda data: json.dumps(json.loads(data) | changes).encode())


EYES = b'{"source_seq": 1, "raw_px": [[1, 2], [1, 2]], "filtered_px": [[1, 2], [1, 2]], "face": 2}'
TABLE = "t_ns, left_x_px, left_y_px, right_x_px, right_y_px"
COPY = "copy the whole folder again"
POINTS = "left_x_px,left_y_px,right_x_px,right_y_px"
RECORD = "`lfpipe record OUT` or `lfpipe sequence import`"
MESSAGES: dict[str, tuple[Callable[[Path], object], str]] = {
    "index cut off": (
        file(INDEX, lambda data: data[:-5]),
        f"/here/seq: 5 frames, but 6 were recorded … {COPY}",
    ),
    "index shorter": (
        file(INDEX, lambda data: b"".join(data.splitlines(keepends=True)[:-1])),
        f"/here/seq: 5 frames, but 6 were recorded … {COPY}",
    ),
    "a line is missing": (
        file(INDEX, lambda data: b"".join(data.splitlines(keepends=True)[1:])),
        f"/here/seq: in place of frame 0 at byte 0, there is frame 1 at byte … {COPY}",
    ),
    "a stamp goes back": (
        line(t_sensor_ns=-(10**9)),
        (
            "/here/seq: frame 2: its time stamp 66666666 ns is not after 1033333333 ns … record it"
            " again"
        ),
    ),
    "a gap": (
        line(offset=1),
        f"/here/seq: in place of frame 2 at byte … there is frame 2 at byte 1 … {COPY}",
    ),
    "codec": (
        line(codec="gif"),
        f"/here/seq/frames.jsonl:3: codec is 'gif', expected one of jpeg, png, raw, eyes … {COPY}",
    ),
    "checksum of a packet": (
        line(crc32="x"),
        f"/here/seq/frames.jsonl:3: crc32 is 'x', expected a whole number … {COPY}",
    ),
    "frames and eyes": (line(codec="eyes"), f"/here/seq: mixes frames with eyes … {COPY}"),
    "a bit": (
        file(PACKETS, lambda data: data[:99] + bytes([data[99] ^ 1]) + data[100:]),
        "/here/seq: frame 0: its bytes were changed … `lfpipe sequence cut`",
    ),
    "another time": (line(t_read_ns=1), f"/here/seq/frames.jsonl: wrong checksum … {COPY}"),
    "no packets": (
        damaged(lambda seq: (seq / PACKETS).unlink()),
        f"/here/seq/frames.bin: No such file or directory … {COPY}",
    ),
    "no truth": (
        damaged(lambda seq: (seq / TRUTH).unlink()),
        "/here/seq/truth.csv: cannot be read: No such file … permissions",
    ),
    "no manifest": (
        damaged(lambda seq: (seq / MANIFEST).unlink()),
        f"/here/seq: not a recorded … manifest.json … {RECORD}",
    ),
    "a video": (
        damaged(lambda seq: [seq.rename(seq.with_name("away")), seq.write_bytes(b"RIFF")]),
        f"/here/seq: not a recorded … manifest.json … {RECORD}",
    ),
    "another version": (
        manifest(version=2),
        "/here/seq/manifest.json: … version 2; this lfpipe reads version 1 … recorded it",
    ),
    "another format": (
        manifest(format="zip"),
        '/here/seq/manifest.json: is not the manifest … "lfpipe-sequence"',
    ),
    "nowhere": (
        lambda here: open_sequence(here / "nowhere"),
        f"/here/nowhere: no such folder … {RECORD}",
    ),
    "no table": (
        lambda here: (here / TRUTH).write_text("t_ns,left_x_px\n0,1\n") and read_truth(here),
        f"/here/truth.csv: not a table of true eyes: column left_y_px … {TABLE}",
    ),
    "truth goes back": (
        lambda here: (
            (here / TRUTH).write_text(f"t_ns,{POINTS}\n5,1,1,1,1\n5,1,1,1,1") and read_truth(here)
        ),
        f"/here/truth.csv:3: times must rise: t_ns is 5, after 5 … {TABLE}",
    ),
    "cut of nothing": (
        lambda here: cut(open_sequence(made_sequence(here / "seq")), here / "part", 9, 10),
        "/here/seq: has no frame from 9 s to 10 s … use times up to 0.167 s",
    ),
    "cut to what exists": (
        lambda here: cut(open_sequence(made_sequence(here / "seq")), here / "seq", 0, 1),
        "/here/seq: already exists … another name",
    ),
    "import of text": (
        lambda here: (
            (here / "v.avi").write_text("no video")
            and typed("import", here / "v.avi", here / "seq")
        ),
        "/here/v.avi: not a readable video … QuickTime … another program",
    ),
    "eyes": (
        lambda here: eyes_of(EYES, "walk: frame 5"),
        f"walk: frame 5: face is 2, expected a number up to 1 … {COPY}",
    ),
}
