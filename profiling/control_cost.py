"""What control and monitors cost a session at camera rate: round trips, CPU, frames.

    uv run python profiling/control_cost.py [--seconds 15] [--rate 30]

Round trips over a kept connection, 20 a second, of `status`, of `set` until every stage works by it, and of both while another
client sends as fast as it can; then `lfpipe monitor` attached at 4 Hz. Frames lost stand beside those of as much time of peace.
Prints a Markdown table with the bounds.
"""

from __future__ import annotations

import os
import pty
import random
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import zmq
from arguments import parser_of

sys.path.insert(0, str(Path(__file__).parents[1]))

from lfpipe.bench.sessions import cpu_ns
from lfpipe.transport import control
from tests.faults.session import WatchedSession
from tests.world import World, private_world

FLOOD = """
import sys, zmq
socket = zmq.Context().socket(zmq.DEALER)
socket.connect(sys.argv[1])
while True:
    socket.send(bytes.fromhex(sys.argv[2]))
"""


def round_trips_ms(session: WatchedSession, seconds: float, message: Callable[[], dict[str, Any]]) -> list[float]:
    """Times of one command after the other, 20 a second at moments that chance chooses."""
    found = []
    rng = random.Random(1)
    with control.context() as ctx, ctx.socket(zmq.DEALER) as socket:
        socket.connect(control.address(session.run_dir, "ctl"))
        control.exchange(socket, {"cmd": "hello"}, 5, "no answer", "")
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            begin = time.perf_counter()
            control.exchange(socket, message(), 5, "no answer", "")
            found.append((time.perf_counter() - begin) * 1e3)
            time.sleep(rng.uniform(0, 0.1))
    return found


@contextmanager
def flood(session: WatchedSession) -> Iterator[None]:
    """Another client that sends `status` as fast as it can and reads no answer."""
    words = [control.address(session.run_dir, "ctl"), control.encode({"cmd": "status"}).hex()]
    process = subprocess.Popen([sys.executable, "-c", FLOOD, *words])
    time.sleep(1.0)
    try:
        yield
    finally:
        process.kill()
        process.wait()


def monitored(world: World, seconds: float, tty: bool) -> float:
    """Cores that a monitor takes: the terminal's screen, or JSON lines, both four times a second; its start left out."""
    words = [sys.executable, "-m", "lfpipe", "monitor", "--session", world.name, *([] if tty else ["--json"])]
    ours, theirs = pty.openpty()
    process = subprocess.Popen(words, stdin=theirs, stdout=theirs, stderr=theirs, env=world.env)
    os.close(theirs)

    def drain() -> None:
        try:
            while os.read(ours, 65536):
                pass
        except OSError:  # its end is closed
            return

    reader = threading.Thread(target=drain, daemon=True)
    reader.start()
    try:
        time.sleep(3.0)
        cpu, begin = cpu_ns([process.pid]), time.monotonic()
        time.sleep(seconds)
        return (cpu_ns([process.pid]) - cpu) / 1e9 / (time.monotonic() - begin)
    finally:
        process.kill()
        process.wait()
        reader.join()
        os.close(ours)


def main() -> None:
    args = parser_of(__doc__, seconds=15.0, rate=30.0).parse_args()
    alphas = iter(range(10, 10**9))

    def status() -> dict[str, Any]:
        return {"cmd": "status"}

    def change() -> dict[str, Any]:
        return {"cmd": "set", "set": {"render.alpha_px": float(next(alphas))}}

    rows = []
    with private_world() as world:
        session = WatchedSession(world, args.rate)

        def lost() -> tuple[int, int]:
            account = session.watcher.account()
            return account.frames, account.capture_drops + account.track_drops + account.render_drops

        def row(what: str, bound: str, work: Callable[[], str]) -> None:
            frames, drops = lost()
            said = work()
            now_frames, now_drops = lost()
            rows.append(f"| {what} | {said} | {bound} | {now_drops - drops} of {now_frames - frames} |")

        def trips(message: Callable[[], dict[str, Any]]) -> str:
            p50, p99, most = np.percentile(round_trips_ms(session, args.seconds, message), [50, 99, 100])
            return f"{p50:.1f}, {p99:.1f}, {most:.1f} ms"

        def peace() -> str:
            time.sleep(args.seconds)
            return ""

        row("nothing", "", peace)
        row("`status`: p50, p99, max", "p99 20 ms", lambda: trips(status))
        row("`set` until it is applied", "", lambda: trips(change))
        with flood(session):
            row("a flood of `status`, by itself", "", peace)
            row("`status` in a flood", "", lambda: trips(status))
            row("`set` in a flood", "", lambda: trips(change))
        row("monitor --json, 4 Hz", "2 % of a core", lambda: f"{monitored(world, args.seconds, False):.1%}")
        row("monitor on a terminal, 4 Hz", "2 % of a core", lambda: f"{monitored(world, args.seconds, True):.1%}")
        session.end()
    print(f"load of the machine {os.getloadavg()[0]:.1f}, {os.cpu_count()} cores, {args.rate:g} Hz\n")
    print("| what | figure | bound | frames lost meanwhile |\n|---|---|---|---|")
    print("\n".join(rows))


if __name__ == "__main__":
    main()
