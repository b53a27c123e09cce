"""What recording costs a live session: frames of 640x480 at 60 Hz, without and with `lfpipe ctl record`.

    uv run python profiling/replay_recording.py VIDEO [--scene S] [--rate 60] [--seconds 10]

Prints for both parts the frames that capture, track and the recorder missed and the age of the pictures, then the recording.
"""

import os
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from arguments import LFPIPE, existing, parser_of, session_state, start

from lfpipe.bench.sessions import read_trace


def main() -> None:
    parser = parser_of(__doc__, rate=60.0, seconds=10.0)
    parser.add_argument("video", type=existing)
    parser.add_argument("--scene", type=existing)
    args = parser.parse_args()
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:2])
    name = f"rec{os.getpid()}"
    with tempfile.TemporaryDirectory() as folder:
        trace, out = Path(folder) / "trace.jsonl", Path(folder) / "sequence"
        command = [*LFPIPE, "up", *([str(args.scene)] if args.scene else ["--demo"]), "--display", "none", "--session", name]
        command += ["--camera", f"file:{args.video}?loop=1&pace={args.rate:g}", "--trace", str(trace)]
        session = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(4)
        marks, counts = [time.monotonic_ns()], [session_state(name)]
        time.sleep(args.seconds)
        marks.append(time.monotonic_ns())
        subprocess.run([*LFPIPE, "ctl", "--session", name, "record", "start", str(out)], check=True)
        counts.append(session_state(name))
        start_ns = time.monotonic_ns()
        time.sleep(args.seconds)
        counts.append(session_state(name))
        marks.append(time.monotonic_ns())
        subprocess.run([*LFPIPE, "ctl", "--session", name, "record", "stop"], check=True)
        subprocess.run([*LFPIPE, "ctl", "--session", name, "stop"], check=True)
        session.wait()
        shown = read_trace(trace)
        for what, begin, end, first, last in (("alone", *marks[:2], *counts[:2]), ("recording", start_ns, marks[2], *counts[1:])):
            inside = [line for line in shown if begin < line["t_presented_ns"] < end and line["composed"]]
            p50, p99 = np.percentile([(line["t_presented_ns"] - line["t_sensor_ns"]) / 1e6 for line in inside], (50, 99))
            missed = {
                stage: found["dropped"] - first["stages"].get(stage, {"dropped": 0})["dropped"]
                for stage, found in last["stages"].items()
            }
            print(f"{what:<10} missed {missed}  age of pictures p50 {p50:.1f} p99 {p99:.1f} ms")
        subprocess.run([*LFPIPE, "sequence", "info", str(out)], check=True)


if __name__ == "__main__":
    start(main)
