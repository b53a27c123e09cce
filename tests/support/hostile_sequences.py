"""Damaged recorded sequences, generated from a seed: in JSON, table or pictures, or with non-files
in place of files.

Half of the damage is signed: checksums and lengths are adjusted to it, as by an attacker, so that
it gets further.
"""

import hashlib
import json
import random
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from lfpipe.cli import cli
from lfpipe.sequence.folder import MANIFEST, SequenceWriter
from lfpipe.sequence.packets import INDEX, PACKETS, TRUTH, encoded
from tests.support import hostile_files as hostile

SIZE = (64, 48)
FRAMES = 6
STEP_NS = 33_333_333


def picture(seq: int) -> np.ndarray:
    """Of a frame, uint8 (48, 64, 3)."""
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]]
    return np.stack([x * 3 + seq, y * 5, x + y + 9 * seq], axis=2).astype(np.uint8)


def made_sequence(out: Path) -> Path:
    """An intact sequence of six frames in all three codecs, with truth."""
    out.mkdir(parents=True)
    config = {
        "camera": {"width_px": SIZE[0], "height_px": SIZE[1], "focal_px": 60.0, "fov_deg": 56.0}
    }
    writer = SequenceWriter(out, "demo", SIZE, 30.0, versions={"lfpipe": "0.1.0"}, config=config)
    truth = ["source_seq,t_ns,left_x_px,left_y_px,right_x_px,right_y_px,visible"]
    for seq in range(FRAMES):
        codec = ("jpeg", "raw", "png")[seq % 3]
        data = picture(seq).tobytes() if codec == "raw" else encoded(picture(seq), codec)
        t_ns = seq * STEP_NS
        writer.append(data, codec, seq, 0, 10**9 + t_ns, 10**9 + t_ns + 5)
        points = [[40.0 + seq, 20.0], [24.0 + seq, 20.5]]
        truth.append(f"{seq},{t_ns},{points[0][0]},{points[0][1]},{points[1][0]},{points[1][1]},1")
    (out / TRUTH).write_text("\n".join(truth) + "\n")
    writer.complete()
    return out


def packets(folder: Path) -> list[tuple[dict[str, Any], bytes]]:
    """The lines of a whole index with their packets."""
    data = (folder / PACKETS).read_bytes()
    lines = [json.loads(line) for line in (folder / INDEX).read_text().splitlines()]
    return [(line, data[line["offset"] : line["offset"] + line["bytes"]]) for line in lines]


def put_packets(folder: Path, found: list[tuple[dict[str, Any], bytes]]) -> None:
    """Writes packets and an index that agrees with them."""
    offset = 0
    lines = []
    parts = []
    for line, data in found:
        lines.append({**line, "offset": offset, "bytes": len(data), "crc32": zlib.crc32(data)})
        parts.append(data)
        offset += len(data)
    (folder / PACKETS).write_bytes(b"".join(parts))
    (folder / INDEX).write_text("".join(json.dumps(line) + "\n" for line in lines))


def sign(folder: Path) -> None:
    """Makes the checksums of the manifest agree with the files, as far as there are both."""
    files = {name: folder / name for name in (MANIFEST, INDEX, TRUTH)}
    data = {
        name: path.read_bytes()
        for name, path in files.items()
        if path.is_file() and path.stat().st_size < 1 << 24
    }
    try:
        manifest = json.loads(data.pop(MANIFEST))
        manifest["checksums"] |= {
            name: hashlib.sha256(content).hexdigest() for name, content in data.items()
        }
        files[MANIFEST].write_text(json.dumps(manifest))
    except (ValueError, TypeError, KeyError, RecursionError):  # damaged already
        pass


def hostile_picture(rng: random.Random, data: bytes) -> bytes:
    """An encoded picture that claims too much, is another one's size, or is damaged."""
    jpeg = cv2.imencode(".jpg", picture(0))[1].tobytes()
    sizes = (
        (20_000, 20_000),
        (65_535, 65_535),
        (1, 1),
        (0, 0),
        (SIZE[0], SIZE[1] * 400),
        (SIZE[1], SIZE[0]),
        (63, 48),
    )
    claimed = rng.choice(sizes)
    bombs = hostile.text_bomb(100_000_000) * rng.choice((1, 3))
    other = cv2.imencode(rng.choice((".bmp", ".webp", ".tiff", ".ppm")), picture(0))[1]
    kinds = (
        hostile.jpeg_claiming(jpeg, *claimed),
        hostile.png_of(*claimed, body=zlib.compress(b"\0" * 1000)),
        hostile.png_of(*SIZE, before=bombs),
        hostile.png_of(*SIZE, depth=16),
        other.tobytes(),
        hostile.damaged_bytes(rng, data),
        hostile.damaged_bytes(rng, jpeg),
    )
    return rng.choice(kinds)


def damage(rng: random.Random, *paths: Path) -> str:
    """Damages one of these files by its kind, or the pictures within, or puts no file in its place;
    returns which.
    """
    path = rng.choice(paths)
    if rng.random() < 0.12:
        kind = rng.choice(sorted(hostile.NO_FILES))
        hostile.NO_FILES[kind](path)
        return f"{kind} as {path.name}"
    data = path.read_bytes()
    if path.suffix in (".json", ".jsonl", ".csv"):
        path.write_bytes(hostile.damaged_text(rng, data))
    elif rng.random() < 0.3:
        path.write_bytes(hostile.damaged_bytes(rng, data))
    else:
        found = packets(path.parent)
        for at in range(rng.randrange(3) + 1):
            found[at] = (found[at][0], hostile_picture(rng, found[at][1]))
        put_packets(path.parent, found)
    return path.name


def typed(*words: str | Path) -> Any:
    """The exit code of a command as a person types it, in this process; its UserError is raised."""
    return cli.main(["sequence", *map(str, words)], standalone_mode=False)
