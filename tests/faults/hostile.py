"""Messages of a stranger to the control socket: no two alike, none valid."""

import random
from typing import Any

import msgpack

from lfpipe.transport import control

OTHERS = [None, 5, "stop", [1, 2], {"cmd": "stop"}, {"v": 99, "cmd": "stop"}, {1: 2}, {"v": 1}, {"v": True, "cmd": ["set"]}]
WORDS = ["config", "SET", "", "stop\0", "__init__", 7, None, ["stop"], {"stop": 1}]
FIELDS = {  # command -> field -> contents that it must refuse
    "set": ("set", [None, 5, [], {}, {"": 1}, {"render.alpha_px": "x"}, {"a.b.c": 1}, {"render": 5}, {"camera.width_px": 32}]),
    "load": ("scene", [None, 5, "", "a\0b", ["x"], "relative/scene", "../..", "x" * 5000]),
    "pictures": ("lease_s", [0, -1, 1e9, True, "x", None, float("nan"), float("inf"), [1]]),
    "trace": ("path", [None, 5, "a\0b", ["x"], "relative.json", "", "/dev/null/x.json"]),
    "record": ("path", [None, 5, "a\0b", ["x"], "relative", "", "/dev/null/x"]),
}


def hostile(rng: random.Random) -> bytes:
    """Random bytes, valid msgpack of another shape, commands with wrong contents, too much, too deep, cut short, one bit off."""
    kind = rng.randrange(8)
    if kind == 0:
        return rng.randbytes(rng.randrange(200))
    if kind == 1:
        return bytes(msgpack.packb(rng.choice(OTHERS)))
    if kind == 2:
        return control.encode({"cmd": rng.choice(WORDS), "set": {"render.alpha_px": 3}})
    if kind == 3:
        word, (name, contents) = rng.choice(list(FIELDS.items()))
        return control.encode({"cmd": word, name: rng.choice(contents)})
    if kind == 4 and rng.random() < 0.1:  # too large for an answer
        return bytes(msgpack.packb({"v": 1, "cmd": "stop", "x": "y" * (control.MAX_BYTES + rng.randrange(1000))}))
    if kind == 4:  # what is said to be larger than it is
        return rng.choice([b"\xdd", b"\xdf", b"\xdb", b"\xc6", b"\xc9"]) + rng.randbytes(4 + rng.randrange(50))
    if kind == 5:
        deep: Any = "stop"
        for _ in range(rng.randrange(10, 600)):
            deep = [deep]
        return bytes(msgpack.packb({"v": 1, "cmd": deep})) if rng.random() < 0.5 else b"\x91" * rng.randrange(60_000)
    if kind == 6:
        whole = control.encode({"cmd": "stop", "why": "x" * rng.randrange(100)})
        return whole[: rng.randrange(len(whole) - 1)]
    spoilt = bytearray(control.encode({"cmd": "stop"}))
    spoilt[rng.randrange(len(spoilt))] ^= 1 << rng.randrange(8)
    return bytes(spoilt)
