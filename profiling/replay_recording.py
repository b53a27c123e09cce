"""What recording costs a live session: 60 Hz of 640x480, one stretch without and one with `lfpipe ctl record`.

    uv run python profiling/replay_recording.py VIDEO [--scene S] [--rate 60] [--seconds 10]

Prints, for both stretches, frames that capture, track and the recorder missed, and the age of the picture; then what was stored.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from arguments import parser_of

LFPIPE = [sys.executable, "-m", "lfpipe"]


def state(name: str) -> dict[str, Any]:
    done = subprocess.run([*LFPIPE, "monitor", "--session", name, "--once", "--json"], capture_output=True, text=True, check=True)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def main() -> None:
    parser = parser_of(__doc__, rate=60.0, seconds=10.0)
    parser.add_argument("video")
    parser.add_argument("--scene")
    args = parser.parse_args()
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:2])
    name = f"rec{os.getpid()}"
    with tempfile.TemporaryDirectory() as folder:
        trace, out = Path(folder) / "trace.jsonl", Path(folder) / "sequence"
        command = [*LFPIPE, "up", *([args.scene] if args.scene else ["--demo"]), "--display", "none", "--session", name]
        command += ["--camera", f"file:{args.video}?loop=1&pace={args.rate:g}", "--trace", str(trace)]
        session = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(4)
        marks, counts = [time.monotonic_ns()], [state(name)]
        time.sleep(args.seconds)
        marks.append(time.monotonic_ns())
        subprocess.run([*LFPIPE, "ctl", "--session", name, "record", "start", str(out)], check=True)
        counts.append(state(name))
        start_ns = time.monotonic_ns()
        time.sleep(args.seconds)
        counts.append(state(name))
        marks.append(time.monotonic_ns())
        subprocess.run([*LFPIPE, "ctl", "--session", name, "record", "stop"], check=True)
        subprocess.run([*LFPIPE, "ctl", "--session", name, "stop"], check=True)
        session.wait()
        shown = lines(trace)
        for what, begin, end, first, last in (("alone", *marks[:2], *counts[:2]), ("recording", start_ns, marks[2], *counts[1:])):
            ages = sorted(
                x["t_presented_ns"] - x["t_sensor_ns"] for x in shown if begin < x["t_presented_ns"] < end and x["composed"]
            )
            p50, p99 = ages[len(ages) // 2] / 1e6, ages[len(ages) * 99 // 100] / 1e6
            missed = {
                stage: found["dropped"] - first["stages"].get(stage, {"dropped": 0})["dropped"]
                for stage, found in last["stages"].items()
            }
            print(f"{what:<10} missed {missed}  picture's age p50 {p50:.1f} p99 {p99:.1f} ms")
        subprocess.run([*LFPIPE, "sequence", "info", str(out)], check=True)


if __name__ == "__main__":
    main()
