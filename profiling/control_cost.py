"""What control costs a session at camera rate: round trips, and frames lost meanwhile.

    uv run python profiling/control_cost.py [--seconds 15] [--rate 30]

Measures round trips over one connection, 20 per second: of `status`, of `set` until every stage has applied it, and of both while
another client sends as fast as it can. Frames lost are counted for each, and for as much time without requests. Prints a Markdown
table with the bounds. What monitors cost: observe_cost.py.
"""

import os
import random
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import zmq
from arguments import parser_of, start

sys.path.insert(0, str(Path(__file__).parents[1]))

from lfpipe.transport import control
from tests.faults.session import WatchedSession
from tests.world import private_world

FLOOD = """
import pathlib, sys, zmq
from lfpipe.transport import control
socket = zmq.Context().socket(zmq.DEALER)
control.connect(socket, pathlib.Path(sys.argv[1]), "ctl")
while True:
    socket.send(bytes.fromhex(sys.argv[2]))
"""


def round_trips_ms(session: WatchedSession, seconds: float, message: Callable[[], dict[str, Any]]) -> list[float]:
    """Times of successive commands, about 20 per second at random moments."""
    found = []
    rng = random.Random(1)
    with control.context() as ctx, ctx.socket(zmq.DEALER) as socket:
        control.connect(socket, session.run_dir, "ctl")
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
    """Another client that sends `status` as fast as it can and reads no answers."""
    words = [str(session.run_dir), control.encode({"cmd": "status"}).hex()]
    process = subprocess.Popen([sys.executable, "-c", FLOOD, *words])
    time.sleep(1.0)
    try:
        yield
    finally:
        process.kill()
        process.wait()


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
            result = work()
            now_frames, now_drops = lost()
            rows.append(f"| {what} | {result} | {bound} | {now_drops - drops} of {now_frames - frames} |")

        def trips(message: Callable[[], dict[str, Any]]) -> str:
            p50, p99, most = np.percentile(round_trips_ms(session, args.seconds, message), [50, 99, 100])
            return f"{p50:.1f}, {p99:.1f}, {most:.1f} ms"

        def idle() -> str:
            time.sleep(args.seconds)
            return ""

        row("nothing", "", idle)
        row("`status`: p50, p99, max", "p99 20 ms", lambda: trips(status))
        row("`set` until it is applied", "", lambda: trips(change))
        with flood(session):
            row("a flood of `status`, by itself", "", idle)
            row("`status` in a flood", "", lambda: trips(status))
            row("`set` in a flood", "", lambda: trips(change))
        session.end()
    print(f"load of the machine {os.getloadavg()[0]:.1f}, {os.cpu_count()} cores, {args.rate:g} Hz\n")
    print("| what | figure | bound | frames lost meanwhile |\n|---|---|---|---|")
    print("\n".join(rows))


if __name__ == "__main__":
    start(main)
