"""What can be wrong with bytes, with the numbers in a text, with a tree of JSON, and with what stands at a path."""

import contextlib
import json
import os
import random
import re
import shutil
import socket
import stat
from pathlib import Path
from typing import Any

NUMBERS = (
    "0", "-1", "1", "2", "-0.0", "1e-400", "1e307", "1e308", "-1e308", "1e400", "nan", "NaN", "-inf", "Infinity", "255", "256",
    "65535", "65536", "20000", "2147483647", "2147483648", "-2147483649", "4294967295", "9223372036854775807",
    "9223372036854775808", "18446744073709551616", "1" * 400, "9" * 5000, "", "x", "0x10", "1_0", "+5", "1,5", "1e", "٣", "½",
    "1 2", "3.0000000001", "0.3", "-3", "1000", "99999999",
)  # fmt: skip
WORDS = (
    "", " ", "x", "a\0b", "../../etc/passwd", "/dev/zero", "x" * 70_000, "\ud800", "\u202e", "🦉", "%s%n", "{0}", "[red]",
    "é" * 300,
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**31, 2**63, 2**64, -(2**63) - 1, 10**400, 0.5, -0.0, 1e307, 1e308, float("nan"),
    float("inf"), float("-inf"), [], {}, [[]], [None], {"": None}, [1, 2, 3], {"left": [0, 0], "right": [0, 0]}, "1", "none",
    *WORDS,
)  # fmt: skip
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")


def read(path: Path, most: int = 4 << 20) -> bytes:
    """What a file begins with: one that was damaged before may be huge."""
    with path.open("rb") as stream:
        return stream.read(most)


def changed_bytes(rng: random.Random, data: bytes) -> bytes:
    """Bits turned, cut short, a block repeated, left out, zeroed or random, or other bytes altogether."""
    if not data:
        return rng.randbytes(rng.randrange(1, 200))
    out = bytearray(data)
    start = rng.randrange(len(out)) if rng.random() < 0.5 else rng.randrange(min(len(out), 64))
    length = rng.choice((1, 2, 4, 8, 64, 1000))
    match rng.randrange(8):
        case 0 | 1:
            for _ in range(rng.randrange(1, 9)):
                out[rng.randrange(len(out)) if rng.random() < 0.5 else rng.randrange(min(len(out), 64))] ^= 1 << rng.randrange(8)
        case 2:
            del out[start:]
        case 3:
            out[start : start + length] = rng.choice((b"\0", b"\xff", b"\x7f", b"\x80")) * length
        case 4:
            del out[start : start + length]
        case 5:
            out[start:start] = out[start : start + length] * rng.choice((1, 2, 50))
        case 6:
            out[start : start + length] = rng.randbytes(length)
        case 7:
            return rng.randbytes(rng.randrange(300))
    return bytes(out)


def changed_numbers(rng: random.Random, data: bytes) -> bytes:
    """One to three of the numbers in a text are others."""
    for _ in range(rng.randrange(1, 4)):
        found = list(_NUMBER.finditer(data))
        if not found:
            return data + rng.choice(NUMBERS).encode()
        one = rng.choice(found)
        data = data[: one.start()] + rng.choice(NUMBERS).encode() + data[one.end() :]
    return data


def _nodes(tree: Any) -> list[tuple[Any, Any]]:
    """Every (container, key) of a tree."""
    found: list[tuple[Any, Any]] = []
    keys = tree.keys() if isinstance(tree, dict) else range(len(tree)) if isinstance(tree, list) else ()
    for key in keys:
        found.append((tree, key))
        found += _nodes(tree[key])
    return found


def changed_tree(rng: random.Random, tree: Any) -> Any:
    """A tree of plain values with one node replaced, removed, doubled or moved elsewhere. tree itself may change."""
    nodes = _nodes(tree)
    if not nodes or rng.random() < 0.02:
        return rng.choice(VALUES)
    holder, key = rng.choice(nodes)
    match rng.randrange(6):
        case 0:
            del holder[key]
        case 1 if isinstance(holder, dict):
            holder[rng.choice(WORDS)] = rng.choice(VALUES)
        case 1:
            holder.append(rng.choice(VALUES))
        case 2:
            other, there = rng.choice(nodes)
            holder[key] = json.loads(json.dumps(other[there]))
        case 3 if isinstance(holder[key], list) and holder[key]:
            holder[key] = holder[key] * rng.choice((2, 100))
        case _:
            holder[key] = rng.choice(VALUES)
    return tree


def changed_json(rng: random.Random, data: bytes) -> bytes:
    """JSON, or lines of it, with something wrong in its values or its text."""
    kind = rng.randrange(10)
    if kind == 0:
        return changed_bytes(rng, data)
    if kind == 1:
        return changed_numbers(rng, data)
    if kind == 2:
        deep = rng.choice((50, 900, 5000, 200_000))
        return rng.choice(
            (
                b"[" * deep,
                b'{"a":' * deep,
                b"[" * deep + b"]" * deep,
                b"\xef\xbb\xbf" + data,
                data.decode("utf-8", "replace").encode("utf-16"),
            )
        )
    lines = data.splitlines(keepends=True)
    if len(lines) > 1:
        with contextlib.suppress(ValueError):  # lines of JSON: change one of them
            place = rng.randrange(len(lines))
            lines[place] = json.dumps(changed_tree(rng, json.loads(lines[place]))).encode() + b"\n"
            match rng.randrange(5):
                case 0:
                    del lines[place]
                case 1:
                    lines.insert(place, lines[rng.randrange(len(lines))])
            return b"".join(lines)
    with contextlib.suppress(ValueError):
        return json.dumps(changed_tree(rng, json.loads(data)), ensure_ascii=rng.random() < 0.9).encode("utf-8", "surrogatepass")
    return changed_bytes(rng, data)


def removed(path: Path) -> None:
    """Nothing stands at path afterwards."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def changed_kind(rng: random.Random, path: Path) -> str:
    """Something else stands at path than an ordinary file; returns what."""
    kind = rng.choice(
        (
            "fifo",
            "folder",
            "dangling link",
            "loop of links",
            "link out",
            "link to a device",
            "link in",
            "socket",
            "empty",
            "sparse",
            "device",
            "gone",
        )
    )  # fmt: skip
    removed(path)
    match kind:
        case "fifo":
            os.mkfifo(path)
        case "folder":
            path.mkdir()
        case "dangling link":
            path.symlink_to("nowhere")
        case "loop of links":
            path.symlink_to(path.name)
        case "link out":
            path.symlink_to(rng.choice(("/etc/passwd", "/proc/self/mem", "/proc/self/environ", "/", "../..")))
        case "link to a device":
            path.symlink_to(rng.choice(("/dev/zero", "/dev/full", "/dev/null", "/dev/random", "/dev/tty", "/dev/stdin")))
        case "link in":
            others = [other.name for other in path.parent.iterdir()] or ["nowhere"]
            path.symlink_to(rng.choice(others))
        case "socket":
            with socket.socket(socket.AF_UNIX) as made, contextlib.suppress(OSError):  # a path may be too long for one
                made.bind(str(path))
        case "empty":
            path.touch()
        case "sparse":
            path.touch()
            os.truncate(path, rng.choice((1 << 28, 1 << 30, 1 << 33, 2 << 40)))
        case "device":
            if os.geteuid() == 0:
                os.mknod(path, 0o600 | stat.S_IFCHR, os.makedev(1, rng.choice((3, 5, 7, 8))))
    return kind


def grown(rng: random.Random, path: Path) -> None:
    """A hole of up to 2 TB after the bytes of a file."""
    os.truncate(path, path.stat().st_size + rng.choice((1 << 20, 1 << 28, 1 << 31, 2 << 40)))


def files_in(folder: Path) -> list[Path]:
    """The ordinary files below folder, but for huge ones."""
    return sorted(p for p in folder.rglob("*") if p.is_file() and not p.is_symlink() and p.stat().st_size < 1 << 24)


def odd_name(rng: random.Random) -> bytes:
    """A file name that somebody might have."""
    return (
        rng.choice(
            (
                b"\xff\xfe",
                b"caf\xe9",
                b"\xed\xa0\x80",
                "é".encode(),
                "e\u0301".encode(),
                "🦉".encode(),
                b"a b",
                b" ",
                b"-",
                b"--help",
                b"-o",
                b"a\nb",
                b"a\tb",
                b"a\x1b[31mb",
                b"a'b\"c",
                b"%s%n",
                b"$HOME",
                b"`id`",
                b"*",
                b"?",
                b"[red]x[/red]",
                b"a?loop=1",
                b"a#b",
                b"a:b",
                b"file:",
                b"demo",
                b"~",
                b"~root",
                b"...",
                b".hidden",
                b"x" * 255,
                "é".encode() * 127,
                b"CON",
                b"a\\b",
                b"\x7f",
                b"a\rb",
                "\u202egnp.a".encode(),
                b"1e400",
                b"0",
                b"a=b",
                b"a.toml",
                b"&",
                b"{x}",
                b"C:",
            )
        )
        if rng.random() < 0.8
        else bytes(b for b in rng.randbytes(rng.randrange(1, 60)) if b not in b"/\0") or b"x"
    )  # fmt: skip
