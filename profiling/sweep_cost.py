"""What a cell of a sweep costs beyond its work, and what a second worker brings.

    uv run python profiling/sweep_cost.py [--cells 40] [--most-empty 10000]
"""

import tempfile
import time
from pathlib import Path

import psutil
from arguments import parser_of, start

from lfpipe.sweep.cell import OK, Cell, Outcome, outcome
from lfpipe.sweep.engine import Job, Sweep, cluster
from lfpipe.sweep.results import Store, write
from lfpipe.sweep.work import Parcel

BUSY_S = 0.25
SIDES = (1000, 3000, 10_000)


def nothing(cell: Cell, *_: object) -> tuple[Outcome, bytes]:
    return outcome(cell, OK, figures={"psnr_db": 40.0}), b""


def busy(cell: Cell, *_: Parcel | bytes | bool) -> tuple[Outcome, bytes]:
    """Uses a core for BUSY_S of its time."""
    start = time.thread_time()
    while time.thread_time() - start < BUSY_S:
        sum(range(1000))
    return outcome(cell, OK, seconds=BUSY_S), b""


def run(count: int, workers: int, work: object) -> tuple[float, float, float]:
    """(seconds for the cells, seconds to start the cluster, seconds to write the report)."""
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder))
        begun = time.perf_counter()
        with cluster("", workers) as client:
            client.wait_for_workers(workers)
            start = time.perf_counter()
            jobs = [Job(Cell("quality", "", f"/s{k}", (), (), f"k{k}")) for k in range(count)]
            Sweep(client, "", lambda found, _: store.append(found), work).run(jobs)  # type: ignore[arg-type]
            end = time.perf_counter()
        store.close()
        write(list(store.outcomes.values()), Path(folder), None)
        return end - start, start - begun, time.perf_counter() - end


def main() -> None:
    args = parser_of(__doc__, cells=40, most_empty=10_000).parse_args()
    print("| empty cells | s | ms a cell | memory of the sweep, MB | report, s |\n|---|---|---|---|---|")
    for count in [side for side in SIDES if side <= args.most_empty]:
        seconds, _, report = run(count, 2, nothing)
        used = psutil.Process().memory_info().rss / 1e6
        print(f"| {count} | {seconds:.1f} | {seconds / count * 1000:.2f} | {used:.0f} | {report:.1f} |", flush=True)
    cells = args.cells
    one, begun, _ = run(cells, 1, busy)
    two, _, _ = run(cells, 2, busy)
    print(
        f"\n{cells} cells of {BUSY_S} s CPU: one worker {one:.2f} s, two {two:.2f} s: {one / two:.2f} times; start {begun:.1f} s"
    )
    print(f"beyond its work, one worker: {(one - cells * BUSY_S) / cells * 1000:.1f} ms a cell")


if __name__ == "__main__":
    start(main)
