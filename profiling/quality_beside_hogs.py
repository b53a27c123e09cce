"""What the governor saves on an overloaded machine: a session beside busy loops, with and without
it.

    python -m profiling.quality_beside_hogs [SCENE] [--per-core 12] [--seconds 8]

Runs that many busy loops on each of two cores. Prints, for fixed quality and for the governor once
it has settled: refreshes missed, frames lost by capture and tracking, the age of pictures, and the
time until quality is restored after the loops have ended. Root can run it ahead of the machine's
other work.
"""

import argparse
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from profiling.arguments import LFPIPE, existing, parser_of, session_state, start

SETTLE_S, BACK_S = 6.0, 60.0
HOG = (
    "import os, sys\nos.sched_setaffinity(0, {int(sys.argv[1])})\nwhile os.getppid() =="
    " int(sys.argv[2]): pass"
)


def measure(args: argparse.Namespace, cores: list[int], quality: str, trace: Path) -> None:
    """Runs one session and prints its figures."""
    name = f"hogs{os.getpid()}{quality}"
    command = [
        *LFPIPE,
        "up",
        *([str(args.scene)] if args.scene else ["--demo"]),
        "--display",
        "none",
        "--session",
        name,
    ]
    command += [
        "--trace",
        str(trace),
        f"--set=governor.quality={quality}",
        "--set=render.method=warp2",
    ]
    command += [f"--set={text}" for text in args.sets]
    session = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    while not trace.exists() or trace.stat().st_size < 100_000:
        if session.poll() is not None:
            raise SystemExit(session.communicate()[1])
        time.sleep(0.1)
    hog = [sys.executable, "-c", HOG]
    hogs = [
        subprocess.Popen([*hog, str(core), str(os.getpid())])
        for core in cores
        for _ in range(args.per_core)
    ]
    try:
        time.sleep(SETTLE_S)
        before = session_state(name)
        size = trace.stat().st_size
        time.sleep(args.seconds)
        after = session_state(name)
        lines = trace.read_bytes()[size:].split(b"\n")[1:-1]
    finally:
        for each in hogs:
            each.kill()
            each.wait()
    ended = time.monotonic()

    def count(stage: str, key: str) -> int:
        return int(after["stages"][stage][key]) - int(before["stages"][stage][key])

    shown = count("render", "count")
    missed = count("render", "missed")
    frames = count("capture", "count")
    ages_ms = [
        (line["t_presented_ns"] - line["t_sensor_ns"]) / 1e6 for line in map(json.loads, lines)
    ]
    print(f"{quality}: level {after['level']} of {after['lowest_level']}, {after['level_words']}")
    print(
        f"  refreshes missed     {missed} of {shown + missed},"
        f" {100 * missed / max(shown + missed, 1):.0f} %"
    )
    print(
        f"  frames lost          capture {count('capture', 'dropped')}, track"
        f" {count('track', 'dropped')} of {frames}"
    )
    print(f"  left out by tracking {count('track', 'left_out')}")
    p50, p95 = np.percentile(ages_ms, (50, 95))
    print(f"  age of pictures      p50 {p50:.0f} ms, p95 {p95:.0f} ms")
    while session_state(name)["level"] and time.monotonic() - ended < BACK_S:
        time.sleep(0.2)
    if after["level"]:
        print(f"  full quality again   {time.monotonic() - ended:.0f} s after the end of the loops")
    session.terminate()
    said = session.communicate()[1]
    print(
        "".join(f"  {line}\n" for line in said.splitlines() if line.startswith("quality")),
        end="",
        flush=True,
    )


def main() -> None:
    parser = parser_of(__doc__, per_core=12, seconds=8.0)
    parser.add_argument(
        "scene", type=existing, nargs="?", help="a light field; default: the demo's"
    )
    parser.add_argument("--set", dest="sets", action="append", default=[], metavar="KEY=VALUE")
    args = parser.parse_args()
    cores = sorted(os.sched_getaffinity(0))[:2]
    os.sched_setaffinity(0, cores)
    with contextlib.suppress(OSError):  # without root the machine's other work has an effect
        os.setpriority(os.PRIO_PROCESS, 0, -15)
        Path("/proc/self/autogroup").write_text("-15")
    with tempfile.TemporaryDirectory() as folder:
        for quality in ("fixed", "auto"):
            measure(args, cores, quality, Path(folder, f"{quality}.jsonl"))


if __name__ == "__main__":
    start(main)
