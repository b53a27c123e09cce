"""Repeats a replay on one core and on two, with and without CPU hogs. All digests must be equal.

    uv run python profiling/replay_steady.py SEQ [--scene S] [--runs 20]

Prints a line per run, and the number of different digests; exit code 1 if there is more than one.
"""

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from arguments import LFPIPE, existing, parser_of, start


def run(args: argparse.Namespace, cores: list[int], hogs: int) -> dict[str, Any]:
    """Runs one replay; returns its report."""
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(hogs)]
    try:
        with tempfile.TemporaryDirectory() as folder:
            command = [*LFPIPE, "replay", str(args.sequence), "--out", folder, "--pace", "step"]
            command += ["--scene", str(args.scene)] if args.scene else []
            subprocess.run(command, check=True, capture_output=True, preexec_fn=lambda: os.sched_setaffinity(0, cores))
            report: dict[str, Any] = json.loads((Path(folder) / "report.json").read_text())
            return report
    finally:
        for process in busy:
            process.kill()
            process.wait()


def main() -> int:
    parser = parser_of(__doc__, runs=20)
    parser.add_argument("sequence", type=existing)
    parser.add_argument("--scene", type=existing)
    args = parser.parse_args()
    cpus = sorted(os.sched_getaffinity(0))
    plans = [(cpus[:2], 0), (cpus[:1], 0), (cpus[:2], 2), (cpus[:1], 2)]
    seen = set()
    for number, (cores, hogs) in zip(range(args.runs), itertools.cycle(plans), strict=False):
        report = run(args, cores, hogs)
        seen.add(tuple(report["digests"].values()))
        digests = " ".join(f"{name} {digest[:12]}" for name, digest in report["digests"].items())
        print(f"{number:2} cores {len(cores)} hogs {hogs} {report['rate_hz']:6.1f} frames/s  {digests}", flush=True)
    print(f"{len(seen)} different")
    return int(len(seen) > 1)


if __name__ == "__main__":
    start(main)
