"""Minutes at camera rate on two cores with a CPU hog on one of them: rate, every drop counted, constant memory.

    uv run python profiling/soak_steady.py [--minutes 10] [--rate 30] [--rate 120] [--scene PATH] [--no-hog]

Frames carry checksums. The hog is a busy loop on the first core, where capture and render run. Memory is each process's own
(RssAnon). Prints a row per minute; exit code 1 if a guarantee was broken.
"""

import os
import subprocess
import sys
import time
from pathlib import Path

from arguments import existing, parser_of, start

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.faults.session import WatchedSession
from tests.faults.watcher import Account
from tests.world import private_world

RATE_SHARE, MEMORY_SHARE = 0.01, 0.02


def steady(rate_hz: float, minutes: int, scene: Path | None, hog: bool) -> list[str]:
    """Runs one session; returns the broken guarantees."""
    cpus = sorted(os.sched_getaffinity(0))[:2]
    os.sched_setaffinity(0, cpus)
    broken = []
    with private_world() as world:
        session = WatchedSession(world, rate_hz, scene=scene)
        words = ["taskset", "-c", str(cpus[0]), sys.executable, "-c", "while True: pass"]
        busy = subprocess.Popen(words) if hog else None
        try:
            time.sleep(5.0)
            first = before = session.books()
            begin = last = time.monotonic()
            memory = []
            print(
                f"\n{rate_hz:g} Hz, {'a hog on core ' + str(cpus[0]) if hog else 'no hog'}, scene {scene or 'with plain views'}\n"
            )
            print("| minute | frames/s | pictures/s | drops: capture, track, render | own memory MB, supervisor first |")
            print("|---|---|---|---|---|", flush=True)
            for minute in range(1, minutes + 1):
                time.sleep(max(0.0, begin + 60 * minute - time.monotonic()))
                now, t = session.watcher.account(), time.monotonic()
                held = session.figures().processes
                memory.append([held[name][0] for name in ("supervisor", "lfpipe-capture", "lfpipe-track", "lfpipe-render")])
                frames, lines = (now.frames - before.frames) / (t - last), (now.lines - before.lines) / (t - last)
                drops = ", ".join(map(str, _drops(now, before)))
                print(
                    f"| {minute} | {frames:.2f} | {lines:.2f} | {drops} | {', '.join(f'{mb:.1f}' for mb in memory[-1])} |",
                    flush=True,
                )
                before, last = now, t
            rate = (before.frames - first.frames) / (last - begin)
            books = session.books()
        finally:
            if busy is not None:
                busy.kill()
                busy.wait()
        watcher = session.watcher
        session.end()
    print(f"\nframes {rate:.3f} a second; drops {_drops(books, first)}; counted less missing {list(books.errors().values())}")
    print(f"torn {watcher.torn + watcher.torn_pictures} of {watcher.seen + watcher.pictures}; load {os.getloadavg()[0]:.1f}")
    if abs(rate / rate_hz - 1) > RATE_SHARE:
        broken.append(f"{rate_hz:g} Hz: {rate:.2f} frames a second")
    if any(books.errors().values()) or watcher.torn or watcher.torn_pictures:
        broken.append(f"{rate_hz:g} Hz: books {books.errors()}, torn {watcher.torn + watcher.torn_pictures}")
    for name, then, at_last in zip(("supervisor", "capture", "track", "render"), memory[0], memory[-1], strict=True):
        if abs(at_last / then - 1) > MEMORY_SHARE:
            broken.append(f"{rate_hz:g} Hz: {name} from {then:.1f} to {at_last:.1f} MB")
    return broken


def _drops(now: Account, then: Account) -> tuple[int, int, int]:
    return now.capture_drops - then.capture_drops, now.track_drops - then.track_drops, now.render_drops - then.render_drops


def main() -> int:
    parser = parser_of(__doc__, minutes=10)
    parser.add_argument("--rate", type=float, action="append")
    parser.add_argument("--scene", type=existing)
    parser.add_argument("--no-hog", action="store_true")
    args = parser.parse_args()
    broken = []
    for rate_hz in args.rate or [30.0, 120.0]:
        broken += steady(rate_hz, args.minutes, args.scene and args.scene.resolve(), not args.no_hog)
    print("\n" + ("\n".join(broken) or "all guarantees kept"))
    return 1 if broken else 0


if __name__ == "__main__":
    start(main)
