"""Refusals of targets."""

from collections.abc import Callable
from pathlib import Path

from lfpipe.share.target import FORMS, check_target, check_targets

REMEDY = f"\n  remedy: {FORMS}"


def of(text: str) -> Callable[[Path], object]:
    """Checks one target."""
    return lambda here: check_target(text)


MESSAGES: dict[str, tuple[Callable[[Path], object], str]] = {
    "no kind": (of(""), "--share '': unknown kind" + REMEDY),
    "no host": (of("opentrack:127.0.0.1"), "--share 'opentrack:127.0.0.1': no HOST:PORT" + REMEDY),
    "port 0": (of("osc:127.0.0.1:0"), "--share 'osc:127.0.0.1:0': '0' is not a port, 1 to 65535" + REMEDY),
    "every address": (of("osc:[::]:9000"), "--share 'osc:[::]:9000': :: is no address to send to" + REMEDY),
    "broadcast": (
        of("osc:255.255.255.255:9000"),
        "--share 'osc:255.255.255.255:9000': '255.255.255.255': Permission denied"
        "\n  remedy: the name or address of the receiver's machine, 127.0.0.1 for this one",
    ),
    "no rate": (
        of("osc:127.0.0.1:9000?rate=nan"),
        "--share 'osc:127.0.0.1:9000?rate=nan': 'rate=nan' is not rate=HZ of 1 to 1000" + REMEDY,
    ),
    "two lines": (of("lsl:a\nb"), "--share 'lsl:a\\nb': a stream's name has 1 to 64 characters" + REMEDY),
    "twice": (
        lambda here: check_targets(["lsl", "lsl:lfpipe?rate=60"]),
        "--share lsl:lfpipe?rate=60: already a target\n  remedy: give each target once",
    ),
    "nine": (
        lambda here: check_targets([f"osc:127.0.0.1:{9000 + k}" for k in range(9)]),
        "--share: 9 targets, 8 at most\n  remedy: one program can pass them on to others",
    ),
}
