"""Replay in steps again and again, on one core and on two, with and without CPU hogs beside it: the digests must be the same.

    uv run python profiling/replay_steady.py SEQ [--scene S] [--runs 20]

Prints one line per run and at the end how many different digests were seen (1 is right).
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from arguments import parser_of


def run(args: argparse.Namespace, cores: list[int], hogs: int, pace: str) -> dict[str, Any]:
    """One replay; its report."""
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(hogs)]
    try:
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, "-m", "lfpipe", "replay", args.sequence, "--out", folder, "--pace", pace]
            command += ["--scene", args.scene] if args.scene else []
            subprocess.run(command, check=True, capture_output=True, preexec_fn=lambda: os.sched_setaffinity(0, cores))
            report: dict[str, Any] = json.loads((Path(folder) / "report.json").read_text())
            return report
    finally:
        for process in busy:
            process.kill()
            process.wait()


def main() -> None:
    parser = parser_of(__doc__, runs=20)
    parser.add_argument("sequence")
    parser.add_argument("--scene")
    args = parser.parse_args()
    cpus = sorted(os.sched_getaffinity(0))
    plans = [(cpus[:2], 0), (cpus[:1], 0), (cpus[:2], 2), (cpus[:1], 2)]
    seen = set()
    for number, (cores, hogs) in zip(range(args.runs), itertools.cycle(plans), strict=False):
        report = run(args, cores, hogs, "step")
        seen.add(tuple(report["digests"].values()))
        digests = " ".join(f"{name} {digest[:12]}" for name, digest in report["digests"].items())
        print(f"{number:2} cores {len(cores)} hogs {hogs} {report['rate_hz']:6.1f} frames/s  {digests}", flush=True)
    print(f"{len(seen)} different")


if __name__ == "__main__":
    main()
