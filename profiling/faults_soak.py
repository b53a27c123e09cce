"""Hundreds of random faults in one session: time until pictures return, torn pictures, drops that are not counted, leaks.

    uv run python profiling/faults_soak.py [--faults 500] [--seed 1] [--rate 30]

Kills, terminations and stops of any stage, a stopped supervisor, a stalled source, killed monitors, slow readers, CPU hogs
on both cores, garbage on the control socket, and finally a killed supervisor. No stage dies more than three times a minute,
because five deaths end a session by design. 500 faults take about 20 minutes. Prints progress, then Markdown tables; exit
code 1 if a guarantee was broken.
"""

import sys
from pathlib import Path

from arguments import parser_of, start

sys.path.insert(0, str(Path(__file__).parents[1]))  # tests run fewer of the same faults

from tests.faults.session import WatchedSession
from tests.faults.soak import Soak
from tests.world import private_world

RECOVERY_S, ORPHAN_S = 2.0, 1.0


def main() -> int:
    args = parser_of(__doc__, faults=500, seed=1, rate=30.0).parse_args()
    with private_world() as world:
        session = WatchedSession(world, args.rate)
        outcome = Soak(session, args.seed).run(args.faults, lambda text: print(text, file=sys.stderr, flush=True))
        gone_s = session.killed()
        left = world.left()
    print(outcome.table())
    print(f"\nsupervisor killed at the end: every process gone after {gone_s:.2f} s, {len(left)} files and segments left")
    broken = outcome.broken(RECOVERY_S) + [f"left behind: {name}" for name in left]
    broken += [f"a process outlived its supervisor by {gone_s:.2f} s"] if gone_s > ORPHAN_S else []
    print("\n" + ("\n".join(broken) or "all guarantees kept"))
    return 1 if broken else 0


if __name__ == "__main__":
    start(main)
