"""Hostile control messages to a session at camera rate: none may crash it, change it or cost a frame.

    uv run python profiling/control_fuzz.py [--messages 100000] [--seed 1] [--rate 30]

Random bytes, msgpack of other shapes, wrong contents, messages too large, too deep, truncated, with one bit flipped. The server
handles 1600 per second: 10^5 take a minute. Frames lost meanwhile are compared with those lost in as much time without messages.
Prints a Markdown table; exit code 1 if a guarantee was broken.
"""

import random
import sys
import time
from pathlib import Path

from arguments import parser_of, start

sys.path.insert(0, str(Path(__file__).parents[1]))

from lfpipe.bench.sessions import cpu_ns
from tests.faults.hostile import pester
from tests.faults.session import STAGES, WatchedSession
from tests.faults.watcher import Account
from tests.world import private_world


def lost(before: Account, after: Account) -> int:
    """Frames and records that stages lost between two accounts."""
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
        idle = session.books()
        same = session.told() == told
        alive = [session.supervisor.pid, *(session.pid(name) for name in STAGES)] == pids
        last = session.figures()
        session.end()
    grown = last.processes["supervisor"][0] - first.processes["supervisor"][0]
    lost_now, lost_idle = lost(before, after), lost(after, idle)
    print("| what | figure |\n|---|---|")
    print(f"| messages, answered with an error | {args.messages}, {answered} |")
    print(f"| handled in | {seconds:.0f} s, {args.messages / seconds:.0f} per second |")
    print(f"| configuration and options | {'unchanged' if same else 'CHANGED'} |")
    print(f"| processes | {'the same' if alive else 'RESTARTED'} |")
    print(f"| frames meanwhile, lost by track and render | {after.frames - before.frames}, {lost_now} |")
    print(f"| lost in as much time without messages | {lost_idle} |")
    print(f"| supervisor: cores meanwhile, growth of its memory | {busy:.2f}, {grown:.2f} MB |")
    return 0 if answered == args.messages and same and alive and lost_now <= lost_idle else 1


if __name__ == "__main__":
    start(main)
