"""Hostile control messages into a session at camera rate: none may crash it, change it or cost a frame.

    uv run python profiling/control_fuzz.py [--messages 100000] [--seed 1] [--rate 30]

Random bytes, msgpack of another shape, wrong contents, too large, too deep, cut short, one bit off. The desk takes 1600 a
second, so 10^5 take a minute; the frames lost in as much time of peace stand beside those lost meanwhile. Prints a Markdown
table; exit code 1 where something was not kept.
"""

from __future__ import annotations

import random
import sys
import time
from pathlib import Path

from arguments import parser_of

sys.path.insert(0, str(Path(__file__).parents[1]))

from lfpipe.bench.sessions import cpu_ns
from tests.faults.hostile import pester
from tests.faults.session import STAGES, WatchedSession
from tests.faults.watcher import Account
from tests.world import private_world


def lost(before: Account, after: Account) -> int:
    """Frames and records that stages lost in between."""
    return after.track_drops + after.render_drops - before.track_drops - before.render_drops


def main() -> int:
    args = parser_of(__doc__, messages=100_000, seed=1, rate=30.0).parse_args()
    with private_world() as world:
        session = WatchedSession(world, args.rate)
        pids = [session.supervisor.pid, *(session.pid(name) for name in STAGES)]
        told, first = session.told(), session.figures()
        before = session.books()
        cpu, begin = cpu_ns(pids[:1]), time.monotonic()
        answered = pester(session.run_dir, random.Random(args.seed), args.messages)
        seconds = time.monotonic() - begin
        busy = (cpu_ns(pids[:1]) - cpu) / 1e9 / seconds
        after = session.books()
        time.sleep(seconds)
        peace = session.books()
        same = session.told() == told
        alive = [session.supervisor.pid, *(session.pid(name) for name in STAGES)] == pids
        last = session.figures()
        session.end()
    grown = last.processes["supervisor"][0] - first.processes["supervisor"][0]
    costs, in_peace = lost(before, after), lost(after, peace)
    print("| what | figure |\n|---|---|")
    print(f"| messages, answered with an error | {args.messages}, {answered} |")
    print(f"| taken in | {seconds:.0f} s, {args.messages / seconds:.0f} a second |")
    print(f"| configuration and options | {'unchanged' if same else 'CHANGED'} |")
    print(f"| processes | {'the same' if alive else 'OTHERS'} |")
    print(f"| frames meanwhile, lost by track and render | {after.frames - before.frames}, {costs} |")
    print(f"| lost in as much time of peace | {in_peace} |")
    print(f"| supervisor: cores meanwhile, growth of its memory | {busy:.2f}, {grown:.2f} MB |")
    return 0 if answered == args.messages and same and alive and costs <= in_peace else 1


if __name__ == "__main__":
    sys.exit(main())
