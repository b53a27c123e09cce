"""Untrusted files, generated from a seed: wrong values, damaged bytes, and things that are no files
at all.

Plain functions of `random.Random` and of paths, so that tests and attack harnesses share them.
"""

import copy
import functools
import json
import os
import random
import re
import socket
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterator
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

# Texts in place of a JSON value that are invalid or strange.
JSON_TEXTS = (
    "NaN",
    "-Infinity",
    "1e400",
    "-1e400",
    "9" * 5000,
    "-" + "9" * 400,
    "1." + "9" * 5000,
    "[" * 100_000,
    '{"k":' * 5000 + "1" + "}" * 5000,
    '"\\ud800"',
    '"\\u0000"',
    '"\x00"',
    "01",
    "+1",
    "0x10",
    "tru",
    "",
    " ",
    ",",
    "}",
    "]",
    "'x'",
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


def json_text(value: Any) -> str:
    """value as JSON, with Python's extensions; whole numbers may have any length."""
    sys.set_int_max_str_digits(0)
    try:
        return json.dumps(value)
    finally:
        sys.set_int_max_str_digits(4300)


def places(tree: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The path of every value within a tree of lists and dicts."""
    inner = (
        tree.items()
        if isinstance(tree, dict)
        else enumerate(tree)
        if isinstance(tree, list)
        else ()
    )
    for key, value in inner:
        yield (*path, key)
        yield from places(value, (*path, key))


def damaged_tree(rng: random.Random, tree: Any) -> Any:
    """tree with one place changed, removed, renamed or scaled."""
    tree = copy.deepcopy(tree)
    found = list(places(tree))
    if not found or rng.random() < 0.05:
        return rng.choice(VALUES)
    *way, last = rng.choice(found)
    holder = tree
    for key in way:
        holder = holder[key]
    kind = rng.randrange(6)
    value = holder.pop(last)
    if kind == 1 and isinstance(holder, dict):
        holder[rng.choice(("", "\0", "\ud800", "x" * 5000, f"{last} ", f"{last}"[:-1]))] = value
    elif kind > 0:
        factor, more = rng.choice((-1, 2, 10**10, 10**30, 1e-9, 1e300)), rng.choice((0, 1, -1, 0.5))
        scaled = kind == 2 and isinstance(value, int | float)
        new = factor * value + more if scaled else copy.deepcopy(rng.choice(VALUES))
        if isinstance(holder, dict):
            holder[last] = new
        else:
            holder.insert(last, new)
    return tree


def damaged_json(rng: random.Random, tree: Any) -> bytes:
    """tree as JSON with damage to a value, to the text or to its bytes."""
    kind = rng.randrange(4)
    if kind == 0:
        text = json.dumps(tree)
        start, end = rng.choice(
            [match.span() for match in re.finditer(r'"[^"]*"|[\w.+-]+', text)] or [(0, 0)]
        )
        return (text[:start] + rng.choice(JSON_TEXTS) + text[end:]).encode("utf-8", "surrogatepass")
    if kind == 1:
        return damaged_bytes(rng, json.dumps(tree).encode())
    return json_text(damaged_tree(rng, tree)).encode("utf-8", "surrogatepass")


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


def damaged_lines(rng: random.Random, lines: list[Any]) -> bytes:
    """JSON Lines with one line damaged, missing, doubled, exchanged with another, or endless."""
    texts = [json.dumps(line).encode() for line in lines]
    at, other = rng.randrange(len(texts)), rng.randrange(len(texts))
    exchanged = texts.copy()
    exchanged[at], exchanged[other] = texts[other], texts[at]
    kinds = (
        texts[:at] + texts[at + 1 :],
        [*texts[:other], texts[at], *texts[other:]],
        exchanged,
        *(
            [*texts[:at], line, *texts[at + 1 :]]
            for line in (b"x" * 3_000_000, *(damaged_json(rng, lines[at]) for _ in range(3)))
        ),
    )
    whole = b"".join(text + b"\n" for text in rng.choice(kinds))
    return damaged_bytes(rng, whole) if rng.random() < 0.15 else whole


CELLS = (
    "nan",
    "inf",
    "1e308",
    "-1e308",
    "1e999",
    "",
    "x",
    "9" * 5000,
    "0x1",
    "1_0",
    '"',
    '"' + "y" * 200_000,
    "\0",
    "-1",
    str(2**63),
)


def damaged_table(rng: random.Random, text: str) -> bytes:
    """A CSV table with a cell, a column or bytes damaged."""
    if rng.random() < 0.2:
        return damaged_bytes(rng, text.encode())
    rows = [line.split(",") for line in text.splitlines()]
    row = rng.choice(rows)
    at = rng.randrange(len(row))
    row[at : at + 1] = rng.choice(([], ["7", row[at]], [rng.choice(CELLS)], [rng.choice(CELLS)]))
    return "\n".join(",".join(row) for row in rows).encode() + b"\n"


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
