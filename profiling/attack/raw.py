"""What reaches a session without its protocol: raw connections and crowds of idle ones; and hostile scenes to load."""

from __future__ import annotations

import contextlib
import os
import random
import resource
import shutil
import socket
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from lfpipe.transport import control
from profiling.attack import scenes, templates
from profiling.attack.case import Outcome, rng_of
from profiling.attack.live import Dead
from tests.world import raw_address

if TYPE_CHECKING:
    from profiling.attack.ctl import Campaign

GREETING = b"\xff" + bytes(8) + b"\x7f\x03\x00NULL" + bytes(48)
READY = b"\x04\x26\x05READY\x0bSocket-Type\x00\x00\x00\x06DEALER\x08Identity\x00\x00\x00\x00"
LOAD_S = 60.0


def _bytes(rng: random.Random) -> bytes:
    """Something at the level of ZMTP."""
    whole = GREETING + READY
    return rng.choice(
        (
            rng.randbytes(rng.choice((1, 64, 5000))),
            GREETING[: rng.randrange(64)],
            whole,
            whole + b"\x02" + struct.pack(">Q", 2**63) + b"x",
            whole + b"\x00\xff" + rng.randbytes(255),
            whole + b"\x06" + struct.pack(">Q", 2**40),
            whole + b"\x01\x00" * 2000,
            whole + rng.randbytes(300),
            GREETING + b"\x04\xff" + rng.randbytes(255),
            b"GET / HTTP/1.1\r\n\r\n",
            GREETING.replace(b"NULL", b"PLAIN"),
            GREETING.replace(b"\x03", b"\x09"),
        )
    )  # fmt: skip


def _alive(campaign: Campaign, kind: str) -> None:
    """Notes whether the session answers and shows pictures after what was done to it."""
    try:
        campaign.live.told = campaign.live.hello()
        campaign.look([], kind)
        campaign.book.add("ctl", Outcome(kind, "refused"))
    except (Dead, control.BadMessage) as error:
        campaign.fail(kind, "ended", f"{kind}: {str(error).splitlines()[-1][-80:]}", str(error), [], "raw")
        campaign.restart()


def garbage(campaign: Campaign, count: int) -> None:
    """Raw bytes on the three sockets, each on a connection of its own that may stay half open."""
    held: list[socket.socket] = []
    for number in range(count):
        rng = rng_of(campaign.book.seed, "raw", number)
        family, address = raw_address(campaign.live.run_dir, rng.choice(("ctl", "bus", "tap")))
        made = socket.socket(family)
        made.settimeout(2)
        with contextlib.suppress(OSError):
            made.connect(address)
            made.sendall(_bytes(rng))
        held.append(made)
        if len(held) > 20:
            held.pop(rng.randrange(len(held))).close()
        if number % 20 == 19 or number == count - 1:
            _alive(campaign, "raw bytes")
        else:
            campaign.book.add("ctl", Outcome("raw bytes", "refused"))
    for made in held:
        made.close()


def crowd(campaign: Campaign, count: int) -> None:
    """Many connections that say nothing: the session still answers, and has let go of them afterwards."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    for greeting in (b"", GREETING + READY):
        held = []
        for _ in range(count):
            family, address = raw_address(campaign.live.run_dir, "ctl")
            made = socket.socket(family)
            made.settimeout(0.5)
            held.append(made)
            with contextlib.suppress(OSError):
                made.connect(address)
                made.sendall(greeting)
        campaign.book.add("ctl", Outcome("idle connections", "refused"), times=count - 1)
        time.sleep(1)
        _alive(campaign, "idle connections")
        for made in held:
            made.close()
        time.sleep(1)
        _alive(campaign, "idle connections, gone")


def wide_field(to: Path) -> None:
    """40x40 views with coordinates: what its pack says of them is longer than a pipe holds."""
    picture = cv2.imencode(".png", np.full((12, 16, 3), 90, np.uint8))[1].tobytes()
    for r in range(40):
        for c in range(40):
            (to / f"out_{r:02d}_{c:02d}_{-3.123456789 * r:.9f}_{7.987654321 * c:.9f}_.png").write_bytes(picture)


def private_tags(to: Path) -> None:
    """144 TIFFs whose private tags make a library print a line each."""
    tags = [
        (256, 4, 1, 16), (257, 4, 1, 12), (258, 3, 1, 8), (259, 3, 1, 1), (262, 3, 1, 1), (273, 4, 1, 400), (277, 3, 1, 1),
        (278, 4, 1, 12), (279, 4, 1, 192),
    ]  # fmt: skip
    tags += [(60_000 + n, 4, 1, 0) for n in range(20)]
    body = struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", *tag) for tag in tags) + bytes(4)
    data = (b"II*\0" + struct.pack("<I", 8) + body).ljust(400, b"\0") + bytes(range(192))
    for n in range(144):
        (to / f"view_{n // 12:02d}_{n % 12:02d}.tif").write_bytes(data)


def fifo(to: Path) -> None:
    templates.rows_cols(to)
    (to / "view_01_02.bmp").unlink()
    os.mkfifo(to / "view_01_02.bmp")


def baseline(to: Path) -> None:
    templates.hci(to)
    (to / "parameters.cfg").write_text(
        templates.CFG.replace("baseline_mm = 25", "baseline_mm = 1e307").replace(
            "focus_distance_m = 4.25", "focus_distance_m = 1e-300"
        )
    )


def sparse(to: Path) -> None:
    templates.rows_cols(to)
    os.truncate(to / "view_01_02.bmp", 2 << 40)


def huge(to: Path) -> None:
    templates.numbered(to)
    (to / "v004.ppm").write_bytes(b"P6\n20000 20000\n255\n" + bytes(100))
    (to / "v004.png").write_bytes(b"P6\n20000 20000\n255\n" + bytes(100))


def latin(to: Path) -> None:
    templates.rows_cols(to)
    os.rename(os.fsencode(to / "view_01_02.bmp"), os.fsencode(to) + b"/view_\xff01_02.bmp")  # noqa: PTH104


KINDS: tuple[Callable[[Path], None], ...] = (wide_field, private_tags, fifo, baseline, sparse, huge, latin)


def loads(campaign: Campaign, count: int) -> None:
    """Each scene is refused or shown, while the session goes on answering; then the first scene again."""
    base = campaign.work / "loads"
    campaign.live.ask({"cmd": "set", "set": {"governor.quality": "fixed"}})  # a message before may have set it free
    for number in range(len(KINDS) + count):
        folder = base / str(number)
        (folder / "scene").mkdir(parents=True)
        if number < len(KINDS):
            kind = KINDS[number].__name__.replace("_", " ")
            KINDS[number](folder / "scene")
        else:
            (folder / "scene").rmdir()
            kind = scenes.make(rng_of(campaign.book.seed, "loads", number), folder, campaign.work / "templates").kind.partition(
                ":"
            )[0]
        try:
            _load(campaign, folder / "scene", f"load: {kind}")
        except (Dead, control.BadMessage) as error:
            campaign.fail(f"load: {kind}", "ended", f"load {kind}: {str(error).splitlines()[-1][-80:]}", str(error), [], "load")
            campaign.restart()
        shutil.rmtree(folder, ignore_errors=True)


def _load(campaign: Campaign, scene: Path, kind: str) -> None:
    live, before = campaign.live, campaign.live.hello()
    socket_ = live.socket("ctl")
    socket_.send(control.encode({"cmd": "load", "scene": str(scene)}))
    end = time.monotonic() + LOAD_S
    answer = None
    while answer is None and time.monotonic() < end:
        live.ask({"cmd": "status"})
        if socket_.poll(200):
            answer = campaign._judged(socket_.recv(), [], "load")
            break
    socket_.close()
    if answer is None:
        campaign.fail(kind, "hang", f"{kind}: no answer within {LOAD_S:g} s", live.said()[-1500:], [], "load")
        campaign.restart()
        return
    after = live.hello()
    if not answer.get("ok") and (before["config"], before["options"], before["rev"]) != (
        after["config"],
        after["options"],
        after["rev"],
    ):
        campaign.fail(kind, "half-applied", f"{kind}: a refused load changed something", f"{before} {after}", [], "load")
    if answer.get("ok"):  # it may be of one view, which is drawn once; what was shown before, goes on
        live.ask({"cmd": "load", "scene": str(live.root / "scene")}, LOAD_S)
    live.told = live.hello()
    campaign.look([], "load")
    campaign.book.add("ctl", Outcome(kind, "accepted" if answer.get("ok") else "refused"))
