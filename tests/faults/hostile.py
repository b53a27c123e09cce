"""Messages of a stranger to the control socket: no two alike, none valid."""

import random
from typing import Any

import msgpack

from lfpipe.transport import control

OTHERS = [
    None,
    5,
    "stop",
    [1, 2],
    {"cmd": "stop"},
    {"v": 99, "cmd": "stop"},
    {1: 2},
    {"v": 1},
    {"v": True, "cmd": ["set"]},
]
WORDS = [
    "config",
    "SET",
    "",
    "stop\0",
    "__init__",
    7,
    None,
    ["stop"],
    {"stop": 1},
    "set",
    "load",
    "pictures",
    "trace",
    "record",
]


def hostile(rng: random.Random) -> bytes:
    """Random bytes, valid msgpack of another shape, commands without contents, too much, too deep,
    cut short, one bit off.
    """
    deep: Any = "stop"
    for _ in range(rng.randrange(10, 600)):
        deep = [deep]
    large = {"v": 1, "cmd": "stop", "x": "y" * (control.MAX_BYTES + rng.randrange(1000))}
    whole = control.encode({"cmd": "stop", "why": "x" * rng.randrange(100)})
    spoilt = bytearray(control.encode({"cmd": "stop"}))
    spoilt[rng.randrange(len(spoilt))] ^= 1 << rng.randrange(8)
    kinds = [
        rng.randbytes(rng.randrange(200)),
        msgpack.packb(rng.choice(OTHERS)),
        control.encode({"cmd": rng.choice(WORDS), "path": 5, "lease_s": -1}),
        msgpack.packb(large) if rng.random() < 0.1 else b"\x91" * rng.randrange(60_000),
        # less than it says
        rng.choice([b"\xdd", b"\xdf", b"\xdb", b"\xc6", b"\xc9"])
        + rng.randbytes(4 + rng.randrange(50)),
        msgpack.packb({"v": 1, "cmd": deep}),
        whole[: rng.randrange(len(whole) - 1)],
        bytes(spoilt),
    ]
    return bytes(rng.choice(kinds))
