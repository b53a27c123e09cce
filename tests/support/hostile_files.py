"""Untrusted files, generated from a seed: wrong values, damaged bytes, and things that are no files
at all.

Plain functions of `random.Random` and of paths, so that tests and attack harnesses share them.
"""

import functools
import os
import random
import re
import socket
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from PIL import Image

PEAK_MB = 300.0  # of any refusal


def at(name: str, make: Callable[[Path], object]) -> Callable[[Path], object]:
    """What does that to a file of a folder."""
    return lambda folder: make(folder / name)


def deep(levels: int, as_list: bool = True) -> Any:
    """A value that deep."""
    value: Any = 1
    for _ in range(levels):
        value = [value] if as_list else {"k": value}
    return value


# Values of every type, and the edges of each; as Python objects.
VALUES: tuple[Any, ...] = (
    None,
    True,
    False,
    0,
    1,
    -1,
    255,
    2**31,
    2**53,
    2**63,
    2**64,
    -(2**63),
    10**19,
    10**400,
    -(10**400),
    0.0,
    -0.0,
    0.5,
    -1.5,
    1e-320,
    1e308,
    -1e308,
    float("nan"),
    float("inf"),
    float("-inf"),
    "",
    "x",
    "nan",
    "-1",
    "1e999",
    "../../etc/passwd",
    "/dev/zero",
    "a\0b",
    "\x1b[2J",
    "\ud800",
    "\u202e",
    "\U0001f600",
    "y" * 70_000,
    [],
    [1],
    [None],
    [[1.0, 2.0], [3.0, 4.0]],
    ["left", "right"],
    {},
    {"": 1},
    {"left": [1, 2]},
    {"k": {"k": {}}},
)

# Texts in place of a value of JSON or of a table that are invalid or strange.
TEXTS = (
    "NaN",
    "-Infinity",
    "1e400",
    "-1e308",
    "9" * 5000,
    "-" + "9" * 400,
    "1." + "9" * 5000,
    str(2**63),
    "[" * 100_000,
    '{"k":' * 5000 + "1" + "}" * 5000,
    '"\\ud800"',
    '"\x00"',
    '"' + "y" * 200_000,
    "0x10",
    "1_0",
    "tru",
    "",
    ",",
    "}",
    "7,",
    "1 2",
    "\ufeff1",
)

# The same for TOML.
TOML_TEXTS = (
    "nan",
    "-inf",
    "1e400",
    "9" * 5000,
    "0x" + "f" * 5000,
    "[" * 5000,
    "{k=" * 2000,
    "[" * 5000 + "]" * 5000,
    "2024-01-01",
    "12:30:00",
    "1979-05-27T07:32:00Z",
    "'\x1b'",
    '"\\u0000"',
    '"\\ud800"',
    '"\\U0001f600"',
    "{}",
    "[]",
    "{a={b={c=1}}}",
    "'''x\ny'''",
    "1\ny=2",
    "",
    "=",
    "true",
    "'" + "x" * 70_000 + "'",
    "-0.0",
    "1_0",
    "0o17",
    "[1, 'a', {}]",
)


def damaged_text(rng: random.Random, data: bytes) -> bytes:
    """data with a word replaced by one of TEXTS, or damaged bytes."""
    words = [match.span() for match in re.finditer(rb'"[^"\n]*"|[\w.+-]+', data)]
    if not words or rng.random() < 0.3:
        return damaged_bytes(rng, data)
    start, end = rng.choice(words)
    return data[:start] + rng.choice(TEXTS).encode() + data[end:]


def damaged_bytes(rng: random.Random, data: bytes) -> bytes:
    """data truncated, with flipped bits, or with parts removed, duplicated, overwritten or
    inserted; or something else.
    """
    at = rng.randrange(len(data) + 1)
    end = min(len(data), at + rng.choice((1, 2, 4, 16, 300, 5000)))
    fill = rng.choice((b"\0", b"\xff", b"\n", b"\xed\xa0\x80", b'"', b"9"))
    flipped = bytearray(data)
    for _ in range(rng.choice((1, 1, 3, 30)) if data else 0):
        flipped[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    others = (b"", b"\0" * 100, b"\xff\xfe", b"\n" * 1000, rng.randbytes(500))
    return rng.choice(
        (
            data[:at],
            bytes(flipped),
            data[:at] + data[end:],
            data[:end] + data[at:],
            data[:at] + fill * (end - at) + data[end:],
            data[:at] + rng.randbytes(end - at) + data[at:],
            rng.choice((*others, b"\xef\xbb\xbf" + data)),
        )
    )


def _no_file(make: Callable[[Path], object]) -> Callable[[Path], None]:
    def put(path: Path) -> None:
        if path.is_symlink() or path.exists():
            path.unlink()
        make(path)

    return put


def _sparse(size: int) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        with path.open("wb") as file:
            file.truncate(size)

    return _no_file(make)


def _bind(path: Path) -> None:
    here = Path.cwd()
    os.chdir(path.parent)  # a socket's path is short
    try:
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(path.name)
    finally:
        os.chdir(here)


def _loop(path: Path) -> None:
    path.with_name(path.name + ".turn").unlink(missing_ok=True)
    path.with_name(path.name + ".turn").symlink_to(path.name)
    path.symlink_to(path.name + ".turn")


NO_FILES: dict[str, Callable[[Path], None]] = {  # replacements of an expected file
    "fifo": _no_file(os.mkfifo),
    "directory": _no_file(lambda path: path.mkdir()),
    "socket": _no_file(_bind),
    "endless device": _no_file(lambda path: path.symlink_to("/dev/zero")),
    "terminal": _no_file(lambda path: path.symlink_to("/dev/ptmx")),
    "link to itself": _no_file(_loop),
    "dangling link": _no_file(lambda path: path.symlink_to("/nowhere/at/all")),
    "2 TB": _sparse(2 << 40),
    "4 GB": _sparse(4 << 30),
    "empty": _sparse(0),
}


def png_chunk(kind: bytes, data: bytes) -> bytes:
    """A chunk of a PNG with its length and checksum."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


@functools.cache
def png_of(
    width_px: int, height_px: int, body: bytes | None = None, before: bytes = b"", depth: int = 8
) -> bytes:
    """A PNG that claims a size.

    body: its compressed rows, zeros of that size where None. before: chunks ahead of them.
    """
    if body is None:
        squeeze = zlib.compressobj(1)
        row = b"\0" * (1 + width_px * 3 * depth // 8)
        left = height_px
        parts = []
        while left > 0:
            parts.append(squeeze.compress(row * min(64, left)))
            left -= 64
        body = b"".join(parts) + squeeze.flush()
    header = struct.pack(">IIBBBBB", width_px, height_px, depth, 2, 0, 0, 0)
    chunks = (
        png_chunk(b"IHDR", header) + before + png_chunk(b"IDAT", body) + png_chunk(b"IEND", b"")
    )
    return b"\x89PNG\r\n\x1a\n" + chunks


@functools.cache
def text_bomb(size: int) -> bytes:
    """A PNG chunk of compressed text that unpacks to size bytes."""
    return png_chunk(b"zTXt", b"Comment\0\0" + zlib.compress(b"\0" * size, 9))


def jpeg_claiming(jpeg: bytes, width_px: int, height_px: int) -> bytes:
    """jpeg, whose frame header now says another size."""
    head = re.compile(b"(\xff[\xc0-\xc2]..\x08)....", re.DOTALL)
    size = struct.pack(">HH", height_px, width_px)
    changed, count = head.subn(lambda match: match[1] + size, jpeg, count=1)
    assert count == 1, "no frame header"
    return changed


def with_exif(data: bytes, orientation: int) -> bytes:
    """A JPEG with EXIF's orientation."""
    exif = Image.Exif()
    exif[0x0112] = orientation
    body = exif.tobytes()
    return data[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + data[2:]


def ended(args: list[str], timeout_s: float = 60, **more: Any) -> tuple[int, str, str, float]:
    """Runs a command to its end: (exit code, stdout, stderr, peak memory of its largest process in
    MB).
    """
    # a small process between: what a child inherits from a large one counts as its own peak
    code = (
        "import os, resource, subprocess, sys\n"
        "done = subprocess.run(sys.argv[2:], timeout=float(sys.argv[1]))\n"
        "peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss\n"
        "os.write(2, f'\\npeak {peak} {done.returncode}'.encode())\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(timeout_s), *args], capture_output=True, **more
    )
    err, _, last = done.stderr.decode(errors="backslashreplace").rpartition("\npeak ")
    peak_kb, returncode = last.split()
    return int(returncode), done.stdout.decode(errors="backslashreplace"), err, int(peak_kb) / 1024
