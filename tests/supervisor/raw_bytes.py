"""Byte strings for a socket, sent without ZeroMQ: noise, and noise behind the greetings and frames
of the protocol's versions (ZMTP 1.0, 2.0 and 3.0, rfc.zeromq.org).
"""

import random
import socket
from collections.abc import Iterator
from pathlib import Path

ENDED_A_SESSION = b"\x01\x00\x02\x00A"  # ZMTP 1.0: an empty identity, then the message "A"
SIGNATURE = b"\xff" + bytes(7) + b"\x01\x7f"
GREETING = SIGNATURE + b"\x03\x00" + b"NULL".ljust(20, b"\0") + bytes(32)


def _frame(flags: int, body: bytes) -> bytes:
    return bytes([flags, len(body)]) + body


def _ready(kind: bytes) -> bytes:
    """The handshake of a socket of that type."""
    return _frame(4, b"\x05READY\x0bSocket-Type" + len(kind).to_bytes(4) + kind)


READY = _ready(b"DEALER")
PUSHING = _ready(b"PUSH")


def byte_strings(count: int, seed: int = 1) -> Iterator[bytes]:
    """So many strings, the same for the same seed."""
    chance = random.Random(seed)
    yield ENDED_A_SESSION
    for _ in range(count - 1):
        noise = chance.randbytes(chance.randint(0, 80))
        flags = chance.choice((0, 0, 0, 1, 2, 4, 255))
        frame = _frame(flags, noise)
        yield chance.choice(
            (
                noise,
                b"\x01\x00" + bytes([len(noise) + 1, flags]) + noise,  # ZMTP 1.0
                b"\x01\x00" + noise,
                SIGNATURE + b"\x01" + bytes([chance.choice((5, 8))]) + b"\0\0" + frame,  # 2.0
                GREETING + noise,
                GREETING + READY + frame,
                GREETING + PUSHING + frame,
            )
        )


def send_raw(path: Path, strings: Iterator[bytes]) -> int:
    """Sends each over a connection of its own; returns how many."""
    count = 0
    for data in strings:
        count += 1
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(path))
            try:
                client.sendall(data)
            except (BrokenPipeError, ConnectionResetError):
                continue  # refused before its end
    return count
