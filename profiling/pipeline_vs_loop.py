"""`lfpipe up` beside the paper's loop: latency, rate, CPU and drops, in turn, each round one of both.

    uv run python profiling/pipeline_vs_loop.py VIDEO SCENE [--pace 30|60|max] [--rounds 3] [--seconds 12]
        [--config paper] [--set KEY=VALUE]... [--loop SCRIPT] [--cpus 0,1]

Latency is t_composed - t_read over composed pictures, p50 of a round; CPU is of the whole tree of processes, supervisor included,
over the steady part of the run. Prints a row a round and the median of the ratios with their spread.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from arguments import parser_of

from lfpipe.bench.sessions import cpu_ns

START_S = 4.0  # before the steady part


def lfpipe(args: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """One session; its figures."""
    trace, name = folder / "trace.jsonl", f"vs{os.getpid()}"
    loop = "loop=1&pace=" + args.pace
    command = [sys.executable, "-m", "lfpipe", "up", args.scene, "--camera", f"file:{args.video}?{loop}", "--display", "none"]
    command += ["--trace", str(trace), "--session", name, "--duration", str(args.seconds + START_S)]
    command += ["--set=governor.quality=fixed"]  # what was asked for is measured, too slow or not
    command += ["--config", args.config] if args.config else []
    command += [f"--set={text}" for text in args.sets]
    began_ns = time.monotonic_ns()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    time.sleep(START_S)
    watch = [sys.executable, "-m", "lfpipe", "monitor", "--session", name, "--once", "--json"]
    state = json.loads(subprocess.run(watch, capture_output=True, text=True, check=True).stdout)
    pids = [process.pid, *(stage["pid"] for stage in state["stages"].values() if stage["pid"])]
    t0, cpu0 = time.monotonic(), cpu_ns(pids)
    time.sleep(args.seconds - 1.5)
    wall, cpu = time.monotonic() - t0, (cpu_ns(pids) - cpu0) / 1e9
    state = json.loads(subprocess.run(watch, capture_output=True, text=True, check=True).stdout)
    _out, err = process.communicate()
    if process.returncode:
        raise SystemExit(f"lfpipe ended with {process.returncode}: {err}")
    lines = [json.loads(line) for line in trace.read_text().splitlines()]
    latency = [(line["t_composed_ns"] - line["t_read_ns"]) / 1e6 for line in lines if line["composed"]]
    sources = sorted({line["source_seq"] for line in lines})
    span_s = (lines[-1]["t_presented_ns"] - lines[0]["t_presented_ns"]) / 1e9
    return {
        "p50": statistics.median(latency),
        "fps": (len(sources) - 1) / span_s,
        "cpu": cpu / wall,
        "drops": sum(stage["dropped"] for stage in state["stages"].values()),
        "gaps": sources[-1] - sources[0] + 1 - len(sources),
        "first_s": (lines[0]["t_presented_ns"] - began_ns) / 1e9,
    }


def loop(args: argparse.Namespace) -> dict[str, Any]:
    """One run of the loop; its figures."""
    pace = ["--pace", args.pace] if args.pace != "max" else ["--pace", "0", "--decode"]
    command = [sys.executable, args.loop, args.video, args.scene, *pace, "--seconds", str(args.seconds)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout.splitlines()[-1])
    first_s = found.get("first_picture_s")
    return {"p50": found["latency_ms"]["p50"], "fps": found["fps"], "cpu": found["cpu_cores"], "first_s": first_s}


def main() -> None:
    parser = parser_of(__doc__, rounds=3, seconds=12.0)
    parser.add_argument("video")
    parser.add_argument("scene")
    parser.add_argument("--pace", default="30")
    parser.add_argument("--config", default="paper")
    parser.add_argument("--set", dest="sets", action="append", default=[])
    parser.add_argument("--loop", default=str(Path(__file__).parent / "paper_loop.py"))
    parser.add_argument("--cpus", default="0,1")
    args = parser.parse_args()
    os.sched_setaffinity(0, {int(cpu) for cpu in args.cpus.split(",")})
    ratios: dict[str, list[float]] = {"p50": [], "fps": [], "cpu": [], "first_s": []}
    print("round            p50 ms          fps         cores    first s  drops gaps")
    for k in range(args.rounds):
        with tempfile.TemporaryDirectory() as folder:
            ours, theirs = lfpipe(args, Path(folder)), loop(args)
        for name, values in ratios.items():
            if theirs[name]:
                values.append(ours[name] / theirs[name])
        for who, row in (("lfpipe", ours), ("loop", theirs)):
            counts = f"{row['drops']:5d} {row['gaps']:4d}" if "drops" in row else ""
            first = f"{row['first_s']:8.2f}" if row["first_s"] else " " * 8
            print(f"{k} {who:<8} {row['p50']:12.3f} {row['fps']:12.1f} {row['cpu']:12.3f} {first} {counts}")
    for name, values in ratios.items():
        if values:
            print(f"ratio {name:<8} median {statistics.median(values):.3f}   {min(values):.3f} .. {max(values):.3f}")


if __name__ == "__main__":
    main()
