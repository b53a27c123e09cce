"""`lfpipe up` compared with the paper's loop (lfpipe/bench/paper_loop.py): latency, rate, CPU and
start, in alternating runs.

    python -m profiling.pipeline_vs_loop [VIDEO [SCENE]] [--pace 30|60|max] [--rounds 3]
    [--seconds 12]
        [--config paper] [--set KEY=VALUE]... [--cpus 0,1] [--busy]

VIDEO and SCENE: the demo's if not given. Latency is t_composed_ns - t_read_ns, the median of a run.
CPU is of all processes. Only with --pace max does the loop decode frames as it runs. Prints the
load of the machine, a row per run, and the median of the ratios with their range. --busy starts a
program for each of the cores that never waits, and whose CPU is then part of lfpipe's; otherwise,
let nothing else run.
"""

import atexit
import itertools
import os
import sys

import numpy as np

from lfpipe.bench.inputs import MOVING_S, demo_sequence
from lfpipe.bench.paper_loop import PAPER_ALPHA_PX, Loop
from lfpipe.bench.pipeline import (
    SessionRun,
    run_loop,
    run_session,
    settings_of,
    write_views,
)
from lfpipe.config import load
from lfpipe.host.worker import Child
from lfpipe.scene.pack import cache_dir, demo_scene, open_scene
from lfpipe.supervisor.process_table import SCORER
from profiling.arguments import existing, parser_of, start

MAX_IDLE_LOAD = 0.5  # of each core


def load_text(load: float, cores: int) -> str:
    """What the load average of a machine with so many cores means for the ratios."""
    per_core = load / cores
    idle = "idle" if per_core <= MAX_IDLE_LOAD else "not idle: the ratios do not hold"
    return f"load {per_core:.2f} per core, {idle}"


def metrics(run: SessionRun) -> dict[str, float]:
    """Figures of a run after its start. lost: frames missing between those that pictures show."""
    rows = run.steady
    spent_ns = [row["t_composed_ns"] - row["t_read_ns"] for row in rows if row["composed"]]
    steps = [b["source_seq"] - a["source_seq"] for a, b in itertools.pairwise(rows)]
    span_s = (rows[-1]["t_presented_ns"] - rows[0]["t_presented_ns"]) / 1e9
    return {
        "p50 ms": float(np.median(spent_ns)) / 1e6,
        "frames/s": sum(step != 0 for step in steps) / span_s,
        "cores": run.cpu_ms_s / 1e3,
        "first s": run.first_s,
        "lost": sum(step - 1 for step in steps if step > 1),
    }


def main() -> None:
    parser = parser_of(__doc__, rounds=3, seconds=12.0)
    parser.add_argument("video", type=existing, nargs="?")
    parser.add_argument("scene", type=existing, nargs="?")
    parser.add_argument("--pace", default="30")
    parser.add_argument("--config", default="paper")
    parser.add_argument("--set", dest="sets", action="append", default=[])
    parser.add_argument("--cpus", default="0,1")
    parser.add_argument("--busy", action="store_true")
    args = parser.parse_args()
    print(load_text(os.getloadavg()[0], os.cpu_count() or 1), flush=True)
    os.sched_setaffinity(0, {int(cpu) for cpu in args.cpus.split(",")})
    settings = load().scene
    cache = cache_dir(settings)
    video = args.video or demo_sequence(cache / "bench", MOVING_S[1])
    scene = args.scene or demo_scene(cache)
    field = open_scene(scene, settings, scorer=SCORER)
    views = write_views(field, cache / "bench" / "views" / field.manifest.key)
    fast = args.pace == "max"
    pace_hz = 0.0 if fast else float(args.pace)
    loop = Loop(
        video=str(video),
        views=str(views),
        pace_hz=pace_hz,
        seconds=args.seconds,
        alpha_px=PAPER_ALPHA_PX,
        grid=(field.rows, field.cols),
        decode=fast,
    )
    options = settings_of(args.config, [f"render.alpha_px={PAPER_ALPHA_PX}", *args.sets])
    for _ in args.cpus.split(",") if args.busy else ():
        atexit.register(Child([sys.executable, "-c", "while True: pass"]).close)
    pairs = []
    for k in range(args.rounds):
        runs = {
            "lfpipe": metrics(run_session(scene, video, args.seconds, options, args.pace)),
            "loop": metrics(run_loop(loop)),
        }
        if not k:
            print("round      " + "".join(f"{name:>12}" for name in runs["loop"]))
        for name, values in runs.items():
            print(
                f"{k} {name:9}" + "".join(f"{value:12.3f}" for value in values.values()), flush=True
            )
        pairs.append(runs)
    for name in ("p50 ms", "frames/s", *([] if args.busy else ["cores"]), "first s"):
        ratios = [runs["lfpipe"][name] / runs["loop"][name] for runs in pairs]
        print(
            f"ratio {name:<9} median {np.median(ratios):.3f}   {min(ratios):.3f} to"
            f" {max(ratios):.3f}"
        )


if __name__ == "__main__":
    start(main)
