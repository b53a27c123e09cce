"""`lfpipe replay --pace max` beside the paper's loop, both decoding the same 640x480 Motion JPEG on the same two cores.

    uv run python profiling/replay_speed.py VIDEO.avi SCENE [--rounds 3] [--seconds 10] [--config paper] [--set KEY=VALUE]...

Frames/s of each, in turns, and the median of the ratios. The loop's start is not counted, nor is ours: the rate is of the frames
from the first to the last picture.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from arguments import parser_of


def main() -> None:
    parser = parser_of(__doc__, rounds=3, seconds=10.0)
    parser.add_argument("video")
    parser.add_argument("scene")
    parser.add_argument("--config")
    parser.add_argument("--set", dest="sets", action="append", default=[])
    args = parser.parse_args()
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:2])
    loop = [sys.executable, str(Path(__file__).parent / "paper_loop.py"), args.video, args.scene, "--pace", "0", "--decode"]
    ratios = []
    with tempfile.TemporaryDirectory() as folder:
        sequence, out = str(Path(folder) / "sequence"), Path(folder) / "out"
        subprocess.run([sys.executable, "-m", "lfpipe", "sequence", "import", args.video, sequence], check=True)
        command = [sys.executable, "-m", "lfpipe", "replay", sequence, "--scene", args.scene, "--pace", "max", "--out", str(out)]
        command += ["--config", args.config] if args.config else []
        command += [f"--set={text}" for text in args.sets]
        for number in range(args.rounds):
            subprocess.run(command, check=True, capture_output=True)
            ours = json.loads((out / "report.json").read_text())["rate_hz"]
            done = subprocess.run([*loop, "--seconds", str(args.seconds)], check=True, capture_output=True, text=True)
            theirs = json.loads(done.stdout.splitlines()[-1])["fps"]
            ratios.append(ours / theirs)
            print(f"{number} lfpipe {ours:7.1f}  loop {theirs:7.1f} frames/s  ratio {ratios[-1]:.2f}", flush=True)
    print(f"ratio median {statistics.median(ratios):.2f}   {min(ratios):.2f} .. {max(ratios):.2f}   (goal 1.5)")


if __name__ == "__main__":
    main()
