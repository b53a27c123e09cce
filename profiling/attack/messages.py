"""Messages to ctl and bus by grammar: every shape that msgpack can carry, every command with every field replaced."""

import random
import struct
from typing import Any

import attrs
import msgpack

from lfpipe import config
from lfpipe.transport import control

FIELDS = {  # command -> its fields with a valid value each
    "hello": {"stage": "capture"}, "status": {}, "set": {"set": {"render.alpha_px": 12.0}}, "pause": {}, "resume": {},
    "recentre": {}, "load": {"scene": "/nowhere"}, "pictures": {"lease_s": 0.2}, "trace": {"path": ""},
    "record": {"path": "", "eyes": False}, "stop": {},
}  # fmt: skip
TEXTS = (
    b"", b"a", b"\0", b"\xff\xfe", b"\xed\xa0\x80", b"render", b"render.alpha_px", b"render.", b".", b"__class__", b"stop",
    b"config", b"../..", b"/dev/zero", b"x" * 300, b"x" * 40_000, "🦉".encode(), b"\x1b[2J", b"%s{0}", b"a.b.c", b"nan",
    b"1e400", b"capture", b"auto", b"true",
)  # fmt: skip
INTEGERS = (0, 1, -1, 2**31, -(2**31), 2**63 - 1, -(2**63), 2**64 - 1, 255, 256, 10**6)
FLOATS = (0.0, -0.0, 1e-320, 1e307, 1e308, float("nan"), float("inf"), float("-inf"), 0.5)
SECTIONS = ("camera", "track", "render", "screen", "scene", "governor", "control", "replay")
WAYS = (
    "bytes", "value", "map", "version", "field", "extra field", "section", "keys", "many keys", "half valid", "valid",
    "cut short", "bit", "deep", "double key", "large", "parts",
)  # fmt: skip


@attrs.frozen
class Message:
    """frames: of one message on the wire. answered: whether exactly one answer must come."""

    kind: str
    frames: list[bytes]
    answered: bool = True


def text(rng: random.Random) -> bytes:
    """A string of msgpack, whose bytes may be no UTF-8."""
    data = rng.choice(TEXTS)
    if len(data) < 32 and rng.random() < 0.8:
        return bytes((0xA0 | len(data),)) + data
    return rng.choice((b"\xda" + struct.pack(">H", len(data)), b"\xdb" + struct.pack(">I", len(data)))) + data


def value(rng: random.Random, deep: int = 3) -> bytes:
    """Any one value of msgpack, of every type it has."""
    match rng.randrange(16):
        case 0:
            return rng.choice((b"\xc0", b"\xc2", b"\xc3"))
        case 1:
            return bytes(msgpack.packb(rng.choice(INTEGERS)))
        case 2:
            return b"\xca" + rng.randbytes(4) if rng.random() < 0.2 else bytes(msgpack.packb(rng.choice(FLOATS)))
        case 3 | 4 | 5:
            return text(rng)
        case 6:
            return bytes(msgpack.packb(rng.randbytes(rng.choice((0, 1, 20, 300)))))
        case 7:
            return bytes(msgpack.packb(msgpack.ExtType(rng.randrange(128), rng.randbytes(rng.choice((0, 1, 2, 4, 8, 16, 17))))))
        case 8:
            return bytes(msgpack.packb(msgpack.Timestamp(rng.choice((0, 2**34, 2**40)), 5)))
        case 9:
            return b"\xc1"
        case 10 | 11 if deep:
            count = rng.choice((0, 1, 2, 3, 15))
            return bytes((0x90 | count,)) + b"".join(value(rng, deep - 1) for _ in range(count))
        case 12 | 13 | 14 if deep:
            count = rng.choice((0, 1, 2, 3))
            return bytes((0x80 | count,)) + b"".join(
                (text(rng) if rng.random() < 0.9 else value(rng, 0)) + value(rng, deep - 1) for _ in range(count)
            )
        case _:
            return rng.choice((b"\xdd", b"\xdf", b"\xdb", b"\xc6", b"\xc9", b"\xdc", b"\xde", b"\xc8")) + rng.randbytes(
                rng.randrange(8)
            )


def packed(pairs: list[tuple[bytes, bytes]]) -> bytes:
    """A map of pairs that are packed already."""
    head = bytes((0x80 | len(pairs),)) if len(pairs) < 16 else b"\xde" + struct.pack(">H", len(pairs))
    return head + b"".join(key + content for key, content in pairs)


def _s(word: str) -> bytes:
    return bytes(msgpack.packb(word))


def request(word: bytes, fields: list[tuple[bytes, bytes]], version: bytes = b"\x01") -> bytes:
    """A message with that command and fields, all packed already."""
    return packed([(_s("v"), version), (_s("cmd"), word), *fields])


def _set(pairs: list[tuple[bytes, bytes]]) -> bytes:
    """A request to set those pairs."""
    return request(_s("set"), [(_s("set"), packed(pairs))])


def _settings(rng: random.Random, count: int) -> list[tuple[bytes, bytes]]:
    keys = list(config.options())
    return [(_s(rng.choice(keys)), value(rng)) for _ in range(count)]


VALID: tuple[dict[str, Any], ...] = (
    {"render.alpha_px": 12.0}, {"render.alpha_px": 30}, {"render.method": "nearest"}, {"render.method": "blend"},
    {"render.anaglyph": "colour"}, {"render.ghost_compensation": 3, "render.swap_eyes": True}, {"render.swap_eyes": False},
    {"track.filter": "mean", "track.mean_k": 3}, {"track.filter": "predictive"}, {"render.zero_plane_px": 0.5},
    {"camera.fov_deg": 60.0}, {"screen.distance_mm": 700.0}, {"render.extrapolate_views": 1},
)  # fmt: skip


def _one(rng: random.Random, way: str) -> list[bytes]:
    """The frames of a message of that way."""
    word = rng.choice(list(FIELDS))
    fields = FIELDS[word]
    right = [(_s(name), bytes(msgpack.packb(content))) for name, content in fields.items()]
    good = control.encode({"cmd": word, **fields})
    match way:
        case "bytes":
            return [rng.randbytes(rng.choice((0, 1, 3, 20, 200, 5000)))]
        case "value":
            return [value(rng)]
        case "map":
            return [packed([(text(rng), value(rng)) for _ in range(rng.randrange(6))])]
        case "version":
            return [request(_s(word), right, value(rng))]
        case "field":
            names = list(fields) or ["set"]
            return [request(_s(word) if rng.random() < 0.9 else value(rng), [(_s(name), value(rng)) for name in names])]
        case "extra field":
            return [request(_s(word), [*right, *((text(rng), value(rng)) for _ in range(rng.choice((1, 3, 14, 200))))])]
        case "section":
            tables: tuple[bytes, ...] = (
                b"\x80",
                b"\x90",
                b"\xc0",
                packed([(_s("alpha_px"), _s("auto"))]),
                packed([(text(rng), value(rng))]),
                value(rng),
            )
            return [_set([(_s(rng.choice(SECTIONS)), rng.choice(tables)) for _ in range(rng.choice((1, 1, 2)))])]
        case "keys":
            odd = [(text(rng), value(rng)) for _ in range(rng.choice((0, 1, 2)))]
            return [_set([*_settings(rng, rng.choice((0, 1, 3))), *odd])]
        case "many keys":
            count = rng.choice((50, 1000, 3626, 6000))
            stem = rng.choice(("k", "render.k", "é", "render.alpha_p"))
            return [_set([(_s(f"{stem}{n}"), b"\x01") for n in range(count)])]
        case "half valid":
            pairs = [
                (_s("render.alpha_px"), bytes(msgpack.packb(rng.choice((5.0, 77.0))))),
                *_settings(rng, 2),
                (text(rng), value(rng)),
            ]
            rng.shuffle(pairs)
            return [_set(pairs)]
        case "valid":
            words = ({"cmd": "set", "set": rng.choice(VALID)}, {"cmd": rng.choice(("pause", "resume", "resume", "recentre"))})
            others = ({"cmd": "hello"}, {"cmd": "status"}, {"cmd": "pictures", "lease_s": 0.2})
            return [control.encode(rng.choice((*words, *words, *others)))]
        case "cut short":
            return [good[: rng.randrange(len(good))]]
        case "bit":
            turned = bytearray(good)
            for _ in range(rng.choice((1, 1, 2, 5))):
                turned[rng.randrange(len(turned))] ^= 1 << rng.randrange(8)
            return [bytes(turned)]
        case "deep":
            deep = rng.choice((b"\x91", b"\x81\xa1a")) * rng.choice((5, 9, 500, 1025, 20_000))
            return [request(_s(word), [(_s(rng.choice(("set", "path", "x"))), deep + b"\x01")]) if rng.random() < 0.7 else deep]
        case "double key":
            twice = [
                (_s("set"), packed([(_s("render.alpha_px"), b"\x05"), (_s("render.alpha_px"), value(rng))])),
                (_s("cmd"), _s(rng.choice(("set", "status")))),
            ]
            return [request(_s(word), [*right, *twice])]
        case "large":
            size = rng.choice((control.MAX_BYTES - 60, control.MAX_BYTES + 1, 2 * control.MAX_BYTES - 100))
            return [
                request(
                    _s(word), [(_s(rng.choice(("x", "set", "path", "scene"))), b"\xdb" + struct.pack(">I", size) + b"y" * size)]
                )
            ]
        case _:
            return [rng.choice((b"", good, b"stop", rng.randbytes(5))) for _ in range(rng.randrange(2, 6))]


def _obeyed(frames: list[bytes]) -> bool:
    """Whether a message is one that would end the session, start work that takes long, or write where we are not."""
    if len(frames) != 1:
        return False
    try:
        message = control.decode(frames[0])
    except control.BadMessage:
        return False
    word = message.get("cmd")
    return word == "stop" or (
        word in ("load", "trace", "record") and any(str(message.get(name, "")).startswith("/") for name in ("path", "scene"))
    )


def ctl_message(rng: random.Random) -> Message:
    """A request that the session refuses, or takes without harm."""
    while True:
        way = rng.choice(WAYS) if rng.random() < 0.85 else "keys"
        if way in ("large", "many keys", "deep") and rng.random() < 0.8:
            continue
        frames = _one(rng, way)
        if not _obeyed(frames) and sum(map(len, frames)) < 2 * control.MAX_BYTES:
            return Message(way, frames)


TOPICS = ("notice", "source", "parallax", "failed", "level", "eyes", "config", "", "x" * 1000)
NOTES = (5, None, True, 1e308, "x", {}, [], [5, None, "x"], {"a": 1}, [["x"]], "y" * 9000, "\x1b[2J")


def bus_message(rng: random.Random) -> Message:
    """What a stage might never say."""
    frames = [_told(rng) for _ in range(1 if rng.random() < 0.95 else 3)]
    return Message("bus", frames, answered=False)


def _told(rng: random.Random) -> bytes:
    """One frame of it."""
    match rng.randrange(5):
        case 0:
            return control.encode({"topic": rng.choice(TOPICS), rng.choice(("notes", "text")): rng.choice(NOTES)})
        case 1:
            topic = _s(rng.choice(TOPICS)) if rng.random() < 0.7 else value(rng)
            told = [(_s(name), value(rng)) for name in ("notes", "text", "stage", "t_ns")]
            return packed([(_s("v"), b"\x01"), (_s("topic"), topic), *told])
        case 2:
            return packed([(_s("v"), b"\x01"), (text(rng), value(rng)), (text(rng), value(rng))])
        case 3:
            return rng.randbytes(rng.choice((0, 1, 50, 70_000)))
        case _:
            return value(rng)


def tap_message(rng: random.Random) -> Message:
    """A subscription, or what is none."""
    return Message(
        "tap", [rng.choice((b"\1", b"\0", b"\2", b"")) + rng.choice((b"", b"x" * 5000, rng.randbytes(20)))], answered=False
    )
