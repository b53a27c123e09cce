"""From the sensor to a receiver: the age of eyes where they arrive by each output, beside the ring's own; and what sharing costs.

    uv run python profiling/share_latency.py [--seconds 20] [--inlets 32]

A session of the demo (display none) shares with opentrack's layout, OSC and LSL, frame by frame; each receiver is a process of
its own and notes how old the eyes are when it has them. Then the session's pictures are measured in turns: sharing with nobody,
with all three, and with so many LSL receivers at once, which give way to the
session. Prints Markdown.
"""

import json
import os
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable

import numpy as np
from arguments import parser_of, start

from lfpipe.supervisor.rundir import find
from lfpipe.transport import control
from lfpipe.transport.histogram import summary_ms
from lfpipe.transport.ring import Reader
from lfpipe.transport.session import Session
from lfpipe.transport.status import Table
from tests.share.receivers import free_port, lsl_environment
from tests.world import World, private_world

POLL_S = 0.0002
IMPORTS_S = 8.0
STREAM = f"profile{os.getpid()}"


def _ring(session: str, _port: int, note: Callable[[float], None], end: float) -> None:
    reader = Reader(Session(session).segment("eyes"))
    record = np.empty((), reader.dtype)
    while time.monotonic() < end:
        if (stamp := reader.read(record)) is not None:
            note((time.monotonic_ns() - stamp.t_sensor_ns) / 1e6)
        time.sleep(POLL_S)
    reader.close()


def _opentrack(session: str, port: int, note: Callable[[float], None], end: float) -> None:
    """The layout has no time: it is that of the record that was newest in the ring when the datagram came."""
    reader = Reader(Session(session).segment("eyes"))
    record, t_sensor_ns = np.empty((), reader.dtype), 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", port))
        receiver.settimeout(0.5)
        while time.monotonic() < end:
            try:
                struct.unpack("<6d", receiver.recv(64))
            except TimeoutError:
                continue
            now_ns = time.monotonic_ns()
            if (stamp := reader.read(record)) is not None:
                t_sensor_ns = stamp.t_sensor_ns
            if t_sensor_ns:
                note((now_ns - t_sensor_ns) / 1e6)
    reader.close()


def _osc(_session: str, port: int, note: Callable[[float], None], end: float) -> None:
    from pythonosc.dispatcher import Dispatcher
    from pythonosc.osc_server import BlockingOSCUDPServer

    dispatcher = Dispatcher()
    dispatcher.map("/lfpipe/frame", lambda _address, _face, _seq, t_ns: note((time.monotonic_ns() - t_ns) / 1e6))
    with BlockingOSCUDPServer(("127.0.0.1", port), dispatcher) as server:
        threading.Timer(end - time.monotonic(), server.shutdown).start()
        server.serve_forever(0.05)


def _lsl(_session: str, _port: int, note: Callable[[float], None], end: float) -> None:
    import pylsl

    inlet = pylsl.StreamInlet(pylsl.resolve_byprop("name", f"{os.environ['STREAM']}-eyes", 1, 20)[0], max_chunklen=1)
    while time.monotonic() < end:
        _, t_s = inlet.pull_sample(timeout=0.5)
        if t_s is not None:
            note(1000 * (pylsl.local_clock() - t_s))


def flood(count: int, seconds: float) -> None:
    """Many receivers in one process, which gives way to all others: as if they were on other machines."""
    import pylsl

    os.nice(19)
    end = time.monotonic() + seconds
    (found,) = pylsl.resolve_byprop("name", f"{os.environ['STREAM']}-eyes", 1, 20)
    inlets = [pylsl.StreamInlet(found) for _ in range(count)]
    while time.monotonic() < end:
        for inlet in inlets:
            inlet.pull_chunk()
        time.sleep(0.1)


RECEIVERS = {"ring": _ring, "opentrack": _opentrack, "osc": _osc, "lsl": _lsl}


def receive(kind: str, session: str, port: int, seconds: float) -> None:
    """A receiver's process: prints the ages in ms."""
    ages: list[float] = []
    if kind.startswith("flood"):
        flood(int(kind.removeprefix("flood")), seconds)
        print("[]")
        return
    RECEIVERS[kind](session, port, ages.append, time.monotonic() + seconds)
    print(json.dumps(ages))


def receivers(world: World, kinds: list[str], ports: dict[str, int], seconds: float) -> list[list[float]]:
    """The ages that receivers of these kinds note meanwhile."""
    env = {**world.env, "STREAM": STREAM}
    started = []
    for kind in kinds:
        words = [sys.executable, __file__, "--receive", kind, world.name, str(ports.get(kind, 0)), str(seconds)]
        started.append(subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=env))
    return [json.loads(process.communicate()[0]) for process in started]


def ask(world: World, **message: object) -> None:
    control.request(find(world.name).run_dir, message, 15)


class Pictures:
    """Age of pictures and drops of a session between two moments."""

    def __init__(self, world: World) -> None:
        self._table = Table(Session(world.name).segment("status"))
        self._began = time.monotonic()
        self._before = {name: row.copy() for name, row in self._table.rows.items()}

    def line(self, name: str) -> str:
        """A line of the table, of the time since."""
        rows = self._table.rows
        age = rows["render"]["age"].copy()
        age["buckets"] -= self._before["render"]["age"]["buckets"]
        figures = summary_ms(age)
        spent_ns = int(rows["share"]["cpu_ns"] - self._before["share"]["cpu_ns"])
        cpu = f"{spent_ns / 1e7 / (time.monotonic() - self._began):.1f} %"
        drops = {key: int(rows[key]["drops"] - self._before[key]["drops"]) for key in ("capture", "track", "render", "share")}
        said = ", ".join(f"{key} {count}" for key, count in drops.items())
        del rows
        self._before.clear()
        self._table.close()
        return f"| {name} | {figures['n']} | {figures['p50_ms']:.2f} | {figures['p99_ms']:.2f} | {cpu} | {said} |"


def main(seconds: float, inlets: int) -> None:
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} at the start, {seconds:g} s each\n")
    with private_world() as world:
        settings = lsl_environment(world.root)
        world.env |= settings
        world.env.pop("XDG_CACHE_HOME", None)  # the demo is packed there, or will be
        os.environ |= settings
        ports = {"opentrack": free_port(), "osc": free_port()}
        targets = [f"{kind}:127.0.0.1:{port}" for kind, port in ports.items()] + [f"lsl:{STREAM}"]
        camera = ("--demo", "--display", "none", "--session", world.name, "--trace", world.trace)
        world.start("up", *camera, "--set=governor.quality=fixed", stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        world.wait_for(lambda: len(world.lines()) > 120, "pictures", 600)
        ask(world, cmd="share", start=targets)
        time.sleep(2)
        print("| eyes received by | frames | p50 ms | p99 ms | largest |\n|---|---|---|---|---|")
        for kind, ages in zip(RECEIVERS, receivers(world, list(RECEIVERS), ports, seconds), strict=True):
            p50, p99 = np.percentile(ages, (50, 99))
            print(f"| {kind} | {len(ages)} | {p50:.2f} | {p99:.2f} | {max(ages):.2f} |", flush=True)
        print("\n| shared with | pictures composed | age p50 ms | p99 ms | CPU of share | dropped |\n|---|---|---|---|---|---|")
        for name, kinds in (("nobody", []), ("all three", list(RECEIVERS)[1:]), (f"{inlets} LSL receivers", [f"flood{inlets}"])):
            ask(world, cmd="share", stop=[]) if not kinds else None
            if name == "all three":
                ask(world, cmd="share", start=targets)
            waiting = threading.Thread(target=receivers, args=(world, kinds, ports, seconds + IMPORTS_S))
            waiting.start()
            time.sleep(IMPORTS_S)  # the receivers' imports are no part of it
            measured = Pictures(world)
            time.sleep(seconds)
            print(measured.line(name), flush=True)
            waiting.join()


if __name__ == "__main__":
    if sys.argv[1:2] == ["--receive"]:
        receive(sys.argv[2], sys.argv[3], int(sys.argv[4]), float(sys.argv[5]))
    else:
        arguments = parser_of(__doc__, seconds=20.0, inlets=32).parse_args()
        start(lambda: main(arguments.seconds, arguments.inlets))
