"""The paper's pipeline as one plain loop in one process (lfpipe/bench/paper_loop.py): what `lfpipe` is measured against.

    uv run python profiling/paper_loop.py VIDEO SCENE_DIR [--pace HZ] [--seconds S] [--decode] [--trace FILE]

SCENE_DIR holds rows x cols pictures whose sorted order is row-major. --pace 0: as fast as it can; --decode: frames are decoded in
the loop and not before it. Prints one JSON object: rate, p50..max of latency, tracking and rendering in ms, CPU, start.
"""

from __future__ import annotations

import time

START_NS = time.monotonic_ns()  # before the imports, which are most of a start

import json  # noqa: E402
from pathlib import Path  # noqa: E402

from arguments import parser_of  # noqa: E402

from lfpipe.bench.paper_loop import Loop, run  # noqa: E402


def main() -> None:
    parser = parser_of(__doc__, pace=0.0, seconds=15.0, k=5, alpha=12.0, rows=9, cols=9)
    parser.add_argument("video", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--decode", action="store_true")
    parser.add_argument("--trace", type=Path)
    args = parser.parse_args()
    width, height = (int(v) for v in args.size.split("x"))
    loop = Loop(
        args.video, args.scene, args.pace, args.seconds, args.k, args.alpha, args.rows, args.cols,
        (width, height), args.decode, args.trace,
    )  # fmt: skip
    found = run(loop)
    found["first_picture_s"] = round((found.pop("t_first_picture_ns") - START_NS) / 1e9, 3)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
